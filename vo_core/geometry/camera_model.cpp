#include "vo_core/geometry/camera_model.h"

#include <algorithm>
#include <cmath>
#include <hwy/highway.h>
#include <numbers>
#include <span>
#include <string>

#include "hal/rt/image.h"

namespace godwit::vo {
namespace hn = hwy::HWY_NAMESPACE;
namespace {

/// Pinhole: points more than 84 degrees off the axis are never in the picture, but can overflow the polynomial.
constexpr double kMaxPinholeRadius = 10.0;
/// Bound of every Newton loop; inside the picture it ends after three to six steps.
constexpr int kMaxNewtonSteps = 20;

/// First argument in (0, limit] at which s (1 + k[0] s^2 + k[1] s^4 + ..) stops growing; limit if it never does.
double monotonic_limit(std::span<const double> k, double limit) {
  const auto slope = [&](double s) {
    const double s2 = s * s;
    double sum = 0.0;
    for (std::size_t i = k.size(); i-- > 0;) sum = (sum + static_cast<double>(2 * i + 3) * k[i]) * s2;
    return 1.0 + sum;
  };
  constexpr int kSteps = 8192;
  for (int i = 1; i <= kSteps; ++i) {
    double high = limit * i / kSteps;
    if (slope(high) > 0.0) continue;
    double low = limit * (i - 1) / kSteps;
    for (int j = 0; j < 60; ++j) {
      const double mid = 0.5 * (low + high);
      (slope(mid) > 0.0 ? low : high) = mid;
    }
    return low;
  }
  return limit;
}

/// Distorted pinhole coordinates d(x, y) and the symmetric Jacobian's three entries.
template <typename Real>
struct Distorted {
  Real x, y;
  Real xx, xy, yy;  // d x_d / d x, d x_d / d y (= d y_d / d x), d y_d / d y
};

/// Real: double, or a vector of numbers, which has the same operators. real(double): such a one.
template <typename Real, typename Set>
inline Distorted<Real> distort(const std::array<Real, 5>& k, const Real& x, const Real& y, const Set& real) {
  const Real x2 = x * x, y2 = y * y, xy = x * y, r2 = x2 + y2;
  const Real one = real(1.0), two = real(2.0), six = real(6.0);
  const Real radial = one + r2 * (k[0] + r2 * (k[1] + r2 * k[4]));
  const Real slope2 = two * (k[0] + r2 * (two * k[1] + r2 * real(3.0) * k[4]));  // d radial / d x = slope2 * x
  const Real &p1 = k[2], &p2 = k[3];
  return {x * radial + two * p1 * xy + p2 * (r2 + two * x2), y * radial + p1 * (r2 + two * y2) + two * p2 * xy,
          radial + slope2 * x2 + two * p1 * y + six * p2 * x, slope2 * xy + two * p1 * x + two * p2 * y,
          radial + slope2 * y2 + six * p1 * y + two * p2 * x};
}

/// theta_d and d theta_d / d theta of the Kannala-Brandt polynomial.
inline void kannala_brandt_angle(const std::array<double, 5>& k, double theta, double* theta_d, double* slope) {
  const double t2 = theta * theta;
  *theta_d = theta * (1.0 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))));
  *slope = 1.0 + t2 * (3.0 * k[0] + t2 * (5.0 * k[1] + t2 * (7.0 * k[2] + t2 * 9.0 * k[3])));
}

std::string number(double value) {
  std::string s = std::to_string(value);
  return s;
}

