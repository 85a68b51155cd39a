// How a map becomes metric: what its first window begins with, and whether that is known well enough.
#include <algorithm>
#include <array>
#include <cmath>

#include "vo_core/inertial/inertial_odometry.h"

namespace godwit::vo {

using S = InertialState;

double InertialOdometry::course_sigma(std::span<const InertialNode> window) const {
  const InertialNode &first = window.front(), &last = window.back();
  const double way = (last.sight.camera - first.sight.camera).norm();
  const double strayed = position_stray(last.sight, options_.model) * std::sqrt(rt::to_seconds(last.t_ns - first.t_ns));
  return std::clamp(options_.model.course_begin * strayed / std::max(way, 1e-12), options_.least_course_sigma,
                    options_.most_course_sigma);
}

Alignment InertialOdometry::align_by_rest(std::span<const InertialNode> window, const ImuBias& bias) const {
  const Mat3 R_body_cam = smoother_.mounting().R_body_cam;
  Mat3 R = window.front().sight.R_map_cam * R_body_cam.transpose();
  Alignment out;
  out.bias = bias;
  out.up = first_vertical_.in_map(R, bias.accel);
  out.velocity = R * (first_vertical_.velocity + first_vertical_.velocity_by_bias * bias.accel);
  // Readings lead on from there; vision's way in that time is as long.
  const Vec3 g = -options_.model.gravity_m_s2 * out.up;
  Vec3 v = out.velocity, way = Vec3::Zero();
  for (const InertialNode& node : window.subspan(1)) {
    const Preintegration& d = node.since_last;
    way += d.dt_s() * v + 0.5 * d.dt_s() * d.dt_s() * g + R * d.dp(bias);
    v += d.dt_s() * g + R * d.dv(bias);
    R = R * d.dR(bias.gyro);
  }
  const double seen = (window.back().sight.camera - window.front().sight.camera).norm();
  out.ok = seen > 0 && way.norm() > 0;
  if (out.ok) out.log_scale = std::log(way.norm() / seen);
  return out;
}

bool InertialOdometry::try_to_begin(const VisualPose& pose) {
  const int n = smoother_.size();
  if (n < 6 || pose.t_ns - smoother_.node(0).t_ns < options_.begin_span_ns) return false;
  std::array<InertialNode, InertialSmoother::kNodes> nodes;
  for (int i = 0; i < n; ++i) nodes[i] = smoother_.node(i);
  const std::span<const InertialNode> window(nodes.data(), n);
  const TurnAgreement turns = agreement_of_turns(window, smoother_.mounting(), prior_.bias);
  if (turns.about_other_axes())
    return refuse("sensor and pictures turn about other axes: cosine [0.01]", 100 * turns.cosine,
                  100 * TurnAgreement::kSameAxes);
  ImuBias bias = prior_.bias;
  bias.gyro = stood() ? first_vertical_.gyro_bias
                      : align_gyro_bias(window, smoother_.mounting(), bias, prior_.gyro_bias_sigma, 2e-4);
  const ScaleHint others = hint();
  const Alignment by_rest = stood() ? align_by_rest(window, bias) : Alignment{};
  if (by_rest.ok) first_vertical_.depth_m = std::exp(by_rest.log_scale) * window.front().sight.depth;
  const bool gone = by_rest.ok && gone_since_rest();
  const Alignment found =
      gone ? by_rest : align(window, smoother_.mounting(), bias, options_.model.gravity_m_s2, options_.method, others);
  if (!found.ok) return refuse("no scale fits", 0, 0);
  // The moments anew, each from the one before by what the alignment found.
  smoother_.clear();
  smoother_.add(window[0]);
  S& first = smoother_.state(0);
  first.bias = found.bias;
  first.log_scale = found.log_scale;
  // A vertical is linearised where it counts from: not at one that vision's accelerations may have tilted by far.
  first.up = stood() ? first_vertical_.in_map(first.R_map_body, found.bias.accel) : found.up;
  first.velocity = found.velocity;
  first.mounting = prior_.mounting;
  first.time_offset_s = prior_.time_offset_s;
  for (int i = 1; i < n; ++i) smoother_.add(window[i]);
  const double course = course_sigma(window);
  // A velocity since a rest holds whatever the bias is: there is nothing to be careful about.
  const double begin_sigma = gone ? prior_.accel_bias_sigma : begin_accel_sigma_;
  set_prior(begin_sigma, course);
  count_on(others);
  if (!convincing(smoother_.solve(6))) return false;
  if (begin_sigma > prior_.accel_bias_sigma) {
    set_prior(prior_.accel_bias_sigma, course);
    if (!smoother_.solve(2).ok) return false;
  }
  begin(pose, up_seen());
  strayed2_ = 0;
  return true;
}

bool InertialOdometry::convincing(const InertialSmoother::Report& report) {
  if (!report.ok) return refuse("the window has no solution", 0, 0);
  const auto& C = smoother_.covariance();
  const double scale_sigma = std::sqrt(C(S::kScale, S::kScale));
  const double up_sigma = std::sqrt(C.diagonal().segment<2>(S::kUp).maxCoeff());
  attempt_up_ = up_sigma < options_.begin_up_sigma ? smoother_.newest().up : Vec3(Vec3::Zero());
  attempt_up_sigma_ = up_sigma;
  if (!(scale_sigma < options_.begin_scale_sigma))
    return refuse("the scale is not seen: its sigma [0.1 %]", 1e3 * scale_sigma, 1e3 * options_.begin_scale_sigma);
  // Where it is known how fast one went, it is known how one was turned as well: what a young map's axes turn by beside
  // that is told.
  if (!gone_since_rest() && !(up_sigma < options_.begin_up_sigma))
    return refuse("the vertical is not seen: its sigma [mrad]", 1e3 * up_sigma, 1e3 * options_.begin_up_sigma);
  const double chi2 = 100 * report.chi2 / std::max(1, report.rows), most = 100 * options_.begin_chi2;
  const bool fits = chi2 < most ? plausible(4)
                                : refuse("vision and inertial sensor disagree: chi-square a degree [0.01]", chi2, most);
  // It may not have been a rest: the next attempt goes without.
  if (!fits) first_vertical_.known = false;
  return fits;
}

void InertialOdometry::set_prior(double accel_bias_sigma, double course_sigma) {
  InertialPrior prior = prior_;
  prior.accel_bias_sigma = accel_bias_sigma;
  prior.course_sigma = course_sigma;
  if (stood()) {
    // What the gyroscope read at rest is its bias; else a young map, which turns by itself, would be taken for one.
    prior.bias.gyro = first_vertical_.gyro_bias;
    prior.gyro_bias_sigma = std::min(prior.gyro_bias_sigma, first_vertical_.gyro_bias_sigma);
  }
  smoother_.set_prior(prior);
  if (stood()) smoother_.add_vertical(first_vertical_);
}

}  // namespace godwit::vo
