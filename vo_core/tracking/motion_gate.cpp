#include "vo_core/tracking/motion_gate.h"

#include <algorithm>

#include "hal/rt/count.h"

namespace godwit::vo {

int MotionGate::run(std::span<FrameFeature> features, std::span<PoseMeasurement> measurements) const {
  const int n = std::min(rt::count_of(features), kMaxFrameFeatures);
  std::array<int, kColumns * kRows> inliers{}, outliers{};
  for (int i = 0; i < n; ++i) ++(measurements[i].inlier ? inliers : outliers)[cell(features[i])];
  const auto moves = [&](int i) {
    const int c = cell(features[i]);
    return outliers[c] >= options_.min_outliers && outliers[c] >= inliers[c];
  };
  int left = 0;
  for (int i = 0; i < n; ++i) left += !moves(i);
  if (left == n || left < options_.min_left) return n;

  std::array<FrameFeature, kMaxFrameFeatures> moving_features;
  std::array<PoseMeasurement, kMaxFrameFeatures> moving_measurements;
  int kept = 0, moving = 0;
  for (int i = 0; i < n; ++i) {
    if (moves(i)) {
      moving_features[moving] = features[i];
      moving_measurements[moving++] = measurements[i];
    } else {
      features[kept] = features[i];
      measurements[kept++] = measurements[i];
    }
  }
  std::copy_n(moving_features.begin(), moving, features.begin() + kept);
  std::copy_n(moving_measurements.begin(), moving, measurements.begin() + kept);
  return left;
}

}  // namespace godwit::vo
