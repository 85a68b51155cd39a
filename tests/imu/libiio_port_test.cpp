// Sensors of Industrial I/O that no machine here has, by the names, scales and layouts that their drivers in Linux 6.1
// give them: libiio reads a /sys and a /dev that the test plays (in a name space of its own), readings come through a
// FIFO. The drivers themselves are not run; of those that can be, tests/vm/cases/iio and hid_imu.
#include <array>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <fcntl.h>
#include <filesystem>
#include <functional>
#include <gtest/gtest.h>
#include <sched.h>
#include <string>
#include <sys/mount.h>
#include <sys/stat.h>
#include <thread>
#include <unistd.h>

#include "hal/imu/iio/iio_imu.h"
#include "tests/support/temp_folder.h"

namespace godwit::hal::libiio_port_test {
namespace {
namespace fs = std::filesystem;

/// In a thread whose /sys and /dev are its own.
void on_a_machine_of_its_own(const std::function<void()>& test) {
  bool alone = true;
  std::thread([&] {
    alone = unshare(CLONE_NEWNS) == 0 && mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) == 0 &&
            mount("none", "/sys", "tmpfs", 0, nullptr) == 0 && mount("none", "/dev", "tmpfs", 0, nullptr) == 0;
    if (alone) test();
  }).join();
  if (alone) return;
  const char* const ci = std::getenv("CI");
  if (ci != nullptr && std::string(ci) == "true") FAIL() << "needs the right to a /sys of its own";
  GTEST_SKIP() << "needs the right to a /sys of its own";
}

/// One device as its driver shows it.
struct FakeDevice {
  int number;
  std::string name, kind, scale, rate, format;  ///< kind: "accel" or "anglvel"; format: of a reading, "be:s16/16>>0"
  bool buffer = true;

  std::string folder() const { return "/sys/bus/iio/devices/iio:device" + std::to_string(number); }
  std::string node() const { return "/dev/iio:device" + std::to_string(number); }
  void plug(const std::string& rate_file) const {
    const auto file = [&](const std::string& name_in_it, const std::string& text) {
      test::write_file(folder() + "/" + name_in_it, text);
    };
    file("name", name + "\n");
    file("in_" + kind + "_scale", scale + "\n");
    file(rate_file, rate);
    file("current_timestamp_clock", "realtime");
    int index = 0;
    for (const char* const axis : {"x", "y", "z"}) {
      file("in_" + kind + "_" + axis + "_raw", "0\n");
      if (!buffer) continue;
      const std::string element = "scan_elements/in_" + kind + "_" + axis;
      file(element + "_en", "0");
      file(element + "_index", std::to_string(index++) + "\n");
      file(element + "_type", format + "\n");
    }
    if (!buffer) return;
    file("scan_elements/in_timestamp_en", "0");
    file("scan_elements/in_timestamp_index", "4\n");
    file("scan_elements/in_timestamp_type", "le:s64/64>>0\n");
    file("buffer/length", "0");
    file("buffer/enable", "0");
    ASSERT_EQ(mkfifo(node().c_str(), 0600), 0);
  }
  /// libiio writes the end of its texts as well.
  std::string reads(const std::string& file) const { return test::read_file(folder() + "/" + file).c_str(); }

