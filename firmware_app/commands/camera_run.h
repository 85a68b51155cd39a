// Any camera through the pipeline into a folder of results: what replay and fly have in common.
#pragma once

#include <atomic>
#include <cstdint>
#include <string>

#include "firmware_app/config/config.h"
#include "firmware_app/pipeline/mask_source.h"
#include "firmware_app/pipeline/pipeline.h"
#include "hal/aid/aid.h"
#include "hal/camera/calibration.h"
#include "hal/camera/camera.h"
#include "hal/imu/error_model.h"
#include "hal/imu/imu.h"

namespace godwit::app {

/// What a command line says of a run, wherever its pictures come from.
struct RunOptions {
  std::string out = "out";
  std::string pace = "max";
  bool sequential = false;
  std::int64_t start = 0;
  std::int64_t frames = 0;  ///< pictures; 0: all
  std::string view;         ///< folder for pictures of what was seen; empty: none
  std::int64_t view_every = 30;
  std::string events;    ///< folder for the event recorder; empty: there is none
  std::string log;       ///< folder for the flight log; empty: there is none
  std::string as_flown;  ///< flight log that is flown again; empty: a flight of its own
};

/// How a run goes and what its summary says of it.
struct CameraRunPlan : RunOptions {
  std::string source;              ///< sequence or scenario, for the summary
  std::string calibration_name;    ///< file or scenario, for errors
  std::int64_t total = 0;          ///< pictures to come, for the progress bar
  MaskSource* masks = nullptr;     ///< dynamic pixels from elsewhere; null: the detector's, where it is enabled
  hal::Imu* imu = nullptr;         ///< read and watched beside the camera; null: none
  hal::AidSource* aids = nullptr;  ///< used with `inertial` or `aided`; null: none
  bool inertial = false;           ///< `imu` is used: poses are metric and level
  hal::ImuErrorModel imu_errors;   ///< as the sensor's source says them
  bool aided = false;              ///< the attitude among `aids` is, and they are the same without an IMU
  bool gyro_helps = true;          ///< vision, too; see OdometryOptions
  FrameSink* beside = nullptr;     ///< hears each record, too; null: nobody
};

/// Says on the error stream what is wrong and returns kExitRefused.
int refuse(const std::string& message);
/// Says on the error stream what went wrong and returns kExitFailed.
int failed(const std::string& message);

/// Flies the camera to its end or until *stop becomes true, writes trajectory.tum, frames.csv, pose.csv and
/// summary.json to plan.out, tells the figures, and returns an ExitCode.
int run_camera(hal::Camera* camera, const hal::CameraCalibration& calibration, const Config& config,
               const CameraRunPlan& plan, const std::atomic<bool>& stop);

}  // namespace godwit::app
