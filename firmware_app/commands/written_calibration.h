// `godwit replay --write-calibration`: the sequence's calibration with rotation and time between camera and inertial
// sensor as this flight showed them.
#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <deque>
#include <string>
#include <vector>

#include "firmware_app/calibration/camera_imu.h"
#include "firmware_app/pipeline/pipeline.h"
#include "hal/camera/calibration.h"
#include "hal/imu/imu.h"

namespace godwit::app {

/// Gathers how the camera turned over some pictures, as vision saw it: the first and the last against the same
/// keyframe.
class TurnListener final : public FrameSink {
 public:
  rt::Result<void> take(const FrameRecord& record) override;
  const std::vector<SeenTurn>& turns() const { return turns_; }

 private:
  struct Moment {
    rt::TimeNs t_ns = 0;
    Eigen::Quaterniond turn;  ///< camera to keyframe
  };
  std::vector<SeenTurn> turns_;
  std::deque<Moment> moments_;  ///< of one keyframe
  std::uint32_t map_id_ = 0, reference_id_ = 0;
};

/// Fits, tells what came out and writes the file (TOML). readings: with their recorded times. Error: in words.
rt::Result<void> write_camera_imu(const std::string& file, const hal::CameraCalibration& calibration,
                                  const std::vector<SeenTurn>& turns, const std::vector<hal::ImuSample>& readings);

}  // namespace godwit::app
