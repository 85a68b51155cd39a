// From a configuration to the parts that fly: frame slots, masks, odometry. What every program that flies shares.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <string>

#include "firmware_app/config/config.h"
#include "firmware_app/dynamic/dynamic_masks.h"
#include "firmware_app/pipeline/frame_view.h"
#include "firmware_app/pipeline/mask_source.h"
#include "firmware_app/pipeline/pipeline.h"
#include "firmware_app/pipeline/stage.h"
#include "hal/camera/calibration.h"
#include "hal/imu/error_model.h"
#include "hal/rt/frame_pool.h"
#include "hal/rt/result.h"

namespace godwit::app {

/// What a program wants beside its configuration.
struct AssemblyPlan {
  std::string calibration_name;   ///< for errors; empty: the reason stands alone
  bool sequential = false;        ///< results of the mapper come pipeline.mapper_delay_frames later
  MaskSource* masks = nullptr;    ///< dynamic pixels from elsewhere; null: the detector's, where it is enabled
  FrameView* view = nullptr;      ///< may be null
  bool inertial = false;          ///< the pipeline has an inertial sensor, and it is to be used
  bool aided = false;             ///< it has none, and an autopilot's attitude is to be used
  hal::ImuErrorModel imu_errors;  ///< as the sensor's source says them; imu.calibration wins
  bool gyro_helps = true;         ///< vision, too; see OdometryOptions
  bool onlooker = false;          ///< slots for one (PipelineOptions::onlooker)
};

/// Destroyed from the last to the first: the pool outlives what points into it.
struct Assembly {
  std::unique_ptr<rt::FramePool> pool;
  std::unique_ptr<DynamicMasks> dynamic;  ///< null: detector.enabled is false
  std::unique_ptr<FrameStage> stage;

  /// Tells the pipeline of the detector, if there is one, and the scheduler of its inputs.
  void plan_detector(PipelineOptions* options) const;
};

/// Where the camera sits on the axes of the inertial sensor, or of the autopilot: as the calibration says, which was
/// made with that sensor; or else as link.T_body_cam does. Nothing: neither says it.
std::optional<std::array<double, 16>> inertial_mounting(const Config& config,
                                                        const hal::CameraCalibration& calibration);

/// Takes all memory, loads the networks that the configuration wants and runs each once. Error, with file or key and
/// reason: an absurd calibration, too few frame slots, a network that is missing or broken.
rt::Result<Assembly> assemble(const Config& config, const hal::CameraCalibration& calibration,
                              const AssemblyPlan& plan);

}  // namespace godwit::app
