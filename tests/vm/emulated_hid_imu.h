// An inertial sensor on the kernel's HID bus (/dev/uhid), as an Intel D435i is one: gyroscope and accelerometer, each
// with its interval, and times in microseconds since it was plugged in, of 32 bits. The kernel's own drivers
// (hid-sensor-gyro-3d, hid-sensor-accel-3d) make two IIO devices of it.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <fcntl.h>
#include <initializer_list>
#include <linux/uhid.h>
#include <memory>
#include <poll.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include "hal/rt/time.h"

namespace godwit::vm {

class EmulatedHidImu {
 public:
  /// since_ns: how long ago it says that it was plugged in.
  explicit EmulatedHidImu(rt::TimeNs since_ns) : plugged_in_ns_(rt::monotonic_now_ns() - since_ns) {
    fd_ = ::open("/dev/uhid", O_RDWR | O_CLOEXEC);
    auto event = std::make_unique<uhid_event>();
    event->type = UHID_CREATE2;
    auto& create = event->u.create2;
    std::snprintf(reinterpret_cast<char*>(create.name), sizeof create.name, "an emulated D435i");
    const std::vector<std::uint8_t> description = describe();
    create.rd_size = static_cast<std::uint16_t>(description.size());
    create.bus = 3;  // BUS_USB
    create.vendor = 0x8086;
    create.product = 0x0B3A;
    std::memcpy(create.rd_data, description.data(), description.size());
    write(*event);
    thread_ = std::thread([this] { serve(); });
  }
  /// Unplugged.
  ~EmulatedHidImu() {
    stop_ = true;
    thread_.join();
    ::close(fd_);
  }
  EmulatedHidImu(const EmulatedHidImu&) = delete;
  EmulatedHidImu& operator=(const EmulatedHidImu&) = delete;

  bool there() const { return fd_ >= 0 && written_; }
  /// Its clock stands at this from now on.
  void set_clock(rt::TimeNs since_ns) { plugged_in_ns_ = rt::monotonic_now_ns() - since_ns; }

  std::atomic<bool> mute{false};
  std::atomic<bool> noise{true};
  /// In thousandths of 9.80665 m/s^2, and tenths of a degree a second.
  std::array<std::atomic<std::int32_t>, 3> accel{12, -24, 1000}, gyro{305, -610, 915};

 private:
  static constexpr std::uint8_t kGyro = 1, kAccel = 2;  // report ids

  /// A collection of two sensors by HID's usage tables, page 0x20.
  static std::vector<std::uint8_t> describe() {
    std::vector<std::uint8_t> out{0x05, 0x20, 0x09, 0x01, 0xA1, 0x01};
    const auto add = [&](std::initializer_list<std::uint8_t> bytes) { out.insert(out.end(), bytes); };
    const auto sensor = [&](std::uint8_t id, std::uint8_t usage, std::uint8_t axes, std::uint8_t exponent) {
      add({0x85, id, 0x05, 0x20, 0x09, usage, 0xA1, 0x00});
      // Reporting state (0x0316) and power state (0x0319), each one of six names; report interval (0x030E) [ms].
      using Names = std::array<std::uint8_t, 2>;
      for (const auto& [property, first] : {Names{0x16, 0x40}, Names{0x19, 0x50}}) {
        add({0x0A, property, 0x03, 0x15, 0x01, 0x25, 0x06, 0x75, 0x08, 0x95, 0x01, 0xA1, 0x02});
        for (std::uint8_t i = 0; i < 6; ++i) add({0x0A, static_cast<std::uint8_t>(first + i), 0x08});
        add({0xB1, 0x00, 0xC0});
      }
      add({0x0A, 0x0E, 0x03, 0x15, 0x00, 0x27, 0xFF, 0xFF, 0xFF, 0x7F, 0x75, 0x20, 0x95, 0x01, 0x55, 0x00, 0xB1, 0x02});
      for (std::uint8_t i = 0; i < 3; ++i) {
        add({0x0A,     static_cast<std::uint8_t>(axes + i),
             0x04,     0x17,
             0x00,     0x00,
             0x00,     0x80,
             0x27,     0xFF,
             0xFF,     0xFF,
             0x7F,     0x75,
             0x20,     0x95,
             0x01,     0x55,
             exponent, 0x81,
             0x02});
      }
      // Its time (0x0529), in seconds by 10^-6: the driver reads 64 bits.
      add({0x0A, 0x29, 0x05, 0x15, 0x00, 0x27, 0xFF, 0xFF, 0xFF, 0x7F, 0x75, 0x20, 0x95, 0x02, 0x55, 0x0A, 0x81, 0x02});
      add({0xC0});
    };
    sensor(kGyro, 0x76, 0x57, 0x0F);
    sensor(kAccel, 0x73, 0x53, 0x0D);
    add({0xC0});
    return out;
  }

