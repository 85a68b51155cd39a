#include "vo_core/inertial/velocity_fit.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cassert>

namespace godwit::vo {
namespace {
constexpr double kUnitS = 0.1;  // times near 1 keep the equations well conditioned
constexpr double kSharedError = 0.1;
}  // namespace

void VelocityFit::add(rt::TimeNs t_ns, const Eigen::Vector3d& position) {
  if (count_ > 0 && t_ns - point_[count_ - 1].t_ns > kMaxGapNs) count_ = 0;
  if (count_ == kPoints) {
    std::copy(point_.begin() + 1, point_.end(), point_.begin());
    --count_;
  }
  point_[count_].t_ns = t_ns;
  point_[count_].position = position;
  ++count_;
}

void VelocityFit::shift(const Eigen::Vector3d& by) {
  for (std::size_t i = 0; i < count_; ++i) point_[i].position += by;
}

VelocityFit::Estimate VelocityFit::at(rt::TimeNs t_ns, double sigma) const {
  assert(count_ >= 2);
  const Eigen::Index terms = count_ >= 4 ? 3 : 2;
  Eigen::Matrix3d N = Eigen::Matrix3d::Zero();
  Eigen::Matrix3d B = Eigen::Matrix3d::Zero();
  const auto row = [&](const Point& p) {
    const double u = rt::to_seconds(p.t_ns - t_ns) / kUnitS;
    return Eigen::Vector3d(1, u, terms == 3 ? u * u : 0);
  };
  for (std::size_t i = 0; i < count_; ++i) {
    const Eigen::Vector3d a = row(point_[i]);
    N += a * a.transpose();
    B += a * point_[i].position.transpose();
  }
  if (terms == 2) N(2, 2) = 1;
  const Eigen::Matrix3d inverse = N.ldlt().solve(Eigen::Matrix3d::Identity());
  const Eigen::Matrix3d X = inverse * B;

  double variance = sigma * sigma;
  const auto freedom = 3 * (static_cast<Eigen::Index>(count_) - terms);
  if (freedom > 0) {
    double scatter = 0;
    for (std::size_t i = 0; i < count_; ++i) {
      scatter += (point_[i].position - X.transpose() * row(point_[i])).squaredNorm();
    }
    variance = std::max(scatter / static_cast<double>(freedom), kSharedError * kSharedError * variance);
  }
  Estimate out;
  out.position = X.row(0).transpose();
  out.velocity = X.row(1).transpose() / kUnitS;
  out.position_variance = variance * inverse(0, 0);
  out.velocity_variance = variance * inverse(1, 1) / (kUnitS * kUnitS);
  return out;
}

}  // namespace godwit::vo
