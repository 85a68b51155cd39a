#include "hal/camera/libcamera/libcamera_camera.h"

#include <utility>

#include "hal/camera/libcamera/libcamera_stream.h"

namespace godwit::hal {

rt::Result<std::unique_ptr<LibcameraCamera>> LibcameraCamera::open(std::unique_ptr<LibcameraSystem> system,
                                                                   std::unique_ptr<MachineClocks> clocks,
                                                                   const DeviceSettings& settings, Tell tell) {
  // Shared, as a std::function is copied; nobody else has it, and it outlives the streams.
  auto open_stream = [shared = std::shared_ptr<LibcameraSystem>(std::move(system)),
                      settings](std::optional<PixelFormat> format) -> rt::Result<std::unique_ptr<PictureStream>> {
    DeviceSettings wanted = settings;
    wanted.format = format;
    auto opened = LibcameraStream::open(shared.get(), wanted);
    if (!opened) return opened.error();
    return std::unique_ptr<PictureStream>(std::move(opened).value());
  };
  std::unique_ptr<LibcameraCamera> out(
      new LibcameraCamera(std::move(clocks), settings, std::move(open_stream), std::move(tell)));
  if (auto begun = out->begin("gw-libcamera"); !begun) return begun.error();
  return out;
}

}  // namespace godwit::hal
