// Mpu6000 over spidev and IioImu over the kernel's inv-mpu6000-spi on an emulated chip (tests/vm/modules), which lies
// when told to; IioImu over the kernel's drivers of HID sensors on one that lies in tests/vm/emulated_hid_imu.h. Runs
// as root in a machine of its own.
//   godwit_imu_check spidev|iio|hid
// Prints what it checked; ends with 1 if something failed.
#include <cmath>
#include <cstdio>
#include <functional>
#include <memory>
#include <string>

#include "hal/imu/iio/iio_imu.h"
#include "hal/imu/mpu6000/mpu6000.h"
#include "tests/vm/check.h"
#include "tests/vm/emulated_hid_imu.h"

namespace {
using namespace godwit;
using namespace godwit::hal;
using godwit::vm::check;
using godwit::vm::failures;
using godwit::vm::run;

constexpr double kGravity = 9.80665;
constexpr double kDegree = M_PI / 180;

void set(const std::string& what, const std::string& to) {
  run("echo " + to + " > /sys/module/emulated_mpu6000/parameters/" + what);
}

struct Seen {
  int samples = 0, faults = 0, not_later = 0;
  int gaps = 0;  ///< that the sensor flagged: a chip's buffer runs over where the host had no time for the machine
  double mean_step_ms = 0;     ///< without them
  double longest_step_ms = 0;  ///< with them
  std::uint8_t flags = 0;      ///< of all
  ImuSample last;
};

/// So many samples, or as many as come in the time; and until is true, where it is given.
Seen take(Imu* imu, int samples, double most_s, const std::function<bool()>& until = {}) {
  Seen out;
  rt::TimeNs last_ns = 0;
  double even_ms = 0;
  const rt::TimeNs end = rt::monotonic_now_ns() + static_cast<rt::TimeNs>(most_s * 1e9);
  while (out.samples < samples && rt::monotonic_now_ns() < end && !(until && until())) {
    ImuSample s;
    const ImuStatus status = imu->next(&s, 20 * rt::kNsPerMs);
    if (status == ImuStatus::kFault) ++out.faults;
    if (status != ImuStatus::kSample) continue;
    if (last_ns != 0) {
      if (s.t_ns <= last_ns) ++out.not_later;
      const double step_ms = rt::to_ms(s.t_ns - last_ns);
      out.longest_step_ms = std::max(out.longest_step_ms, step_ms);
      if ((s.flags & kImuGap) != 0) {
        ++out.gaps;
      } else {
        even_ms += step_ms;
      }
    }
    last_ns = s.t_ns;
    out.flags |= s.flags;
    out.last = s;
    ++out.samples;
  }
  if (out.samples - out.gaps > 1) out.mean_step_ms = even_ms / (out.samples - out.gaps - 1);
  return out;
}

std::string text(const Seen& s) {
  char out[256];
  std::snprintf(
      out, sizeof out,
      "%d samples, %.3f ms a step (longest %.1f), %d faults, %d gaps, accel %.2f %.2f %.2f, gyro %.3f %.3f %.3f",
      s.samples, s.mean_step_ms, s.longest_step_ms, s.faults, s.gaps, s.last.accel_m_s2[0], s.last.accel_m_s2[1],
      s.last.accel_m_s2[2], s.last.gyro_rad_s[0], s.last.gyro_rad_s[1], s.last.gyro_rad_s[2]);
  return out;
}

/// All that the sensor said since the last look.
std::string events(Imu* imu) {
  std::string out;
  rt::LogEntry e;
  while (imu->events()->take(&e)) out.append(e.what).append(" ").append(e.which).append(" ").append(e.why).append("; ");
  return out;
}

/// Something is broken and mended: it is told in words, and samples come again.
void broken(Imu* imu, const std::string& what, const std::string& words, const std::function<void()>& begin,
            const std::function<void()>& mend) {
  events(imu);
  begin();
  std::string told;
  take(imu, 1'000'000, 10, [&] { return (told += events(imu)).find(words) != std::string::npos; });
  check(told.find(words) != std::string::npos, what + " is told: " + told);
  mend();
  const rt::TimeNs began = rt::monotonic_now_ns();
  // What was in the buffers from before is not what is meant: a few of them.
  const Seen s = take(imu, 50, 20);
  std::printf("      50 samples %.2f s after it was mended\n", rt::to_seconds(rt::monotonic_now_ns() - began));
  check(s.samples == 50 && s.not_later == 0, what + ": mended, it measures again: " + text(s));
}

/// The same reading in SI units: 1 g at 8 g, 2 g at the range of the kernel's driver.
void measures(Imu* imu, const char* name, double accel_unit, double gyro_unit) {
  set("value", "100,-200,4096,0,1000,-2000,3000");
  take(imu, 20, 10);
  const Seen s = take(imu, 400, 60);
  const auto near = [](double a, double b, double unit) { return std::abs(a - b) < 4.5 * unit; };  // noise: -3 to 4
  // Nothing is missing that is not flagged, and even a starved machine has most.
  check(
      s.samples == 400 && s.faults <= s.gaps && s.gaps <= 20 && s.not_later == 0 && std::abs(s.mean_step_ms - 5) < 0.25,
      std::string(name) + ", 200 Hz: " + text(s));
  check(near(s.last.accel_m_s2[0], 100 * accel_unit, accel_unit) &&
            near(s.last.accel_m_s2[1], -200 * accel_unit, accel_unit) &&
            near(s.last.accel_m_s2[2], 4096 * accel_unit, accel_unit) &&
            near(s.last.gyro_rad_s[0], 1000 * gyro_unit, gyro_unit) &&
            near(s.last.gyro_rad_s[1], -2000 * gyro_unit, gyro_unit) &&
            near(s.last.gyro_rad_s[2], 3000 * gyro_unit, gyro_unit),
        "its readings in SI units");
  const double age_ms = rt::to_ms(rt::monotonic_now_ns() - s.last.t_ns);
  check(age_ms > -1 && age_ms < 500,
        "its times are CLOCK_MONOTONIC's: the last is " + std::to_string(age_ms) + " ms old");
  set("value", "100,-200,32767,0,1000,-32768,3000");
  const Seen full = take(imu, 100, 20);
  check((full.flags & kImuGyroSaturated) != 0 && (full.flags & kImuAccelSaturated) != 0, "a full range is flagged");
  set("value", "100,-200,4096,0,1000,-2000,3000");
}

void lies(Imu* imu) {
  broken(
      imu, "a reading that is stuck", "stuck", [] { set("noise", "N"); }, [] { set("noise", "Y"); });
  broken(
      imu, "a sensor that sleeps", "all readings are zero",
      [] {
        set("value", "0,0,0,0,0,0,0");
        set("noise", "N");
      },
      [] {
        set("noise", "Y");
        set("value", "100,-200,4096,0,1000,-2000,3000");
      });
}

void spidev() {
  Mpu6000Settings settings;
  settings.self_test = true;
  auto opened = Mpu6000::open(spidev_port(), settings);
  if (!check(opened.ok(), "an MPU-6000 over spidev")) return;
  Mpu6000& imu = *opened.value();
  check(imu.trouble() == nullptr, std::string("runs: ") + (imu.trouble() == nullptr ? "yes" : imu.trouble()));
  check(imu.self_test_percent() >= 0 && imu.self_test_percent() < 2,
        "self-test: off the factory's by " + std::to_string(imu.self_test_percent()) + " %");
  measures(&imu, "spidev", 8 * kGravity / 32768, 500 * kDegree / 32768);
  lies(&imu);
  broken(
      &imu, "a bus with errors", "the bus fails", [] { set("error", "5"); }, [] { set("error", "0"); });
  broken(
      &imu, "a chip that takes no samples", "takes no samples", [] { set("stopped", "Y"); },
      [] { set("stopped", "N"); });
  broken(
      &imu, "another chip in its place", "an MPU-9250 (WHO_AM_I 0x71)",
      [] {
        set("who", "113");
        set("stopped", "Y");
      },
      [] {
        set("who", "104");
        set("stopped", "N");
      });
  broken(
      &imu, "a device that is unplugged", "the SPI device cannot be opened",
      [] { run("echo spi0.0 > /sys/bus/spi/drivers/spidev/unbind"); },
      [] { run("echo spi0.0 > /sys/bus/spi/drivers/spidev/bind"); });
}

void iio() {
  const auto imu = IioImu::open(libiio_port("mpu6000", 200, [](const std::string&) {}), nullptr, {});
  check(imu->trouble().empty(), "an MPU-6000 over IIO runs: " + imu->trouble());
  check(std::abs(imu->rate_hz() - 200) < 1, "its rate is set: " + std::to_string(imu->rate_hz()) + " Hz");
  // The kernel's driver rounds its scales to whole micro- and nanounits: 2 g over 32768 is 598 um/s2 to it, and 1 g
  // then four units less. Beside the chip's noise of -3 to 4 units that was beyond what measures() grants, one time in
  // eight.
  measures(imu.get(), "IIO", 598e-6, 1064724e-9);
  lies(imu.get());
  broken(
      imu.get(), "a driver without samples", "IMU", [] { set("mute", "Y"); }, [] { set("mute", "N"); });
  broken(
      imu.get(), "a device that is unplugged", "IMU",
      [] { run("echo spi0.0 > /sys/bus/spi/drivers/inv-mpu6000-spi/unbind"); },
      [] { run("echo spi0.0 > /sys/bus/spi/drivers/inv-mpu6000-spi/bind"); });
}

/// As an Intel D435i is one: two devices, and a clock of its own of 32 bits.
void hid() {
  constexpr rt::TimeNs kWrapNs = (rt::TimeNs{1} << 32) * 1000;
  // Plugged in long before this machine began: its clock must not happen to be CLOCK_MONOTONIC.
  constexpr rt::TimeNs kPluggedInNs = 3600 * rt::kNsPerSecond;
  auto device = std::make_unique<vm::EmulatedHidImu>(kPluggedInNs);
  if (!check(device->there(), "/dev/uhid")) return;
  run("for i in $(seq 100); do n=$(cat /sys/bus/iio/devices/*/name 2>/dev/null | grep -cE '^(gyro|accel)_3d$'); "
      "[ $n = 2 ] && exit; sleep 0.2; done; exit 1");
  const auto port = [](const char* name) { return libiio_port(name, 200, [](const std::string&) {}); };
  const auto imu = IioImu::open(port("gyro_3d"), port("accel_3d"), {});
  check(imu->trouble().empty(), "two devices of HID's drivers run: " + imu->trouble());
  check(std::abs(imu->rate_hz() - 200) < 1, "their rate is set: " + std::to_string(imu->rate_hz()) + " Hz");
  take(imu.get(), 20, 10);
  const std::string told = events(imu.get());
  check(told.find("IMU clock is not CLOCK_MONOTONIC") != std::string::npos &&
            told.find("IMU clock is followed") != std::string::npos,
        "the device's own clock is told, and followed: " + told);
  const auto measures = [&](int samples, const std::string& what) {
    const Seen s = take(imu.get(), samples, 60);
    bool near = true;
    for (std::size_t i = 0; i < 3; ++i) {
      near = near && std::abs(s.last.accel_m_s2[i] - device->accel[i] * kGravity / 1000) < 2 * kGravity / 1000 &&
             std::abs(s.last.gyro_rad_s[i] - device->gyro[i] * kDegree / 10) < 2 * kDegree / 10;
    }
    const double age_ms = rt::to_ms(rt::monotonic_now_ns() - s.last.t_ns);
    check(s.samples == samples && s.not_later == 0 && std::abs(s.mean_step_ms - 5) < 0.25, what + ": " + text(s));
    check(near, "in SI units");
    const std::string meanwhile = events(imu.get());
    check(meanwhile.find("stuck") == std::string::npos, "and nothing is stuck: " + meanwhile);
    check(age_ms > -1 && age_ms < 500, "on CLOCK_MONOTONIC: the last is " + std::to_string(age_ms) + " ms old");
  };
  measures(400, "HID, 200 Hz");
  broken(
      imu.get(), "a reading that is stuck", "stuck", [&] { device->noise = false; }, [&] { device->noise = true; });
  broken(
      imu.get(), "a driver without samples", "takes no samples", [&] { device->mute = true; },
      [&] { device->mute = false; });
  broken(
      imu.get(), "a device that is unplugged", "IMU", [&] { device.reset(); },
      [&] { device = std::make_unique<vm::EmulatedHidImu>(kPluggedInNs); });
  events(imu.get());
  device->set_clock(kWrapNs - rt::kNsPerSecond);
  int followed = 0;
  const Seen s = take(imu.get(), 1'000'000, 100, [&] {
    followed += events(imu.get()).find("IMU clock is followed") != std::string::npos ? 1 : 0;
    return followed == 2;
  });
  check(followed == 2 && s.not_later == 0, "its clock is set, and begins anew a second later: " + text(s));
  measures(50, "and from then on");
}

}  // namespace

int main(int argc, char** argv) {
  const std::string mode = argc == 2 ? argv[1] : "";
  if (mode == "spidev") {
    spidev();
  } else if (mode == "iio") {
    iio();
  } else if (mode == "hid") {
    hid();
  } else {
    return std::puts("godwit_imu_check spidev|iio|hid"), 2;
  }
  return failures == 0 ? 0 : 1;
}