rt::Result<void> check_intrinsics(int width, int height, double fx, double fy, double cx, double cy,
                                  std::span<const double> distortion) {
  const auto bad = [](const std::string& what) { return rt::Result<void>(rt::Error{"camera calibration: " + what}); };
  if (width < 16 || width > rt::kMaxImageWidth)
    return bad("width is " + std::to_string(width) + ", allowed is 16 to " + std::to_string(rt::kMaxImageWidth));
  if (height < 16 || height > rt::kMaxImageHeight)
    return bad("height is " + std::to_string(height) + ", allowed is 16 to " + std::to_string(rt::kMaxImageHeight));
  // A focal length outside these bounds means a field of view below about 1 or, for a fisheye, beyond 360 degrees.
  const double longest = std::max(width, height);
  const double low = 0.05 * longest, high = 60.0 * longest;
  const auto focal_ok = [&](double f) { return std::isfinite(f) && f >= low && f <= high; };
  if (!focal_ok(fx)) return bad("fx is " + number(fx) + " px, allowed is " + number(low) + " to " + number(high));
  if (!focal_ok(fy)) return bad("fy is " + number(fy) + " px, allowed is " + number(low) + " to " + number(high));
  if (fx > 2.0 * fy || fy > 2.0 * fx)
    return bad("fx " + number(fx) + " and fy " + number(fy) + " differ by more than a factor of 2");
  if (!(cx >= 0.0 && cx <= width - 1)) return bad("cx is " + number(cx) + ", outside the picture");
  if (!(cy >= 0.0 && cy <= height - 1)) return bad("cy is " + number(cy) + ", outside the picture");
  for (std::size_t i = 0; i < distortion.size(); ++i) {
    if (!std::isfinite(distortion[i]))
      return bad("distortion coefficient " + std::to_string(i + 1) + " is not a finite number");
  }
  return {};
}

}  // namespace

rt::Result<CameraModel> CameraModel::pinhole_radtan(int width, int height, double fx, double fy, double cx, double cy,
                                                    const std::array<double, 5>& distortion) {
  if (auto ok = check_intrinsics(width, height, fx, fy, cx, cy, distortion); !ok) return ok.error();
  CameraModel camera;
  camera.kind_ = Kind::kPinholeRadTan;
  camera.width_ = width;
  camera.height_ = height;
  camera.fx_ = fx;
  camera.fy_ = fy;
  camera.cx_ = cx;
  camera.cy_ = cy;
  camera.k_ = distortion;
  const std::array<double, 3> radial{distortion[0], distortion[1], distortion[4]};
  camera.max_r_ = monotonic_limit(radial, kMaxPinholeRadius);
  if (auto ok = camera.check_picture(); !ok) return ok.error();
  return camera;
}

rt::Result<CameraModel> CameraModel::kannala_brandt(int width, int height, double fx, double fy, double cx, double cy,
                                                    const std::array<double, 4>& distortion) {
  if (auto ok = check_intrinsics(width, height, fx, fy, cx, cy, distortion); !ok) return ok.error();
  CameraModel camera;
  camera.kind_ = Kind::kKannalaBrandt4;
  camera.width_ = width;
  camera.height_ = height;
  camera.fx_ = fx;
  camera.fy_ = fy;
  camera.cx_ = cx;
  camera.cy_ = cy;
  std::copy(distortion.begin(), distortion.end(), camera.k_.begin());
  camera.max_r_ = monotonic_limit(distortion, std::numbers::pi);
  if (auto ok = camera.check_picture(); !ok) return ok.error();
  return camera;
}

rt::Result<void> CameraModel::check_picture() const {
  // Every 16th pixel and the edges: what is unprojected there must come back to where it was.
  constexpr int kStep = 16;
  for (int v = 0;; v = std::min(v + kStep, height_ - 1)) {
    for (int u = 0;; u = std::min(u + kStep, width_ - 1)) {
      const Vec2 px(u, v);
      Vec2 back;
      Mat23 J;
      const Vec3 ray = unproject(px);
      const bool seen = project(ray, &back, &J);
      if (!seen || !((back - px).norm() < 1e-6)) {
        return rt::Error{"camera calibration: the distortion folds inside the picture, at pixel (" + std::to_string(u) +
                         ", " + std::to_string(v) + ")"};
      }
      if (u == width_ - 1) break;
    }
    if (v == height_ - 1) break;
  }
  return {};
}

