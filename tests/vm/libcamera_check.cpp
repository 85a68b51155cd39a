// LibcameraCamera on a real driver: vimc, the kernel's own emulated camera with a pipeline. Runs as root in a machine
// of its own.
//   godwit_libcamera_check ID FRAMES
// Prints what it checked; ends with 1 if something failed.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "hal/camera/libcamera/libcamera_camera.h"
#include "hal/camera/v4l2/video_system.h"
#include "tests/vm/check.h"

namespace {
using namespace godwit;
using namespace godwit::hal;
using godwit::vm::check;
using godwit::vm::failures;

struct Seen {
  int frames = 0, bad = 0;
  int not_later = 0;            ///< capture times that did not advance
  rt::TimeNs oldest = 0;        ///< from capture to delivery
  double mean_interval_ms = 0;  ///< of capture times
  int values = 0, colours = 0;  ///< different grey values, and pixels that are not grey, in the last picture
};

class Watch {
 public:
  explicit Watch(const DeviceSettings& settings) : settings_(settings) {
    grey_.resize(static_cast<std::size_t>(settings.width * settings.height));
    bgr_.resize(grey_.size() * 3);
    auto library = load_libcamera();
    if (!check(library.ok(), "libcamera is loaded" + (library ? std::string() : ": " + library.error().message)))
      return;
    auto opened = LibcameraCamera::open(std::move(library).value(), linux_video_system(), settings,
                                        [this](const std::string& text) { hear(text); });
    if (check(opened.ok(), "the camera's thread starts")) camera = std::move(opened).value();
  }

  Seen take(int frames, rt::TimeNs most_ns) {
    Seen out;
    std::string why;
    const rt::TimeNs end = rt::monotonic_now_ns() + most_ns;
    rt::TimeNs first = 0, last = 0;
    while (camera != nullptr && out.frames < frames && rt::monotonic_now_ns() < end) {
      CapturedFrame f;
      const auto status = camera->next({grey_.data(), settings_.width, settings_.height, settings_.width}, bgr_.data(),
                                       100 * rt::kNsPerMs, &f, &why);
      if (status == CameraStatus::kBadFrame) ++out.bad;
      if (status != CameraStatus::kFrame) continue;
      out.oldest = std::max(out.oldest, rt::monotonic_now_ns() - f.t_capture_ns);
      if (last != 0 && f.t_capture_ns <= last) ++out.not_later;
      if (first == 0) first = f.t_capture_ns;
      last = f.t_capture_ns;
      ++out.frames;
    }
    if (out.frames > 1) out.mean_interval_ms = rt::to_ms(last - first) / (out.frames - 1);
    bool seen[256] = {};
    for (const std::uint8_t v : grey_) seen[v] = true;
    for (const bool s : seen) out.values += s ? 1 : 0;
    for (std::size_t i = 0; i < bgr_.size(); i += 3) out.colours += bgr_[i] != bgr_[i + 1] ? 1 : 0;
    return out;
  }

  std::string told() {
    const std::lock_guard<std::mutex> lock(mutex_);
    return told_;
  }

  std::unique_ptr<LibcameraCamera> camera;

 private:
  void hear(const std::string& text) {
    const std::lock_guard<std::mutex> lock(mutex_);
    told_ += text + "\n";
    std::printf("      | %s\n", text.c_str());
  }

  DeviceSettings settings_;
  std::vector<std::uint8_t> grey_, bgr_;
  std::mutex mutex_;
  std::string told_;
};

std::string text(const Seen& s, const Watch& w) {
  char out[240];
  std::snprintf(out, sizeof out, "%d frames every %.1f ms, %d bad, %llu lost, oldest %.0f ms, %d grey values", s.frames,
                s.mean_interval_ms, s.bad, static_cast<unsigned long long>(w.camera ? w.camera->counters().lost : 0),
                rt::to_ms(s.oldest), s.values);
  return out;
}

bool refused(DeviceSettings settings, const char* words) {
  Watch w(settings);
  w.take(1, rt::kNsPerSecond);
  return w.told().find(words) != std::string::npos;
}

void formats(DeviceSettings settings, int frames) {
  for (const auto& [width, height] : {std::pair{636, 480}, std::pair{750, 480}}) {
    for (const PixelFormat format : {PixelFormat::kBgr3, PixelFormat::kRgb3}) {
      settings.width = width;
      settings.height = height;
      settings.format = format;
      Watch w(settings);
      const Seen s = w.take(frames, 120 * rt::kNsPerSecond);
      // Emulated: pictures may be late and lost, but what comes is whole, in order and dated within the time it took.
      check(s.frames == frames && s.bad == 0 && s.not_later == 0 && s.oldest < 2 * rt::kNsPerSecond && s.values >= 6 &&
                s.colours > 1000 && w.camera->clock().source() == DeviceClock::Source::kMonotonic,
            std::string(name(format)) + " " + std::to_string(width) + "x" + std::to_string(height) + ": " + text(s, w));
    }
  }
}

/// All buffers lie filled for a while, then they go round again; it is no reason to open anew. vimc counts none that it
/// left out, and what lay there for a second is bad: its clock seems to have jumped.
void left_alone(const DeviceSettings& settings) {
  Watch w(settings);
  if (w.camera == nullptr) return;
  w.take(10, 60 * rt::kNsPerSecond);
  std::this_thread::sleep_for(std::chrono::seconds(3));
  const Seen s = w.take(30, 60 * rt::kNsPerSecond);
  const DeviceCounters& c = w.camera->counters();
  check(s.frames == 30 && s.not_later == 0 && s.bad <= 6 && c.gone == 0 && c.stalls == 0,
        "nobody looks for three seconds: " + text(s, w));
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
