// Uniform quintic B-spline: four times continuously differentiable, so that rates and accelerations are exact and
// smooth.
#pragma once

#include <Eigen/Core>
#include <vector>

namespace godwit::sim {

/// x, y, z [m], yaw, pitch, roll [rad], and anything else that moves together.
using Vec6 = Eigen::Matrix<double, 6, 1>;

struct SplineSample {
  Vec6 value, first, second;  ///< value and its first and second derivative in time
};

/// The curve over control points one knot_s apart. Its time runs from 0 to duration_s().
class QuinticSpline {
 public:
  /// At least six control points.
  QuinticSpline(std::vector<Vec6> control, double knot_s);
  double duration_s() const { return static_cast<double>(control_.size() - 5) * knot_s_; }
  /// t_s is clamped to [0, duration_s()]. No allocation.
  SplineSample sample(double t_s) const;

 private:
  std::vector<Vec6> control_;
  double knot_s_;
};

}  // namespace godwit::sim
