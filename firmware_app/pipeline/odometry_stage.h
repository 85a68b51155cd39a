// The odometry as a stage of the pipeline: the only place where the application touches vo::Tracker and vo::Mapper.
#pragma once

#include <array>
#include <memory>
#include <optional>

#include "firmware_app/pipeline/frame_view.h"
#include "firmware_app/pipeline/mask_source.h"
#include "firmware_app/pipeline/stage.h"
#include "hal/camera/calibration.h"
#include "hal/imu/error_model.h"
#include "hal/rt/result.h"
#include "vo_core/geometry/camera_model.h"

namespace godwit::app {

struct OdometryOptions {
  /// Sequential runs: results of the mapper are applied so many frames after the frame that caused them. 0: when they
  /// are there, for threads.
  int mapper_delay_frames = 0;
  /// Rolling shutter: time from the first row to the last [frame intervals].
  double readout_frames = 0;
  double readout_s = 0;  ///< the same in seconds
  bool gate = false;     ///< find what moves by geometry (vo_core/tracking/motion_gate.h) and leave it out
  /// Use the inertial sensor: poses are then metric and level, and only frames with such a pose count as tracked.
  /// Row by row; maps camera points into the body, whose axes the sensor's readings have.
  std::optional<std::array<double, 16>> inertial_T_body_cam;
  /// Without it: use the autopilot's attitude and what knows lengths, once an attitude is heard; the same matrix, of
  /// the autopilot's body. Not both.
  std::optional<std::array<double, 16>> aided_T_body_cam;
  double starting_height_m = 0;        ///< of the camera above flat ground where its first map begins; 0: not known
  double inertial_time_offset_s = 0;   ///< what to add to the camera's times to have that sensor's
  hal::ImuErrorModel inertial_errors;  ///< of that sensor, as far as they are known
  /// The gyroscope's turns start the tracker's alignment. Not where the two are to be measured against each other.
  bool gyro_helps = true;
  rt::TimeNs coast_ns = 2 * rt::kNsPerSecond;  ///< how long a pose may come from the inertial sensor alone
};

/// What the odometry must know of this camera beside its model: the rolling shutter.
OdometryOptions odometry_options(const hal::CameraCalibration& calibration);

/// The odometry's camera model from a calibration file's numbers. Error: absurd numbers.
rt::Result<vo::CameraModel> make_camera_model(const hal::CameraCalibration& calibration);

/// Bytes of pyramid storage that the odometry needs in each frame slot.
std::size_t odometry_pyramid_bytes(int width, int height);

/// Frame slots that the odometry may hold on to: keyframes, and frames under way between tracker and mapper.
int odometry_frame_slots();

/// Fewest slots with which it can fly: with less than it wants it keeps fewer keyframes.
int odometry_frame_slots_min();

/// All memory is taken here. The pool outlives the stage, and so does `masks`, which is asked for each frame's dynamic
/// pixels; null: nothing is masked. `view` (may be null) is shown every frame.
std::unique_ptr<FrameStage> make_odometry_stage(const vo::CameraModel& camera, const OdometryOptions& options,
                                                rt::FramePool* pool, MaskSource* masks = nullptr,
                                                FrameView* view = nullptr);

}  // namespace godwit::app
