// V4l2Camera on a real driver: vivid, the kernel's own emulated capture device. Runs as root in a machine of its own.
//   godwit_v4l2_check DEVICE FRAMES
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
#include "tests/vm/check.h"

namespace {
using namespace godwit;
using namespace godwit::hal;
using godwit::vm::check;
using godwit::vm::failures;
using godwit::vm::run;

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

struct Seen {
  int frames = 0, bad = 0;
  int not_later = 0;            ///< capture times that did not advance
  rt::TimeNs oldest = 0;        ///< from capture to delivery
  double mean_interval_ms = 0;  ///< of capture times
  int values = 0;               ///< different grey values in the last picture
  std::string why;
};

class Watch {
 public:
  Watch(std::unique_ptr<VideoSystem> system, const V4l2Settings& settings) : settings_(settings) {
    auto opened = V4l2Camera::open(std::move(system), settings, [](const std::string& text) {
      if (!text.empty()) std::printf("      | %s\n", text.c_str());
    });
    if (check(opened.ok(), "the camera's thread starts")) camera = std::move(opened).value();
    grey_.resize(static_cast<std::size_t>(settings.width * settings.height));
    bgr_.resize(grey_.size() * 3);
  }

  /// Takes so many pictures, or as many as come in the time.
  Seen take(int frames, rt::TimeNs most_ns) {
    Seen out;
    std::string why;
    const rt::TimeNs end = rt::monotonic_now_ns() + most_ns;
    rt::TimeNs first = 0, last = 0;
    while (out.frames < frames && rt::monotonic_now_ns() < end) {
      CapturedFrame f;
      const auto status = camera->next({grey_.data(), settings_.width, settings_.height, settings_.width},
                                       colour ? bgr_.data() : nullptr, 100 * rt::kNsPerMs, &f, &why);
      if (status == CameraStatus::kBadFrame) {
        ++out.bad;
        out.why = why;
      }
      if (status != CameraStatus::kFrame) continue;
      const rt::TimeNs age = rt::monotonic_now_ns() - f.t_capture_ns;
      out.oldest = std::max(out.oldest, age);
      if (last != 0 && f.t_capture_ns <= last) ++out.not_later;
      if (first == 0) first = f.t_capture_ns;
      last = f.t_capture_ns;
      ++out.frames;
    }
    if (out.frames > 1) out.mean_interval_ms = rt::to_ms(last - first) / (out.frames - 1);
    bool seen[256] = {};
    for (const std::uint8_t v : grey_) seen[v] = true;
    for (const bool s : seen) out.values += s ? 1 : 0;
    return out;
  }

  double mean() const {
    return measure_brightness({grey_.data(), settings_.width, settings_.height, settings_.width}).mean;
  }

  std::unique_ptr<V4l2Camera> camera;
  bool colour = false;  ///< converted, too: slow under emulation