bool CameraModel::project(const Vec3& p_cam, Vec2* px, Mat23* J) const {
  const double X = p_cam.x(), Y = p_cam.y(), Z = p_cam.z();
  // Comparisons are written so that a NaN anywhere ends in false.
  if (kind_ == Kind::kPinholeRadTan) {
    if (!(Z > 0.0)) return false;
    const double inv_z = 1.0 / Z;
    const double x = X * inv_z, y = Y * inv_z;
    if (!(x * x + y * y <= max_r_ * max_r_)) return false;
    const Distorted<double> d = distort(k_, x, y, [](double value) { return value; });
    *px = Vec2(fx_ * d.x + cx_, fy_ * d.y + cy_);
    if (J != nullptr) {
      const double a = fx_ * inv_z, b = fy_ * inv_z;
      *J << a * d.xx, a * d.xy, -a * (d.xx * x + d.xy * y), b * d.xy, b * d.yy, -b * (d.xy * x + d.yy * y);
    }
    return true;
  }

  const double r2 = X * X + Y * Y;
  const double r = std::sqrt(r2);
  const double theta = std::atan2(r, Z);
  if (!(theta <= max_r_) || !std::isfinite(r)) return false;
  if (r < 1e-9 * std::abs(Z) || r == 0.0) {
    // On the axis the direction of r is undefined; the limit is a plain pinhole. Behind the camera nothing is seen.
    if (!(Z > 0.0)) return false;
    const double inv_z = 1.0 / Z;
    *px = Vec2(fx_ * X * inv_z + cx_, fy_ * Y * inv_z + cy_);
    if (J != nullptr) *J << fx_ * inv_z, 0.0, -fx_ * X * inv_z * inv_z, 0.0, fy_ * inv_z, -fy_ * Y * inv_z * inv_z;
    return true;
  }
  double theta_d, slope;
  kannala_brandt_angle(k_, theta, &theta_d, &slope);
  const double inv_r = 1.0 / r;
  const double ex = X * inv_r, ey = Y * inv_r;
  *px = Vec2(fx_ * theta_d * ex + cx_, fy_ * theta_d * ey + cy_);
  if (J != nullptr) {
    const double inv_R2 = 1.0 / (r2 + Z * Z);
    const double along = slope * Z * inv_R2;  // d theta_d / d r
    const double across = theta_d * inv_r;    // what turning the point about the axis does
    const double z_part = -slope * r * inv_R2;
    const double mixed = (along - across) * ex * ey;
    *J << fx_ * (along * ex * ex + across * ey * ey), fx_ * mixed, fx_ * z_part * ex, fy_ * mixed,
        fy_ * (along * ey * ey + across * ex * ex), fy_ * z_part * ey;
  }
  return true;
}

