// A V4l2Camera on a device that the test plays, and pictures taken from it one by one.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <gtest/gtest.h>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "hal/camera/v4l2/v4l2_camera.h"
#include "tests/camera/fake_video.h"

namespace godwit::hal {

inline constexpr rt::TimeNs kFrameNs = 33 * rt::kNsPerMs;

/// What the camera told, from its own thread.
struct Told {
  std::mutex mutex;
  std::string all;
  bool has(const std::string& words) {
    const std::lock_guard<std::mutex> lock(mutex);
    return all.find(words) != std::string::npos;
  }
};

class V4l2CameraTest : public ::testing::Test {
 protected:
  void open() {
    settings_.device = settings_.device.empty() ? "/dev/video0" : settings_.device;
    if (settings_.width == 0) settings_.width = 64;
    if (settings_.height == 0) settings_.height = 48;
    auto camera =
        V4l2Camera::open(std::make_unique<test::FakeVideo>(&device_), settings_, [this](const std::string& text) {
          const std::lock_guard<std::mutex> lock(told_.mutex);
          told_.all += text + "\n";
        });
    ASSERT_TRUE(camera.ok());
    camera_ = std::move(camera).value();
    pixels_.assign(static_cast<std::size_t>(settings_.width * settings_.height), 0);
    bgr_.assign(pixels_.size() * 3, 0);
    why_.reserve(256);
  }
  rt::MutableImageView grey() { return {pixels_.data(), settings_.width, settings_.height, settings_.width}; }
  CameraStatus next(rt::TimeNs timeout_ns = rt::kNsPerMs) {
    return camera_->next(grey(), bgr_.data(), timeout_ns, &frame_, &why_);
  }
  /// One picture taken and read a little later.
  CameraStatus shoot(std::uint8_t value = 7, std::uint32_t flags = 0, std::int64_t bytes = -1) {
    device_.now_ns += kFrameNs;
    stamp_ns_ += kFrameNs;
    EXPECT_TRUE(device_.shoot(value, stamp_ns_, sequence_++, flags, bytes));
    return next();
  }
  /// Waits for what the camera's own thread does, as long as it takes.
  void until(const std::function<bool()>& done) {
    for (int i = 0; i < 6000 && !done(); ++i) {
      next(rt::kNsPerMs);
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    ASSERT_TRUE(done());
  }

  test::FakeDevice device_;
  V4l2Settings settings_;
  Told told_;
  std::unique_ptr<V4l2Camera> camera_;
  std::vector<std::uint8_t> pixels_, bgr_;
  CapturedFrame frame_;
  std::string why_;
  rt::TimeNs stamp_ns_ = 100 * rt::kNsPerSecond - 5 * rt::kNsPerMs;
  std::uint32_t sequence_ = 0;
};

}  // namespace godwit::hal
