#include "vo_core/tracking/motion_gate.h"

#include <algorithm>

namespace godwit::vo {

int MotionGate::run(std::span<FrameFeature> features, std::span<PoseMeasurement> measurements) const {
  const std::size_t n = std::min<std::size_t>(features.size(), kMaxFrameFeatures);
  std::array<int, kColumns * kRows> inliers{}, outliers{};
  for (std::size_t i = 0; i < n; ++i) ++(measurements[i].inlier ? inliers : outliers)[cell(features[i])];
  const auto moves = [&](std::size_t i) {
    const int c = cell(features[i]);
    return outliers[c] >= options_.min_outliers && outliers[c] >= inliers[c];
  };
  int left = 0;
  for (std::size_t i = 0; i < n; ++i) left += !moves(i);
  if (left == static_cast<int>(n) || left < options_.min_left) return static_cast<int>(n);

  std::array<FrameFeature, kMaxFrameFeatures> moving_features;
  std::array<PoseMeasurement, kMaxFrameFeatures> moving_measurements;
  std::size_t kept = 0, moving = 0;
  for (std::size_t i = 0; i < n; ++i) {
    if (moves(i)) {
      moving_features[moving] = features[i];
      moving_measurements[moving++] = measurements[i];
    } else {
      features[kept] = features[i];
      measurements[kept++] = measurements[i];
    }
  }
  std::copy_n(moving_features.begin(), moving, features.begin() + static_cast<std::ptrdiff_t>(kept));
  std::copy_n(moving_measurements.begin(), moving, measurements.begin() + static_cast<std::ptrdiff_t>(kept));
  return left;
}

}  // namespace godwit::vo