  void write(const uhid_event& event) {
    written_ = ::write(fd_, &event, sizeof event) == static_cast<ssize_t>(sizeof event);
  }

  void serve() {
    auto event = std::make_unique<uhid_event>();
    std::array<rt::TimeNs, 3> due_ns{};
    while (!stop_) {
      pollfd p{fd_, POLLIN, 0};
      if (::poll(&p, 1, 1) > 0 && ::read(fd_, event.get(), sizeof *event) > 0) answer(*event);
      for (const std::uint8_t id : {kGyro, kAccel}) {
        const rt::TimeNs now_ns = rt::monotonic_now_ns();
        if (!open_ || mute || now_ns < due_ns[id]) continue;
        // Late by so much that it would catch up with itself: it left some out, as a sensor does not.
        const rt::TimeNs step_ns = interval_ms_[id] * rt::kNsPerMs;
        due_ns[id] = now_ns - due_ns[id] > 100 * rt::kNsPerMs ? now_ns + step_ns : due_ns[id] + step_ns;
        report(id, due_ns[id] - step_ns);
      }
    }
  }

  void answer(const uhid_event& event) {
    auto reply = std::make_unique<uhid_event>();
    switch (event.type) {
      case UHID_OPEN:
        open_ = true;
        return;
      case UHID_CLOSE:
        open_ = false;
        return;
      case UHID_SET_REPORT: {
        const auto& set = event.u.set_report;
        if (set.rnum == kGyro || set.rnum == kAccel) {
          states_[set.rnum] = {set.data[1], set.data[2]};
          std::uint32_t ms = 0;
          std::memcpy(&ms, set.data + 3, sizeof ms);
          if (ms != 0) interval_ms_[set.rnum] = ms;
        }
        reply->type = UHID_SET_REPORT_REPLY;
        reply->u.set_report_reply.id = set.id;
        break;
      }
      case UHID_GET_REPORT: {
        const auto& get = event.u.get_report;
        auto& out = reply->u.get_report_reply;
        reply->type = UHID_GET_REPORT_REPLY;
        out.id = get.id;
        out.size = 7;
        out.data[0] = get.rnum;
        const std::uint8_t id = get.rnum == kGyro ? kGyro : kAccel;
        out.data[1] = states_[id][0];
        out.data[2] = states_[id][1];
        std::memcpy(out.data + 3, &interval_ms_[id], 4);
        break;
      }
      default:
        return;
    }
    write(*reply);
  }

  void report(std::uint8_t id, rt::TimeNs t_ns) {
    auto event = std::make_unique<uhid_event>();
    event->type = UHID_INPUT2;
    auto& input = event->u.input2;
    input.size = 1 + 3 * 4 + 8;
    input.data[0] = id;
    if (noise) ++noisy_[id];  // every reading differs from the one before it
    for (std::size_t i = 0; i < 3; ++i) {
      std::int32_t value = (id == kGyro ? gyro : accel)[i];
      if (noise) value += static_cast<std::int32_t>((noisy_[id] + i) % 3) - 1;
      std::memcpy(input.data + 1 + 4 * i, &value, 4);
    }
    const auto t_us = static_cast<std::uint32_t>((t_ns - plugged_in_ns_) / 1000);
    std::memcpy(input.data + 13, &t_us, 4);
    write(*event);
  }

  std::atomic<rt::TimeNs> plugged_in_ns_;
  int fd_ = -1;
  std::atomic<bool> written_{false}, stop_{false};
  bool open_ = false;
  std::array<std::array<std::uint8_t, 2>, 3> states_{{{1, 1}, {1, 1}, {1, 1}}};
  std::array<std::uint32_t, 3> interval_ms_{10, 10, 10};
  std::array<std::uint32_t, 3> noisy_{};
  std::thread thread_;
};

}  // namespace godwit::vm
