// LibcameraCamera on a real driver: vimc, the kernel's own emulated camera with a pipeline. Runs as root in a machine
// of its own.
//   godwit_libcamera_check ID FRAMES
// Prints what it checked; ends with 1 if something failed.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <thread>
#include <utility>

#include "hal/camera/libcamera/libcamera_camera.h"
#include "tests/vm/camera_watch.h"
#include "tests/vm/check.h"

namespace {
using namespace godwit;
using namespace godwit::hal;
using godwit::vm::CameraWatch;
using godwit::vm::check;
using godwit::vm::failures;
using godwit::vm::Seen;

CameraWatch watch(const DeviceSettings& settings) {
  return {settings, true, [&](DeviceCamera::Tell tell) -> rt::Result<std::unique_ptr<DeviceCamera>> {
            auto library = load_libcamera();
            if (!library) return library.error();
            auto opened = LibcameraCamera::open(std::move(library).value(), linux_clocks(), settings, std::move(tell));
            if (!opened) return opened.error();
            return std::unique_ptr<DeviceCamera>(std::move(opened).value());
          }};
}

bool refused(const DeviceSettings& settings, const char* words) {
  CameraWatch w = watch(settings);
  w.take(1, rt::kNsPerSecond);
  return w.told(words);
}

void formats(DeviceSettings settings, int frames) {
  for (const auto& [width, height] : {std::pair{636, 480}, std::pair{750, 480}}) {
    for (const PixelFormat format : {PixelFormat::kBgr3, PixelFormat::kRgb3}) {
      settings.width = width;
      settings.height = height;
      settings.format = format;
      CameraWatch w = watch(settings);
      const Seen s = w.take(frames, 120 * rt::kNsPerSecond);
      // Emulated: pictures may be late and lost, but what comes is whole, in order and dated within the time it took.
      check(s.frames == frames && s.bad == 0 && s.not_later == 0 && s.oldest < 2 * rt::kNsPerSecond && s.values >= 6 &&
                s.colours > 1000 && w.camera->clock().source() == DeviceClock::Source::kMonotonic,
            std::string(name(format)) + " " + std::to_string(width) + "x" + std::to_string(height) + ": " + w.text(s));
    }
  }
}

/// All buffers lie filled for a while, then they go round again: it is no reason to open anew, and no picture is bad.
/// Those that lay there are as old as they are.
void left_alone(const DeviceSettings& settings) {
  CameraWatch w = watch(settings);
  if (w.camera == nullptr) return;
  w.take(10, 60 * rt::kNsPerSecond);
  std::this_thread::sleep_for(std::chrono::seconds(3));
  const Seen s = w.take(30, 60 * rt::kNsPerSecond);
  const DeviceCounters& c = w.camera->counters();
  check(s.frames == 30 && s.not_later == 0 && s.bad == 0 && s.oldest > 2 * rt::kNsPerSecond && c.gone == 0 &&
            c.stalls == 0,
        "nobody looks for three seconds: " + w.text(s) + "; " + std::to_string(s.not_later) + " not later, " +
            std::to_string(c.gone) + " times gone, " + std::to_string(c.stalls) + " stalls");
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return std::puts("godwit_libcamera_check ID FRAMES"), 2;
  DeviceSettings settings;
  settings.device = argv[1];
  settings.width = 636;
  settings.height = 480;
  formats(settings, std::atoi(argv[2]));
  DeviceSettings wrong = settings;
  wrong.width = 640;  // its scaler takes three pixels for one
  check(refused(wrong, "gives pictures of 636x480, not the 640x480 of the calibration"),
        "a size it cannot give is told");
  wrong = settings;
  wrong.format = PixelFormat::kNv12;
  check(refused(wrong, "does not offer NV12"), "a format it has not is told");
  wrong = settings;
  wrong.device = "index:9";
  check(refused(wrong, "no camera of number 9; there are"), "a camera that is not there is told");
  left_alone(settings);
  return failures == 0 ? 0 : 1;
}
