// A camera of libcamera's as a Camera.
#pragma once

#include <memory>

#include "hal/camera/device/device_camera.h"
#include "hal/camera/libcamera/libcamera_system.h"

namespace godwit::hal {

class LibcameraCamera final : public DeviceCamera {
 public:
  /// Opens the camera. One that is not there, or refuses, is no error: it is told and looked for. settings.exposure:
  /// off or fixed. Error: no thread.
  static rt::Result<std::unique_ptr<LibcameraCamera>> open(std::unique_ptr<LibcameraSystem> system,
                                                           std::unique_ptr<MachineClocks> clocks,
                                                           const DeviceSettings& settings, Tell tell);

 private:
  using DeviceCamera::DeviceCamera;
};

}  // namespace godwit::hal
