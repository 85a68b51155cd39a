// V4l2Camera on a real driver: vivid, the kernel's own emulated capture device. Runs as root in a machine of its own.
//   godwit_v4l2_check DEVICE FRAMES             FRAMES of each format, 0: none, and all else but exposure
//   godwit_v4l2_check DEVICE exposure
//   godwit_v4l2_check DEVICE formats FRAMES
// Prints what it checked; ends with 1 if something failed.
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <functional>
#include <linux/videodev2.h>
#include <string>
#include <sys/stat.h>
#include <vector>

#include "hal/camera/v4l2/v4l2_camera.h"
#include "tests/vm/camera_watch.h"
#include "tests/vm/check.h"

namespace {
using namespace godwit;
using namespace godwit::hal;
using godwit::vm::CameraWatch;
using godwit::vm::check;
using godwit::vm::failures;
using godwit::vm::run;
using godwit::vm::Seen;

/// A driver that stamps in a clock which is `shift` ahead, as a Tegra's counter is.
class ShiftedClock final : public VideoSystem {
 public:
  ShiftedClock(rt::TimeNs shift_ns, bool known) : shift_ns_(shift_ns), known_(known) {}
  int open(const char* path) override { return real_->open(path); }
  void close(int descriptor) override { real_->close(descriptor); }
  int ioctl(int descriptor, unsigned long request, void* argument) override {
    const int result = real_->ioctl(descriptor, request, argument);
    if (request == VIDIOC_DQBUF && result == 0) {
      static_cast<v4l2_buffer*>(argument)->timestamp.tv_sec += shift_ns_ / rt::kNsPerSecond;
    }
    return result;
  }
  void* map(int descriptor, std::size_t bytes, std::int64_t offset) override {
    return real_->map(descriptor, bytes, offset);
  }
  void unmap(void* memory, std::size_t bytes) override { real_->unmap(memory, bytes); }
  Wait wait_readable(int descriptor, rt::TimeNs timeout_ns) override {
    return real_->wait_readable(descriptor, timeout_ns);
  }
  rt::TimeNs now_ns() override { return real_->now_ns(); }
  ClockOffsets clock_offsets() override {
    ClockOffsets out = real_->clock_offsets();
    if (known_) out.counter_ns = shift_ns_;
    return out;
  }
  void read_clocks(ClockOffsets* offsets) override { real_->read_clocks(offsets); }
  std::vector<VideoNode> nodes() override { return real_->nodes(); }

