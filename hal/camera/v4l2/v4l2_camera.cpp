#include "hal/camera/v4l2/v4l2_camera.h"

#include <utility>

namespace godwit::hal {

rt::Result<std::unique_ptr<V4l2Camera>> V4l2Camera::open(std::unique_ptr<VideoSystem> system,
                                                         const V4l2Settings& settings, Tell tell) {
  // The camera owns the system and outlives its streams.
  auto open_stream = [machine = system.get(),
                      settings](std::optional<PixelFormat> format) -> rt::Result<std::unique_ptr<PictureStream>> {
    V4l2Settings wanted = settings;
    wanted.format = format;
    auto opened = V4l2Stream::open(machine, wanted);
    if (!opened) return opened.error();
    return std::unique_ptr<PictureStream>(std::move(opened).value());
  };
  std::unique_ptr<V4l2Camera> out(new V4l2Camera(std::move(system), settings, std::move(open_stream), std::move(tell)));
  if (auto begun = out->begin("gw-v4l2"); !begun) return begun.error();
  return out;
}

}  // namespace godwit::hal
