// The camera that godwitd's configuration names.
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "firmware_app/config/config.h"
#include "hal/camera/calibration.h"
#include "hal/camera/camera.h"
#include "hal/replay_time.h"
#include "hal/rt/result.h"
#include "hal/sim/flight/flight.h"

namespace godwit::app {

/// Opened in two steps, so that the node is on the bus before pictures are decoded or rendered.
class DaemonCamera {
 public:
  using Say = std::function<void(const std::string&)>;

  /// Finds out what can be known without the camera: its calibration, if it is there. Error: a scenario that is wrong.
  /// once: it is flown forth only, so that what was recorded beside it goes with it.
  static rt::Result<DaemonCamera> find(const Config::Camera& config, bool once);

  /// Known after find() where the recording is there, and always after open().
  const std::optional<hal::CameraCalibration>& calibration() const { return calibration_; }

  /// Opens it. A recording that is not there is told once and looked for again and again; waiting() is called
  /// meanwhile, at least every 100 ms. feeder: see open_camera(). Error: stopped, or it cannot be. Blocks.
  rt::Result<void> open(const Config::Camera& config, const rt::ThreadPlan& feeder, const Say& say,
                        const std::function<void()>& waiting, const std::atomic<bool>& stop);

  hal::Camera* camera() const { return camera_.get(); }
  /// Of "sim"; null for others.
  const sim::Flight* flight() const { return flight_.get(); }
  /// Where the recording lies on the clock; null: it goes forth and back, or there is none.
  const hal::ReplayTime* time() const { return once_.get(); }

 private:
  rt::Result<void> render(const Config::Camera& config, const Say& say, const std::atomic<bool>& stop);
  rt::Result<void> replay(const Config::Camera& config, const Say& say, const std::function<void()>& waiting,
                          const std::atomic<bool>& stop);

  std::unique_ptr<hal::ReplayTime> once_;
  std::unique_ptr<sim::Flight> flight_;
  std::unique_ptr<hal::Camera> camera_;
  std::optional<hal::CameraCalibration> calibration_;
};

}  // namespace godwit::app