template <typename Real>
void CameraModel::project_rows(int count, const Rows<Real>& rows) const {
  if (kind_ != Kind::kPinholeRadTan) {
    for (int i = 0; i < count; ++i) {
      Vec2 px(cx_, cy_);
      Mat23 J = Mat23::Zero();
      const Vec3 p(static_cast<double>(rows.x[i]), static_cast<double>(rows.y[i]), static_cast<double>(rows.z[i]));
      rows.seen[i] = project(p, &px, rows.J != nullptr ? &J : nullptr) ? Real{1} : Real{0};
      rows.u[i] = static_cast<Real>(px.x());
      rows.v[i] = static_cast<Real>(px.y());
      if (rows.J == nullptr) continue;
      for (int k = 0; k < 6; ++k) rows.J[k][i] = static_cast<Real>(J(k / 3, k % 3));
    }
    return;
  }
  // A point that cannot be seen is taken for one on the axis.
  const hn::CappedTag<Real, kRowLanes> d;
  using V = hn::Vec<decltype(d)>;
  const auto set = [&](double value) { return hn::Set(d, static_cast<Real>(value)); };
  const V one = set(1.0), fx = set(fx_), fy = set(fy_), cx = set(cx_), cy = set(cy_), most_r2 = set(max_r_ * max_r_);
  const std::array<V, 5> k{set(k_[0]), set(k_[1]), set(k_[2]), set(k_[3]), set(k_[4])};
  for (int i = 0; i < count; i += static_cast<int>(hn::Lanes(d))) {
    const V z = hn::LoadU(d, rows.z + i);
    const auto before = hn::Gt(z, hn::Zero(d));
    const V inv_z = hn::Div(one, hn::IfThenElse(before, z, one));
    const V x_any = hn::Mul(hn::LoadU(d, rows.x + i), inv_z), y_any = hn::Mul(hn::LoadU(d, rows.y + i), inv_z);
    const auto within = hn::And(before, hn::Le(hn::Add(hn::Mul(x_any, x_any), hn::Mul(y_any, y_any)), most_r2));
    const V x = hn::IfThenElseZero(within, x_any), y = hn::IfThenElseZero(within, y_any);
    const Distorted<V> at = distort(k, x, y, [&](double value) { return set(value); });
    hn::StoreU(hn::Add(hn::Mul(fx, at.x), cx), d, rows.u + i);
    hn::StoreU(hn::Add(hn::Mul(fy, at.y), cy), d, rows.v + i);
    hn::StoreU(hn::IfThenElseZero(within, one), d, rows.seen + i);
    if (rows.J == nullptr) continue;
    const V a = hn::Mul(fx, inv_z), b = hn::Mul(fy, inv_z);
    hn::StoreU(hn::Mul(a, at.xx), d, rows.J[0] + i);
    hn::StoreU(hn::Mul(a, at.xy), d, rows.J[1] + i);
    hn::StoreU(hn::Neg(hn::Mul(a, hn::Add(hn::Mul(at.xx, x), hn::Mul(at.xy, y)))), d, rows.J[2] + i);
    hn::StoreU(hn::Mul(b, at.xy), d, rows.J[3] + i);
    hn::StoreU(hn::Mul(b, at.yy), d, rows.J[4] + i);
    hn::StoreU(hn::Neg(hn::Mul(b, hn::Add(hn::Mul(at.xy, x), hn::Mul(at.yy, y)))), d, rows.J[5] + i);
  }
}

void CameraModel::project(int count, const Rows<float>& rows) const {
  project_rows(count, rows);
}
void CameraModel::project(int count, const Rows<double>& rows) const {
  project_rows(count, rows);
}

Vec3 CameraModel::unproject(const Vec2& px) const {
  const double xd = (px.x() - cx_) / fx_, yd = (px.y() - cy_) / fy_;
  if (kind_ == Kind::kPinholeRadTan) {
    // Newton in two dimensions on d(x, y) = (xd, yd). The iterate is kept where the distortion is monotonic.
    double x = xd, y = yd;
    for (int i = 0; i < kMaxNewtonSteps; ++i) {
      const double r2 = x * x + y * y;
      if (r2 > max_r_ * max_r_) {
        const double shrink = 0.999 * max_r_ / std::sqrt(r2);
        x *= shrink;
        y *= shrink;
      }
      const Distorted<double> d = distort(k_, x, y, [](double value) { return value; });
      const double ex = xd - d.x, ey = yd - d.y;
      const double inv_det = 1.0 / (d.xx * d.yy - d.xy * d.xy);
      const double sx = (d.yy * ex - d.xy * ey) * inv_det, sy = (d.xx * ey - d.xy * ex) * inv_det;
      x += sx;
      y += sy;
      // Newton squares its error: after a step of 1e-7 what is left is below 1e-12.
      if (sx * sx + sy * sy < 1e-14) break;
    }
    const double inv_norm = 1.0 / std::sqrt(x * x + y * y + 1.0);
    return {x * inv_norm, y * inv_norm, inv_norm};
  }

  const double theta_d = std::sqrt(xd * xd + yd * yd);
  if (theta_d < 1e-12) return {xd, yd, 1.0};
  double theta = std::min(theta_d, max_r_);
  for (int i = 0; i < kMaxNewtonSteps; ++i) {
    double value, slope;
    kannala_brandt_angle(k_, theta, &value, &slope);
    const double next = std::clamp(theta + (theta_d - value) / slope, 0.0, max_r_);
    const double step = next - theta;
    theta = next;
    if (std::abs(step) < 1e-7) break;
  }
  const double scale = std::sin(theta) / theta_d;
  return {xd * scale, yd * scale, std::cos(theta)};
}

}  // namespace godwit::vo
