// How fast the camera turns, by the poses of two frames: for whoever has no gyro.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "firmware_app/pipeline/frame_record.h"

namespace godwit::app {

class TurnWatch {
 public:
  /// [rad/s] between the frame before and this one; nothing: one of them was not tracked, or they are too far apart.
  std::optional<double> rate(const FrameRecord& record) {
    const double dt_s = rt::to_seconds(record.t_capture_ns - t_ns_);
    const bool known = record.tracked && t_ns_ != 0 && dt_s > 0 && dt_s < kWithinS;
    double dot = 0;
    for (std::size_t i = 0; i < 4; ++i) dot += record.q_world_cam[i] * q_[i];
    t_ns_ = record.tracked ? record.t_capture_ns : 0;
    q_ = record.q_world_cam;
    if (!known) return std::nullopt;
    return 2 * std::acos(std::min(1.0, std::abs(dot))) / dt_s;
  }

 private:
  static constexpr double kWithinS = 0.2;
  rt::TimeNs t_ns_ = 0;  ///< 0: that frame has no pose
  std::array<double, 4> q_{};
};

}  // namespace godwit::app