 private:
  V4l2Settings settings_;
  std::vector<std::uint8_t> grey_, bgr_;
};

std::string text(const Seen& s, const DeviceCounters& c) {
  char out[240];
  std::snprintf(out, sizeof out, "%d frames every %.1f ms, %d bad%s%s, %llu lost, oldest %.0f ms, %d grey values",
                s.frames, s.mean_interval_ms, s.bad, s.why.empty() ? "" : ": ", s.why.c_str(),
                static_cast<unsigned long long>(c.lost), rt::to_ms(s.oldest), s.values);
  return out;
}

void formats(V4l2Settings settings, int frames) {
  for (const auto& [width, height] : {std::pair{640, 480}, std::pair{752, 480}}) {
    for (const PixelFormat format : kPixelFormats) {
      if (format == PixelFormat::kMjpeg) continue;  // vivid has none
      settings.width = width;
      settings.height = height;
      settings.format = format;
      Watch w(linux_video_system(), settings);
      const Seen s = w.take(frames, 120 * rt::kNsPerSecond);
      // Emulated: pictures may be late and lost, but what comes is whole, in order and dated within the time it took.
      check(s.frames == frames && s.bad == 0 && s.not_later == 0 && s.oldest < rt::kNsPerSecond && s.values >= 6 &&
                w.camera->clock().source() == DeviceClock::Source::kMonotonic,
            std::string(name(format)) + " " + std::to_string(width) + "x" + std::to_string(height) + ": " +
                text(s, w.camera->counters()));
    }
  }
}

void shifted_clock(const V4l2Settings& settings) {
  for (const bool known : {true, false}) {
    Watch w(std::make_unique<ShiftedClock>(29 * rt::kNsPerSecond, known), settings);
    const Seen s = w.take(60, 60 * rt::kNsPerSecond);
    check(s.frames == 60 && s.oldest >= -5 * rt::kNsPerMs && s.oldest < rt::kNsPerSecond &&
              w.camera->clock().source() == (known ? DeviceClock::Source::kCounter : DeviceClock::Source::kMeasured),
          std::string("a clock 29 s ahead is ") + (known ? "read by its offset: " : "measured: ") +
              text(s, w.camera->counters()));
  }
}

void injected(const V4l2Settings& settings, const std::string& ctl) {
  Watch w(linux_video_system(), settings);
  w.take(10, 20 * rt::kNsPerSecond);
  run(ctl + "inject_v4l2_buf_flag_error=1");
  Seen s = w.take(20, 20 * rt::kNsPerSecond);
  // Of bad pictures `why` is the last one's; the emulator may have held up another.
  check(s.bad >= 1 && s.frames == 20 && w.camera->counters().damaged >= 1, "a damaged buffer: " + s.why);
  run(ctl + "percentage_of_dropped_buffers=50");
  s = w.take(20, 20 * rt::kNsPerSecond);
  run(ctl + "percentage_of_dropped_buffers=0");
  check(w.camera->counters().lost > 0, "dropped buffers: " + text(s, w.camera->counters()));
  run(ctl + "inject_fatal_streaming_error=1");
  s = w.take(20, 30 * rt::kNsPerSecond);
  check(w.camera->counters().gone == 1 && w.camera->counters().back == 1 && s.frames == 20,
        "a fatal error: the stream comes back: " + text(s, w.camera->counters()));
  run(ctl + "inject_vidioc_streamon_error=1");
  run(ctl + "inject_fatal_streaming_error=1");
  s = w.take(20, 30 * rt::kNsPerSecond);
  check(w.camera->counters().back == 2 && s.frames == 20, "and after a STREAMON error it is tried again");
}

/// vivid stamps the end of a frame before it is there, most of a frame ahead: a clock that cannot be ours.
void future_stamps(V4l2Settings settings) {
  settings.controls = {{"timestamp_source", 0}};
  Watch w(linux_video_system(), settings);
  const Seen s = w.take(60, 60 * rt::kNsPerSecond);
  check(s.frames == 60 && w.camera->clock().source() == DeviceClock::Source::kMeasured,
        "stamps of the future are measured anew: " + text(s, w.camera->counters()));
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
    Watch w(linux_video_system(), settings);
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
  Watch fixed(linux_video_system(), settings);
  fixed.take(5, 20 * rt::kNsPerSecond);
  run("test $(" + ctl.substr(0, ctl.size() - 3) + "-C brightness | tr -dc 0-9) = 200");
  run(ctl + "brightness=128");
}

void unplugged(const V4l2Settings& settings, const std::string& ctl) {
  Watch w(linux_video_system(), settings);
  w.take(10, 20 * rt::kNsPerSecond);
  // vivid comes back by itself when the last program has let go of it.
  run(ctl + "disconnect=1");
  Seen s = w.take(20, 30 * rt::kNsPerSecond);
  check(s.frames == 20 && w.camera->counters().gone == 1 && w.camera->counters().back == 1,
        "disconnected under way, it comes back: " + text(s, w.camera->counters()));
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
  check(s.frames == 30 && s.not_later == 0, text(s, w.camera->counters()));
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return std::puts("godwit_v4l2_check DEVICE FRAMES|exposure"), 2;
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
  formats(settings, std::atoi(argv[2]));
  shifted_clock(settings);
  future_stamps(settings);
  injected(settings, ctl);
  unplugged(settings, ctl);
  return failures == 0 ? 0 : 1;
}
