// What the checks of cameras in the virtual machine share: pictures taken from a device, and what they were like.
#pragma once

#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "hal/camera/device/device_camera.h"
#include "tests/vm/check.h"

namespace godwit::vm {

struct Seen {
  int frames = 0, bad = 0;
  int not_later = 0;            ///< capture times that did not advance
  rt::TimeNs oldest = 0;        ///< from capture to delivery
  double mean_interval_ms = 0;  ///< of capture times
  int values = 0;               ///< different grey values in the last picture
  int colours = 0;              ///< its pixels that are not grey; 0 where colour was not asked for
  std::string why;              ///< the last bad one's reason
};

class CameraWatch {
 public:
  using Open = std::function<rt::Result<std::unique_ptr<hal::DeviceCamera>>(hal::DeviceCamera::Tell)>;

  /// colour: pictures are converted to BGR, too; slow under emulation. What the camera tells is printed.
  CameraWatch(const hal::DeviceSettings& settings, bool colour, const Open& open)
      : width_(settings.width), height_(settings.height) {
    grey_.resize(static_cast<std::size_t>(width_ * height_));
    if (colour) bgr_.resize(grey_.size() * 3);
    auto opened = open([this](const std::string& text) { hear(text); });
    if (check(opened.ok(), "the camera's thread starts" + (opened ? std::string() : ": " + opened.error().message))) {
      camera = std::move(opened).value();
    }
  }

  /// Takes so many pictures, or as many as come in the time.
  Seen take(int frames, rt::TimeNs most_ns) {
    Seen out;
    std::string why;
    const rt::TimeNs end = rt::monotonic_now_ns() + most_ns;
    rt::TimeNs first = 0, last = 0;
    while (camera != nullptr && out.frames < frames && rt::monotonic_now_ns() < end) {
      hal::CapturedFrame f;
      const auto status = camera->next({grey_.data(), width_, height_, width_}, bgr_.empty() ? nullptr : bgr_.data(),
                                       100 * rt::kNsPerMs, &f, &why);
      if (status == hal::CameraStatus::kBadFrame) {
        ++out.bad;
        out.why = why;
      }
      if (status != hal::CameraStatus::kFrame) continue;
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

  /// Of the last picture.
  double mean() const { return hal::measure_brightness({grey_.data(), width_, height_, width_}).mean; }

  std::string text(const Seen& s) const {
    char out[240];
    std::snprintf(out, sizeof out, "%d frames every %.1f ms, %d bad%s%s, %llu lost, oldest %.0f ms, %d grey values",
                  s.frames, s.mean_interval_ms, s.bad, s.why.empty() ? "" : ": ", s.why.c_str(),
                  static_cast<unsigned long long>(camera ? camera->counters().lost : 0), rt::to_ms(s.oldest), s.values);
    return out;
  }

  /// Whether the camera told these words.
  bool told(const std::string& words) {
    const std::lock_guard<std::mutex> lock(mutex_);
    return told_.find(words) != std::string::npos;
  }

 private:
  void hear(const std::string& text) {
    const std::lock_guard<std::mutex> lock(mutex_);
    told_ += text + "\n";
    if (!text.empty()) std::printf("      | %s\n", text.c_str());
  }

  const int width_, height_;
  std::vector<std::uint8_t> grey_, bgr_;
  std::mutex mutex_;
  std::string told_;

 public:
  /// Null: it was not opened, which is a failure that was told. Last, so that it goes first: until then it tells.
  std::unique_ptr<hal::DeviceCamera> camera;
};

}  // namespace godwit::vm