  /// A scan: three readings of 16 bits, two bytes of nothing, the time.
  void measure(std::array<std::int16_t, 3> raw, rt::TimeNs t_ns) const {
    std::array<std::uint8_t, 16> scan{};
    for (std::size_t i = 0; i < 3; ++i) {
      auto value = static_cast<std::uint16_t>(raw[i]);
      if (format[0] == 'b') value = __builtin_bswap16(value);
      std::memcpy(scan.data() + 2 * i, &value, 2);
    }
    std::memcpy(scan.data() + 8, &t_ns, 8);
    const int fd = open(node().c_str(), O_WRONLY | O_NONBLOCK);
    EXPECT_EQ(write(fd, scan.data(), scan.size()), 16);
    close(fd);
  }
};

std::unique_ptr<IioPort> port(const FakeDevice& device) {
  return libiio_port(device.name, 200, nullptr);
}

TEST(LibiioPort, AnIcm42688PIsTwoDevicesOf16BitsWithTheHighByteFirst) {
  on_a_machine_of_its_own([] {
    const FakeDevice gyro{0, "icm42688-gyro", "anglvel", "0.001065264", "50", "be:s16/16>>0"};
    const FakeDevice accel{1, "icm42688-accel", "accel", "0.004788403", "50", "be:s16/16>>0"};
    gyro.plug("sampling_frequency");
    accel.plug("sampling_frequency");
    const auto imu = IioImu::open(port(gyro), port(accel), {});
    ASSERT_EQ(imu->trouble(), "");
    EXPECT_EQ(imu->rate_hz(), 200);
    for (const FakeDevice& d : {gyro, accel}) {
      EXPECT_EQ(d.reads("sampling_frequency"), "200");
      EXPECT_EQ(d.reads("current_timestamp_clock"), "monotonic");
      EXPECT_EQ(d.reads("scan_elements/in_" + d.kind + "_z_en"), "1");
      EXPECT_EQ(d.reads("scan_elements/in_timestamp_en"), "1");
      EXPECT_EQ(d.reads("buffer/enable"), "1");
    }
    const rt::TimeNs t_ns = rt::monotonic_now_ns();
    for (int i = 0; i < 4; ++i) {
      accel.measure({static_cast<std::int16_t>(i), -300, 2048}, t_ns);
      gyro.measure({100, -200, static_cast<std::int16_t>(i)}, t_ns);
    }
    ImuSample s;
    ImuStatus status = ImuStatus::kTimeout;
    for (int i = 0; i < 1000 && status != ImuStatus::kSample; ++i) status = imu->next(&s, 10 * rt::kNsPerMs);
    ASSERT_EQ(status, ImuStatus::kSample);
    EXPECT_EQ(s.t_ns, t_ns);
    EXPECT_NEAR(s.accel_m_s2[1], -300 * 0.004788403, 1e-9);
    EXPECT_NEAR(s.accel_m_s2[2], 2048 * 0.004788403, 1e-9);
    EXPECT_NEAR(s.gyro_rad_s[0], 100 * 0.001065264, 1e-9);
    EXPECT_NEAR(s.gyro_rad_s[1], -200 * 0.001065264, 1e-9);
  });
}

// Its gyroscope (bmg160) has a trigger for new data, which nobody uses until told; its accelerometer's driver has no
// buffer.
TEST(LibiioPort, ABmi088sGyroscopeGetsItsTriggerAndItsAccelerometerIsRefusedInWords) {
  on_a_machine_of_its_own([] {
    const FakeDevice accel{0, "bmi088-accel", "accel", "0.001794", "100", "le:s16/16>>0", false};
    const FakeDevice gyro{1, "bmi088_gyro", "anglvel", "0.001065", "100", "le:s16/16>>0"};
    accel.plug("in_accel_sampling_frequency");
    gyro.plug("in_anglvel_sampling_frequency");
    // A real /sys takes no new files: libiio would make one of that name.
    fs::create_directory(gyro.folder() + "/sampling_frequency");
    test::write_file(gyro.folder() + "/trigger/current_trigger", "");
    test::write_file("/sys/bus/iio/devices/trigger0/name", "bmi088_gyro-any-motion-dev1\n");
    test::write_file("/sys/bus/iio/devices/trigger1/name", "bmi088_gyro-dev1\n");
    const auto open = [](IioPort* p) {
      p->begin_open();
      for (int i = 0; i < 10'000 && p->state() == IioPort::State::kBusy; ++i) usleep(1000);
      return p->state();
    };
    const auto rates = port(gyro);
    ASSERT_EQ(open(rates.get()), IioPort::State::kOpen) << rates->error();
    EXPECT_EQ(gyro.reads("trigger/current_trigger"), "bmi088_gyro-dev1");
    EXPECT_EQ(gyro.reads("in_anglvel_sampling_frequency"), "200");
    EXPECT_TRUE(rates->description().has_gyro && !rates->description().has_accel);
    EXPECT_DOUBLE_EQ(rates->description().gyro_scale, 0.001065);
    gyro.measure({-1, 2, 3}, 77);
    std::array<IioScan, 4> scans;
    int count = 0;
    for (int i = 0; i < 1000 && count == 0; ++i) rates->read(scans.data(), 4, 10 * rt::kNsPerMs, &count);
    ASSERT_EQ(count, 1);
    EXPECT_EQ(scans[0].t_ns, 77);
    EXPECT_EQ(scans[0].raw, (std::array<std::int32_t, 6>{0, 0, 0, -1, 2, 3}));
    const auto acceleration = port(accel);
    EXPECT_EQ(open(acceleration.get()), IioPort::State::kFailed);
    EXPECT_EQ(acceleration->error(), "iio: bmi088-accel gives no times: its driver has no buffer");
  });
}

}  // namespace
}  // namespace godwit::hal::libiio_port_test
