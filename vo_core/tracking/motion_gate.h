// Movers that no network knows: where many measurements of a part of the picture disagree with the pose, that part
// moves. Goes beyond the paper, which names it as future work (section 5).
#pragma once

#include <array>
#include <span>

#include "vo_core/map/map_exchange.h"
#include "vo_core/tracking/pose_optimizer.h"

namespace godwit::vo {

struct MotionGateOptions {
  bool on = false;
  int min_outliers = 2;  ///< outliers in a cell, at least as many as it has inliers, by which the cell moves
  int min_left = 40;     ///< measurements that must be left, or nothing is rejected
  int strikes = 4;       ///< counts against a map point in a moving cell, as so many frames without a match do
};

/// Single outliers are what the robust pose is for; a mover gives several beside each other, and drags along those of
/// its points that happen to agree. Stateless, no allocation, one pass.
class MotionGate {
 public:
  static constexpr int kColumns = 8, kRows = 6;

  /// Precondition: sizes are positive.
  MotionGate(int width, int height, const MotionGateOptions& options)
      : width_(width), height_(height), options_(options) {}

  /// Moves the features in moving cells, with their measurements, behind all others, which keep their order. Returns
  /// how many are left; all of them where too few would be. Both spans are equally long, inliers as optimize_pose()
  /// marked them, features' pixels inside the picture.
  int run(std::span<FrameFeature> features, std::span<PoseMeasurement> measurements) const;

 private:
  int cell(const FrameFeature& f) const {
    return static_cast<int>(f.px.y()) * kRows / height_ * kColumns + static_cast<int>(f.px.x()) * kColumns / width_;
  }

  int width_, height_;
  MotionGateOptions options_;
};

}  // namespace godwit::vo
