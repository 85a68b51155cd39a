#include "vo_core/map/depth_filter.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {

DepthEstimate DepthEstimate::prior(double depth_mean, double depth_min) {
  DepthEstimate e;
  e.inv_depth = 1.0 / depth_mean;
  e.inv_range = 1.0 / depth_min;
  e.variance = e.inv_range * e.inv_range / 36.0;
  return e;
}

void DepthEstimate::update(double x, double tau2) {
  const double norm_scale2 = variance + tau2;
  if (!(norm_scale2 > 0.0) || !std::isfinite(x) || !std::isfinite(tau2)) return;
  const double s2 = 1.0 / (1.0 / variance + 1.0 / tau2);
  const double m = s2 * (inv_depth / variance + x / tau2);
  const double d = x - inv_depth;
  double c1 = a / (a + b) * std::exp(-0.5 * d * d / norm_scale2) / std::sqrt(2.0 * M_PI * norm_scale2);
  // Outliers spread over the range, or over what good ones spread over where that is wider. Otherwise a measurement
  // without information, however near its mean, would pass for an outlier.
  const double spread = std::max(inv_range, std::sqrt(2.0 * M_PI * norm_scale2));
  double c2 = b / (a + b) / spread;
  const double norm = c1 + c2;
  if (!(norm > 0.0)) return;
  c1 /= norm;
  c2 /= norm;
  const double f = c1 * (a + 1.0) / (a + b + 1.0) + c2 * a / (a + b + 1.0);
  const double e = c1 * (a + 1.0) * (a + 2.0) / ((a + b + 1.0) * (a + b + 2.0)) +
                   c2 * a * (a + 1.0) / ((a + b + 1.0) * (a + b + 2.0));
  const double mean = c1 * m + c2 * inv_depth;
  const double var = c1 * (s2 + m * m) + c2 * (variance + inv_depth * inv_depth) - mean * mean;
  const double a_new = (e - f) / (f - e / f);
  if (!std::isfinite(a_new) || !(var > 0.0)) return;
  inv_depth = mean;
  variance = var;
  a = a_new;
  b = a * (1.0 - f) / f;
}

double DepthEstimate::relative_sigma() const {
  return inv_depth > 0.0 ? std::sqrt(variance) / inv_depth : 1e9;
}

void AgreedDepth::add(double measured_inv_depth, double measured_variance) {
  if (!(measured_variance > 0.0) || !std::isfinite(measured_variance) || !std::isfinite(measured_inv_depth)) return;
  if (matches_ > 0) {
    const double off = measured_inv_depth - inv_depth();
    if (off * off > kSigmas * kSigmas * (measured_variance + variance())) *this = {};
  }
  ++matches_;
  weight_ += 1.0 / measured_variance;
  weighted_ += measured_inv_depth / measured_variance;
}

double AgreedDepth::relative_sigma() const {
  return std::sqrt(variance()) / inv_depth();
}

double inverse_depth_variance(const Vec3& t_ref_cur, const Vec3& f_ref, double depth, double px_error_angle) {
  const Vec3 a = f_ref * depth - t_ref_cur;
  const double t_norm = t_ref_cur.norm(), a_norm = a.norm();
  if (t_norm < 1e-9 || a_norm < 1e-9) return 1e12;
  const double alpha = std::acos(std::clamp(f_ref.dot(t_ref_cur) / t_norm, -1.0, 1.0));
  const double beta = std::acos(std::clamp(-a.dot(t_ref_cur) / (t_norm * a_norm), -1.0, 1.0));
  const double beta_plus = beta + px_error_angle;
  const double gamma_plus = M_PI - alpha - beta_plus;
  if (gamma_plus <= 1e-6) return 1e12;  // the rays do not meet any more: nothing is known
  const double depth_plus = t_norm * std::sin(beta_plus) / std::sin(gamma_plus);
  const double tau = depth_plus - depth;
  const double inv = 0.5 * (1.0 / std::max(1e-7, depth - tau) - 1.0 / (depth + tau));
  return inv * inv;
}

}  // namespace godwit::vo