 private:
  std::unique_ptr<VideoSystem> real_ = linux_video_system();
  const rt::TimeNs shift_ns_;
  const bool known_;
};

/// Opens the device and watches it. By way of system, which a check may have made lie.
CameraWatch watch(const V4l2Settings& settings, std::unique_ptr<VideoSystem> system = linux_video_system()) {
  return {settings, false, [&](DeviceCamera::Tell tell) -> rt::Result<std::unique_ptr<DeviceCamera>> {
            auto opened = V4l2Camera::open(std::move(system), settings, std::move(tell));
            if (!opened) return opened.error();
            return std::unique_ptr<DeviceCamera>(std::move(opened).value());
          }};
}

void formats(V4l2Settings settings, int frames) {
  for (const auto& [width, height] : {std::pair{640, 480}, std::pair{752, 480}}) {
    for (const PixelFormat format : kPixelFormats) {
      if (format == PixelFormat::kMjpeg) continue;  // vivid has none
      settings.width = width;
      settings.height = height;
      settings.format = format;
      CameraWatch w = watch(settings);
      const Seen s = w.take(frames, 120 * rt::kNsPerSecond);
      // Emulated: pictures may be late and lost, but what comes is whole, in order and dated within the time it took.
      check(s.frames == frames && s.bad == 0 && s.not_later == 0 && s.oldest < rt::kNsPerSecond && s.values >= 6 &&
                w.camera->clock().source() == DeviceClock::Source::kMonotonic,
            std::string(name(format)) + " " + std::to_string(width) + "x" + std::to_string(height) + ": " + w.text(s));
    }
  }
}

void shifted_clock(const V4l2Settings& settings) {
  for (const bool known : {true, false}) {
    CameraWatch w = watch(settings, std::make_unique<ShiftedClock>(29 * rt::kNsPerSecond, known));
    const Seen s = w.take(60, 60 * rt::kNsPerSecond);
    check(s.frames == 60 && s.oldest >= -5 * rt::kNsPerMs && s.oldest < rt::kNsPerSecond &&
              w.camera->clock().source() == (known ? DeviceClock::Source::kCounter : DeviceClock::Source::kMeasured),
          std::string("a clock 29 s ahead is ") + (known ? "read by its offset: " : "measured: ") + w.text(s));
  }
}

void injected(const V4l2Settings& settings, const std::string& ctl) {
  CameraWatch w = watch(settings);
  w.take(10, 20 * rt::kNsPerSecond);
  run(ctl + "inject_v4l2_buf_flag_error=1");
  Seen s = w.take(20, 20 * rt::kNsPerSecond);
  // Of bad pictures `why` is the last one's; the emulator may have held up another.
  check(s.bad >= 1 && s.frames == 20 && w.camera->counters().damaged >= 1, "a damaged buffer: " + s.why);
  run(ctl + "percentage_of_dropped_buffers=50");
  s = w.take(20, 20 * rt::kNsPerSecond);
  run(ctl + "percentage_of_dropped_buffers=0");
  check(w.camera->counters().lost > 0, "dropped buffers: " + w.text(s));
  run(ctl + "inject_fatal_streaming_error=1");
  s = w.take(20, 30 * rt::kNsPerSecond);
  check(w.camera->counters().gone == 1 && w.camera->counters().back == 1 && s.frames == 20,
        "a fatal error: the stream comes back: " + w.text(s));
  run(ctl + "inject_vidioc_streamon_error=1");
  run(ctl + "inject_fatal_streaming_error=1");
  s = w.take(20, 30 * rt::kNsPerSecond);
  check(w.camera->counters().back == 2 && s.frames == 20, "and after a STREAMON error it is tried again");
}

/// vivid stamps the end of a frame before it is there, most of a frame ahead: a clock that cannot be ours.
void future_stamps(V4l2Settings settings) {
  settings.controls = {{"timestamp_source", 0}};
  CameraWatch w = watch(settings);
  const Seen s = w.take(60, 60 * rt::kNsPerSecond);
  check(s.frames == 60 && w.camera->clock().source() == DeviceClock::Source::kMeasured,
        "stamps of the future are measured anew: " + w.text(s));
}

/// vivid has no exposure, but a brightness that its pictures follow; its gain is a number alone. In YUYV, where it cuts
/// off below black and above white: in GREY a pixel that goes below black comes out white, so that less light makes a
/// brighter picture.
void automatic_exposure(V4l2Settings settings, const std::string& ctl) {
  settings.format = PixelFormat::kYuyv;
  settings.controls.push_back({"gain", 1});
  settings.exposure.mode = ExposureMode::kAutomatic;
  settings.exposure.exposure_control = "brightness";
  settings.exposure.exposure_unit_ns = 100'000;
  settings.exposure.automatic.target_mean = 90;
  settings.exposure.automatic.most_gain = 1;
  char text[120];
  {
    CameraWatch w = watch(settings);
    for (const char* const scene : {"contrast=128", "contrast=80", "contrast=140"}) {
      run(ctl + scene);
      // Emulated, pictures wait in the driver's buffers longer than a sensor's controls are late: it may swing at
      // first.
      int good = 0, pictures = 0;
      double darkest = 255, brightest = 0;  // of the last ones: whether it swings or stands
      for (; good < 20 && pictures < 400; ++pictures) {
        w.take(1, 10 * rt::kNsPerSecond);
        good = std::abs(w.mean() - 90) < 0.15 * 90 ? good + 1 : 0;
        if (pictures < 350) continue;
        darkest = std::min(darkest, w.mean());
        brightest = std::max(brightest, w.mean());
      }
      std::snprintf(text, sizeof text, "automatic exposure, %s: mean %.0f after %d pictures, wanted 90", scene,
                    w.mean(), pictures);
      if (good < 20) std::printf("      the last 50 had means of %.0f to %.0f\n", darkest, brightest);
      check(good == 20, text);
    }
    std::snprintf(text, sizeof text, "steered by %llu pictures", static_cast<unsigned long long>(w.camera->steered()));
    check(w.camera->steered() >= 30, text);
    run(ctl + "brightness=128");
  }
  settings.exposure.mode = ExposureMode::kFixed;
  settings.exposure.fixed = {20 * rt::kNsPerMs, 1};
  CameraWatch fixed = watch(settings);
  fixed.take(5, 20 * rt::kNsPerSecond);
  run("test $(" + ctl.substr(0, ctl.size() - 3) + "-C brightness | tr -dc 0-9) = 200");
  run(ctl + "brightness=128");
}

void unplugged(const V4l2Settings& settings, const std::string& ctl) {
  CameraWatch w = watch(settings);
  w.take(10, 20 * rt::kNsPerSecond);
  // vivid comes back by itself when the last program has let go of it.
  run(ctl + "disconnect=1");
  Seen s = w.take(20, 30 * rt::kNsPerSecond);
  check(s.frames == 20 && w.camera->counters().gone == 1 && w.camera->counters().back == 1,
        "disconnected under way, it comes back: " + w.text(s));
  run("echo vivid.0 > /sys/bus/platform/drivers/vivid/unbind");
  s = w.take(1000, 2 * rt::kNsPerSecond);
  check(!w.camera->streaming() && w.camera->counters().gone == 2, "a device that is unplugged is gone");
  s = w.take(1000, rt::kNsPerSecond);
  check(s.frames == 0, "and stays so");
  run("echo vivid.0 > /sys/bus/platform/drivers/vivid/bind");
  const rt::TimeNs began = rt::monotonic_now_ns();
  s = w.take(1, 30 * rt::kNsPerSecond);
  const double took_s = rt::to_seconds(rt::monotonic_now_ns() - began);
  check(s.frames == 1 && w.camera->counters().back == 2, "plugged in again it is back");
  std::printf("      first picture %.2f s after it was plugged in\n", took_s);
  s = w.take(30, 30 * rt::kNsPerSecond);
  check(s.frames == 30 && s.not_later == 0, w.text(s));
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3 && argc != 4) {
    return std::puts("godwit_v4l2_check DEVICE FRAMES|exposure|formats FRAMES"), 2;
  }
  V4l2Settings settings;
  settings.device = argv[1];
  settings.width = 640;
  settings.height = 480;
  settings.format = PixelFormat::kGrey;
  settings.controls = {{"timestamp_source", 1}};  // the start of the exposure
  const std::string ctl = std::string("v4l2-ctl -d ") + argv[1] + " -c ";
  if (std::string(argv[2]) == "exposure") {
    automatic_exposure(settings, ctl);
    return failures == 0 ? 0 : 1;
  }
  if (std::string(argv[2]) == "formats") {
    formats(settings, std::atoi(argc > 3 ? argv[3] : ""));
    return failures == 0 ? 0 : 1;
  }
  if (const int frames = std::atoi(argv[2]); frames > 0) {
    formats(settings, frames);
  } else {
    std::puts("      each format: elsewhere");
  }
  shifted_clock(settings);
  future_stamps(settings);
  injected(settings, ctl);
  unplugged(settings, ctl);
  return failures == 0 ? 0 : 1;
}
