// A V4L2 device as a Camera.
#pragma once

#include <memory>

#include "hal/camera/device/device_camera.h"
#include "hal/camera/v4l2/v4l2_stream.h"

namespace godwit::hal {

class V4l2Camera final : public DeviceCamera {
 public:
  /// Opens the device. One that is not there, or refuses, is no error: it is told and looked for. Error: no thread.
  static rt::Result<std::unique_ptr<V4l2Camera>> open(std::unique_ptr<VideoSystem> system, const V4l2Settings& settings,
                                                      Tell tell);

 private:
  using DeviceCamera::DeviceCamera;
};

}  // namespace godwit::hal
