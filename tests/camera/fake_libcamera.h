// A libcamera that a test plays: one camera that answers as told, truthfully or not, and clocks that go when the test
// says so.
#pragma once

#include <atomic>
#include <chrono>
#include <cstring>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "hal/camera/device/machine_clocks.h"
#include "hal/camera/libcamera/libcamera_system.h"
#include "tests/camera/fake_video.h"

namespace godwit::test {

/// The camera's side. What says "atomic" may change while it is open.
struct FakeLibcamera {
  // What it says of itself.
  std::vector<std::string> ids{"platform/fake.0 Sensor"};
  std::vector<hal::PixelFormat> formats{hal::PixelFormat::kGrey};
  std::string others;
  int width = 0, height = 0;     ///< of what it gives; 0: as asked
  std::string gives_format;      ///< another one, by name
  int stride = 0;                ///< 0: no padding
  std::size_t buffer_bytes = 0;  ///< 0: as many as needed
  std::uint32_t buffers = 0;     ///< 0: as asked
  std::string acquire_error, configure_error, start_error;
  hal::LibcameraPlan plan;  ///< of the newest session
  hal::ClockOffsets offsets;

  // What happens to it.
  std::atomic<bool> there{true};
  std::atomic<bool> takes_requests{true};
  std::atomic<rt::TimeNs> now_ns{100 * rt::kNsPerSecond};
  std::atomic<int> sessions{0};  ///< open ones
  std::atomic<int> opened{0};

  Spin spin;
  hal::RequestListener* listener = nullptr;
  std::unique_ptr<std::uint8_t[]> memory[16];
  std::size_t bytes = 0;
  std::uint32_t queue[16] = {};
  unsigned head = 0, queued = 0;

  /// A buffer that was queued; waits for the camera's own thread to do it. -1: none, for a minute.
  int take_queued() {
    for (int i = 0; i < 60'000; ++i) {
      spin.lock();
      const int index = queued > 0 ? static_cast<int>(queue[head % 16]) : -1;
      if (index >= 0) {
        ++head;
        --queued;
      }
      spin.unlock();
      if (index >= 0) return index;
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    return -1;
  }
  /// A request comes back, its buffer full of `value`. False: none was out.
  bool shoot(std::uint8_t value, hal::CompletedRequest request) {
    const int index = take_queued();
    if (index < 0) return false;
    std::memset(memory[index].get(), value, bytes);
    request.index = static_cast<std::uint32_t>(index);
    if (request.bytes == 0) request.bytes = bytes;
    listener->completed(request);
    return true;
  }
};

class FakeLibcameraSession final : public hal::LibcameraSession {
 public:
  explicit FakeLibcameraSession(FakeLibcamera* camera) : c_(*camera) {
    ++c_.sessions;
    ++c_.opened;
  }
  ~FakeLibcameraSession() override {
    c_.spin.lock();
    c_.listener = nullptr;
    c_.queued = 0;
    c_.spin.unlock();
    --c_.sessions;
  }
  std::vector<hal::PixelFormat> formats(std::string* others) override {
    *others = c_.others;
    return c_.formats;
  }
  rt::Result<hal::LibcameraGiven> configure(const hal::LibcameraPlan& plan) override {
    c_.plan = plan;
    if (!c_.configure_error.empty()) return rt::Error{c_.configure_error};
    hal::LibcameraGiven out;
    out.format = c_.gives_format;
    out.width = c_.width != 0 ? c_.width : plan.width;
    out.height = c_.height != 0 ? c_.height : plan.height;
    out.stride = c_.stride != 0 ? c_.stride : hal::row_bytes(plan.format, plan.width);
    c_.bytes =
        c_.buffer_bytes != 0 ? c_.buffer_bytes : hal::picture_bytes(plan.format, out.width, out.height, out.stride);
    for (std::uint32_t i = 0; i < (c_.buffers != 0 ? c_.buffers : plan.buffers); ++i) {
      c_.memory[i] = std::make_unique<std::uint8_t[]>(c_.bytes);
      out.buffers.push_back({c_.memory[i].get(), c_.bytes});
    }
    return out;
  }
  rt::Result<void> start(hal::RequestListener* listener) override {
    if (!c_.start_error.empty()) return rt::Error{c_.start_error};
    c_.listener = listener;
    return {};
  }
  bool queue(std::uint32_t index) override {
    if (!c_.takes_requests) return false;
    c_.spin.lock();
    c_.queue[(c_.head + c_.queued++) % 16] = index;
    c_.spin.unlock();
    return true;
  }

 private:
  FakeLibcamera& c_;
};

class FakeLibcameraSystem final : public hal::LibcameraSystem {
 public:
  explicit FakeLibcameraSystem(FakeLibcamera* camera) : c_(*camera) {}
  std::vector<std::string> cameras() override { return c_.there ? c_.ids : std::vector<std::string>(); }
  rt::Result<std::unique_ptr<hal::LibcameraSession>> acquire(const std::string&) override {
    if (!c_.acquire_error.empty()) return rt::Error{c_.acquire_error};
    return std::unique_ptr<hal::LibcameraSession>(std::make_unique<FakeLibcameraSession>(&c_));
  }

 private:
  FakeLibcamera& c_;
};

class FakeClocks final : public hal::MachineClocks {
 public:
  explicit FakeClocks(FakeLibcamera* camera) : c_(*camera) {}
  rt::TimeNs now_ns() override { return c_.now_ns; }
  hal::ClockOffsets clock_offsets() override { return c_.offsets; }
  void read_clocks(hal::ClockOffsets* offsets) override {
    offsets->boottime_ns = c_.offsets.boottime_ns;
    offsets->realtime_ns = c_.offsets.realtime_ns;
  }

 private:
  FakeLibcamera& c_;
};

}  // namespace godwit::test
