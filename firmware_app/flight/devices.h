// The camera and the inertial sensor that a configuration names, opened.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "firmware_app/config/config.h"
#include "hal/camera/calibration.h"
#include "hal/camera/camera.h"
#include "hal/camera/libcamera/libcamera_system.h"
#include "hal/camera/v4l2/v4l2_stream.h"
#include "hal/imu/imu.h"
#include "hal/rt/result.h"

namespace godwit::app {

/// Hears what a device has to say in words; may be called from a device's own thread.
using DeviceLog = std::function<void(const std::string&)>;

struct OpenedCamera {
  std::unique_ptr<hal::Camera> camera;
  hal::CameraCalibration calibration;
};

/// camera.source "v4l2" as settings of the driver; readout and picture size come from the calibration. Error: names the
/// key and the reason.
rt::Result<hal::V4l2Settings> v4l2_settings(const Config::Camera& config, const hal::CameraCalibration& calibration);

/// camera.source "libcamera" as settings of the device; as above.
rt::Result<hal::DeviceSettings> libcamera_settings(const Config::Camera& config,
                                                   const hal::CameraCalibration& calibration);

/// The device of a camera.source that is one. A device that is not there is no error: it is told and looked for. Error:
/// what is wrong with the calibration or a key. Blocks. feeder: how the thread runs that decodes where that is needed
/// (MJPEG).
rt::Result<OpenedCamera> open_camera(const Config::Camera& config, const DeviceLog& log,
                                     const rt::ThreadPlan& feeder = {});

/// The same where there is no calibration yet: pictures of this size.
rt::Result<std::unique_ptr<hal::Camera>> open_camera_of_size(const Config::Camera& config, int width, int height,
                                                             const rt::ThreadPlan& feeder, const DeviceLog& log);

/// The inertial sensor; null where imu.source is no device. As above.
rt::Result<std::unique_ptr<hal::Imu>> open_imu(const Config::Imu& config, const DeviceLog& log);

/// Adds to *report what is wrong with the keys of devices, without touching one. Reads the calibration.
void check_devices(ConfigReport* report);

}  // namespace godwit::app
