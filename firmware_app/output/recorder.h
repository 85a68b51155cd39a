// A camera and an inertial sensor into a folder that `godwit replay` takes: EuRoC's layout.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <string>

#include "hal/camera/camera.h"
#include "hal/imu/imu.h"
#include "hal/rt/result.h"

namespace godwit::app {

struct RecorderOptions {
  std::string out;
  std::string calibration;  ///< the calibration file's text, kept as camera.yaml; empty: none
  std::string calibration_name = "sensor.yaml";
  double seconds = 0;                      ///< 0: until stopped
  std::uint64_t free_bytes = 500'000'000;  ///< so much of the disc is left free: the recording ends there
};

struct Recorded {
  std::uint64_t pictures = 0, bad = 0;
  std::uint64_t missed = 0;   ///< of the camera's sequence: due, and neither written nor bad
  std::uint64_t dropped = 0;  ///< no slot was free: the disc was too slow
  std::uint64_t samples = 0, imu_faults = 0;
  double seconds = 0;
  bool disc_full = false;  ///< ended because the disc was
};

/// What has been done so far, a few times a second.
using RecorderProgress = std::function<void(const Recorded&, std::uint64_t free_bytes)>;

/// Records until the camera is at its end, the time is up, *stop becomes true or the disc is nearly full; pictures as
/// lossless PNG. Without a camera: the inertial sensor alone. The camera is read by a thread of its own into slots, the
/// IMU by another, three threads write: a disc that hangs for two seconds loses nothing at 60 Hz. Writes
/// out/mav0/cam0/data/, data.csv and sensor.yaml, and out/mav0/imu0/data.csv, with a sensor.yaml where the sensor knows
/// the ends of its axes; the list of pictures comes last. Error: what cannot be written; a folder that already holds a
/// recording.
rt::Result<Recorded> record_devices(hal::Camera* camera, hal::Imu* imu, const RecorderOptions& options,
                                    const RecorderProgress& progress, const std::atomic<bool>& stop);

}  // namespace godwit::app
