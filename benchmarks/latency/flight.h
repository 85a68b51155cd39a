// One flight of the latency benchmark: a camera that costs nothing, the pipeline as the daemon flies it, and the watch.
#pragma once

#include <atomic>
#include <memory>
#include <string>

#include "benchmarks/latency/figures.h"
#include "benchmarks/latency/options.h"
#include "firmware_app/config/config.h"
#include "firmware_app/sim/looped_pictures.h"
#include "hal/camera/calibration.h"
#include "hal/rt/result.h"

namespace godwit::bench {

/// The pictures to fly, in memory, and how they were seen; or what is known of a live camera before it is opened.
struct Pictures {
  std::string name;                             ///< of the sequence, the scenario or the device
  std::unique_ptr<app::LoopedPictures> camera;  ///< null: live
  hal::CameraCalibration calibration;
  double fps = 30;
};

/// Reads or renders them; they are grey. Error: no such sequence or scenario, a wrong calibration, interrupted.
rt::Result<Pictures> load_pictures(const Options& options, const std::atomic<bool>& stop);

/// The camera of this configuration, flown as it comes. Error: it names no device, or one that cannot be flown.
rt::Result<Pictures> live_pictures(const app::Config& config);

/// Flies for options.seconds at the camera's pace. Error: what the pipeline or the link refused, interrupted.
rt::Result<FlightFigures> fly(const Pictures& pictures, const Options& options, app::Config config, bool detector,
                              const std::atomic<bool>& stop);

}  // namespace godwit::bench
