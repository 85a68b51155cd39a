// How fast the camera moves, from its last few positions.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>

#include "hal/rt/time.h"

namespace godwit::vo {

/// Least-squares parabola through the newest positions (a line through two or three of them). A parabola, because a
/// line's slope is that of its middle, which lies 80 ms back. One thread, no allocation.
class VelocityFit {
 public:
  static constexpr std::size_t kPoints = 6;
  static constexpr rt::TimeNs kMaxGapNs = 300 * rt::kNsPerMs;  ///< after a longer gap it begins anew

  struct Estimate {
    Eigen::Vector3d position;      ///< where the curve is at the time asked for
    Eigen::Vector3d velocity;      ///< and its slope there [1/s]
    double position_variance = 0;  ///< each axis
    double velocity_variance = 0;
  };

  void clear() { count_ = 0; }
  /// Times must rise.
  void add(rt::TimeNs t_ns, const Eigen::Vector3d& position);
  /// Moves what was added so far: the frame of reference was corrected.
  void shift(const Eigen::Vector3d& by);
  std::size_t points() const { return count_; }

  /// At least two points. sigma: of one position, as its source knows it. The scatter around the curve counts where it
  /// is larger than a tenth of that (neighbours share most of their error); two points have no scatter, there sigma
  /// itself counts.
  Estimate at(rt::TimeNs t_ns, double sigma) const;

 private:
  struct Point {
    rt::TimeNs t_ns = 0;
    Eigen::Vector3d position = Eigen::Vector3d::Zero();
  };
  std::array<Point, kPoints> point_{};  // oldest first
  std::size_t count_ = 0;
};

}  // namespace godwit::vo
