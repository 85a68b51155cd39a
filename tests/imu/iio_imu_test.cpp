#include "hal/imu/iio/iio_imu.h"

#include <deque>
#include <functional>
#include <gtest/gtest.h>
#include <limits>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/support/abandoned.h"

namespace godwit::hal::iio_imu_test {
namespace {

/// A driver: what it is, and the readings that wait in its buffer. Time goes when somebody waits.
struct Driver {
  rt::TimeNs* now;
  IioDescription is{true, true, 0.001, 0.0001, 16, 16, 200};
  bool there = true, gone = false;
  rt::TimeNs offset_ns = 0;      ///< to add to its times
  rt::TimeNs opening_takes = 0;  ///< of its own thread
  std::deque<IioScan> scans{};
};

class FakePort final : public IioPort {
 public:
  explicit FakePort(Driver* d) : d_(*d) {}
  void begin_open() override {
    ordered_ = d_.there ? State::kOpen : State::kFailed;
    error_ = d_.there ? "" : "iio: no device imu";
    ready_ns_ = *d_.now + d_.opening_takes;
  }
  void begin_close() override {
    d_.scans.clear();
    ordered_ = State::kClosed;
  }
  State state() override { return *d_.now < ready_ns_ ? State::kBusy : ordered_; }
  const IioDescription& description() override { return d_.is; }
  std::string error() override { return error_; }
  rt::TimeNs clock_offset_ns() override { return d_.offset_ns; }
  Read read(IioScan* scans, int capacity, rt::TimeNs timeout_ns, int* count) override {
    *count = 0;
    if (d_.gone) return Read::kGone;
    if (d_.scans.empty()) *d_.now += timeout_ns;
    for (; *count < capacity && !d_.scans.empty(); d_.scans.pop_front()) scans[(*count)++] = d_.scans.front();
    return *count > 0 ? Read::kScans : Read::kNothing;
  }
  rt::TimeNs now_ns() override { return *d_.now; }
  void sleep_until(rt::TimeNs t_ns) override { *d_.now = std::max(*d_.now, t_ns); }

 private:
  Driver& d_;
  State ordered_ = State::kClosed;
  std::string error_;
  rt::TimeNs ready_ns_ = 0;
};

class IioImuTest : public ::testing::Test {
 protected:
  void open(bool two = false) {
    imu_ = IioImu::open(std::make_unique<FakePort>(&gyro_), two ? std::make_unique<FakePort>(&accel_) : nullptr,
                        settings_);
  }
  /// The next reading, 5 ms later.
  void measure(std::int32_t value, rt::TimeNs late_ns = 0) {
    now_ += 5 * rt::kNsPerMs;
    gyro_.scans.push_back({now_ - late_ns, {value, 2, 3, 4, 5, value}});
  }
  ImuStatus next() { return imu_->next(&s_, 10 * rt::kNsPerMs); }

  rt::TimeNs now_ = 1000 * rt::kNsPerSecond;
  Driver gyro_{&now_}, accel_{&now_};
  IioSettings settings_;
  std::unique_ptr<IioImu> imu_;
  ImuSample s_;
};

TEST_F(IioImuTest, GivesSiUnitsGapsAndSaturation) {
  settings_.axes = *parse_axis_map("x -y -z");
  open();
  measure(1000);
  ASSERT_EQ(next(), ImuStatus::kSample);
  EXPECT_EQ(s_.t_ns, now_);
  EXPECT_DOUBLE_EQ(s_.accel_m_s2[0], 1.0);
  EXPECT_DOUBLE_EQ(s_.accel_m_s2[1], -0.002);
  EXPECT_DOUBLE_EQ(s_.gyro_rad_s[2], -0.1);
  EXPECT_EQ(s_.flags, 0);
  now_ += 5 * rt::kNsPerMs;  // one is missing
  measure(32767);
  ASSERT_EQ(next(), ImuStatus::kSample);
  EXPECT_EQ(s_.flags, kImuGap | kImuAccelSaturated | kImuGyroSaturated);
  EXPECT_EQ(saturated_flags(s_, imu_->ranges().gyro_rad_s, imu_->ranges().accel_m_s2),
            kImuAccelSaturated | kImuGyroSaturated)
      << "as a replay finds it";
  EXPECT_EQ(imu_->counters().gaps, 1u);
}

TEST_F(IioImuTest, ADeviceWithARateOfItsOwnHasNoGapsAtThatRate) {
  gyro_.is.rate_hz = 100;
  open();
  EXPECT_EQ(imu_->rate_hz(), 100);
  for (int i = 0; i < 5; ++i) {
    now_ += 5 * rt::kNsPerMs;
    measure(i);
    ASSERT_EQ(next(), ImuStatus::kSample);
    EXPECT_EQ(s_.flags, 0);
  }
  now_ += 15 * rt::kNsPerMs;  // one is missing
  measure(7);
  ASSERT_EQ(next(), ImuStatus::kSample);
  EXPECT_EQ(s_.flags, kImuGap);
}

TEST_F(IioImuTest, ReadingsOf32BitsHaveTheirEnds) {
  gyro_.is.accel_bits = gyro_.is.gyro_bits = 32;
  open();
  for (const std::int32_t value :
       {100'000, std::numeric_limits<std::int32_t>::max(), 40'000, std::numeric_limits<std::int32_t>::min()}) {
    measure(value);
    ASSERT_EQ(next(), ImuStatus::kSample);
    EXPECT_EQ(s_.flags, std::abs(value / 2) > 1'000'000'000 ? kImuAccelSaturated | kImuGyroSaturated : 0) << value;
  }
}

TEST(LibiioPort, RatesAreWrittenAsDriversReadThem) {
  EXPECT_EQ(iio_rate_text(200), "200");
  EXPECT_EQ(iio_rate_text(1000), "1000");
  EXPECT_EQ(iio_rate_text(12.5), "12.5");
  EXPECT_EQ(iio_rate_text(104.166667), "104.166667");
}

TEST_F(IioImuTest, SamplesOutOfOrderAreLeftOutAndTimesOfAnotherClockTold) {
  open();
  measure(1);
  ASSERT_EQ(next(), ImuStatus::kSample);
  measure(2, 7 * rt::kNsPerMs);
  measure(3);
  ASSERT_EQ(next(), ImuStatus::kSample);
  EXPECT_DOUBLE_EQ(s_.accel_m_s2[0], 0.003);
  EXPECT_EQ(imu_->counters().out_of_order, 1u);
  measure(4, -1'700'000'000LL * rt::kNsPerSecond);  // CLOCK_REALTIME
  EXPECT_EQ(next(), ImuStatus::kFault);
  rt::LogEntry e;
  ASSERT_TRUE(imu_->events()->take(&e));
  EXPECT_STREQ(e.what, "IMU clock is not CLOCK_MONOTONIC");
}

// An Intel D435i's driver passes on its microseconds since it was plugged in, which begin anew after 32 bits.
TEST_F(IioImuTest, ADevicesOwnClockIsToldAndFollowed) {
  constexpr rt::TimeNs kWrapNs = (rt::TimeNs{1} << 32) * 1000;
  rt::TimeNs plugged_in_ns = now_ - (kWrapNs - 10 * rt::kNsPerSecond);
  open();
  rt::TimeNs late_ns = 0, worst_ns = 0;
  int used = 0;
  // 20 s at 200 Hz, its quartz 100 ppm slow, arrivals up to 2 ms late.
  for (int i = 0; i < 4000; ++i) {
    late_ns = i * 7919 % 2000 * 1000;
    measure(i, plugged_in_ns + late_ns + i * 500);
    if (now_ - late_ns - plugged_in_ns >= kWrapNs) plugged_in_ns += kWrapNs;
    if (next() != ImuStatus::kSample) continue;
    ++used;
    if (i > 40) worst_ns = std::max(worst_ns, std::abs(s_.t_ns - (now_ - late_ns)));
  }
  // Twice it took twenty readings to believe it.
  EXPECT_GE(used, 4000 - 2 * (OwnClock::kEnough + 1));
  EXPECT_EQ(imu_->counters().wrong_time, 2u * OwnClock::kEnough);
  EXPECT_EQ(imu_->counters().out_of_order, 0u);
  EXPECT_LT(worst_ns, rt::kNsPerMs / 2);
  rt::LogEntry e;
  for (const char* const said :
       {"IMU clock is not CLOCK_MONOTONIC", "IMU clock is followed", "IMU clock is followed"}) {
    ASSERT_TRUE(imu_->events()->take(&e));
    EXPECT_STREQ(e.what, said);
  }
  EXPECT_FALSE(imu_->events()->take(&e));
  // Another driver: its times need no offset.
  measure(4000);
  ASSERT_EQ(next(), ImuStatus::kSample);
  EXPECT_EQ(s_.t_ns, now_);
}

// Strange ones that are no clock: each another way off, or one that stands.
TEST_F(IioImuTest, TimesThatFollowNoClockAreLeftOut) {
  open();
  const rt::TimeNs began_ns = now_;
  for (int i = 0; i < 200; ++i) {
    measure(i, i < 100 ? (i % 3 + 2) * rt::kNsPerSecond : now_ + 5 * rt::kNsPerMs - began_ns + 10 * rt::kNsPerSecond);
    EXPECT_EQ(next(), ImuStatus::kFault);
  }
  rt::LogEntry e;
  ASSERT_TRUE(imu_->events()->take(&e));
  EXPECT_STREQ(e.what, "IMU clock is not CLOCK_MONOTONIC");
  EXPECT_FALSE(imu_->events()->take(&e));
  measure(200);
  EXPECT_EQ(next(), ImuStatus::kSample);
  EXPECT_EQ(s_.t_ns, now_);
}

TEST_F(IioImuTest, AClockThatCannotBeSetIsConverted) {
  gyro_.offset_ns = -1'700'000'000LL * rt::kNsPerSecond;
  open();
  measure(4, gyro_.offset_ns);
  ASSERT_EQ(next(), ImuStatus::kSample);
  EXPECT_EQ(s_.t_ns, now_);
  // Somebody sets that clock: what was stamped around it is left out, then its new offset holds.
  gyro_.offset_ns += 400 * rt::kNsPerMs;
  measure(5, gyro_.offset_ns - 400 * rt::kNsPerMs);
  EXPECT_EQ(next(), ImuStatus::kFault);
  rt::LogEntry e;
  ASSERT_TRUE(imu_->events()->take(&e));
  EXPECT_STREQ(e.what, "IMU clock was set");
  measure(6, gyro_.offset_ns);
  ASSERT_EQ(next(), ImuStatus::kSample);
  EXPECT_EQ(s_.t_ns, now_);
}

TEST_F(IioImuTest, DevicesThatLieOrGoAreToldAndTakenBack) {
  open();
  const auto fails = [&](const std::string& words) {
    EXPECT_EQ(imu_->trouble(), words);
    rt::LogEntry e;
    ASSERT_TRUE(imu_->events()->take(&e));
    EXPECT_STREQ(e.what, "IMU fails");
    const rt::TimeNs began = now_;
    while (!imu_->trouble().empty()) {
      next();
      ASSERT_LT(now_, began + rt::kNsPerSecond);
    }
    measure(77);
    ASSERT_EQ(next(), ImuStatus::kSample);
    EXPECT_EQ(s_.flags & kImuGap, kImuGap);
    ASSERT_TRUE(imu_->events()->take(&e));
    EXPECT_STREQ(e.what, "IMU is back");
  };
  for (int i = 0; i < 19; ++i) {
    measure(5);
    ASSERT_EQ(next(), ImuStatus::kSample);
  }
  measure(5);
  ASSERT_EQ(next(), ImuStatus::kFault);
  fails("the readings are stuck");
  for (int i = 0; i < 3; ++i) {
    now_ += 5 * rt::kNsPerMs;
    gyro_.scans.push_back({now_, {}});
  }
  while (next() == ImuStatus::kSample) {
  }
  fails("all readings are zero: the sensor sleeps, or nothing is wired");
  gyro_.gone = true;
  EXPECT_EQ(next(), ImuStatus::kFault);
  gyro_.gone = false;
  fails("the device is gone");
  while (next() == ImuStatus::kTimeout) {
  }
  fails("it is there, but takes no samples");
}

TEST_F(IioImuTest, ADeviceThatIsNotThereOrMeasuresSomethingElseIsToldInWords) {
  gyro_.there = false;
  open();
  EXPECT_EQ(imu_->trouble(), "iio: no device imu");
  gyro_.there = true;
  for (int i = 0; i < 100 && !imu_->trouble().empty(); ++i) next();
  EXPECT_EQ(imu_->trouble(), "");
  gyro_.is.has_accel = false;
  open();
  EXPECT_NE(imu_->trouble().find("imu.accel_device names"), std::string::npos);
  gyro_.is.has_gyro = false;
  open();
  EXPECT_EQ(imu_->trouble(), "imu.device measures no rates");
}

// As the thread that reads it runs in flight: opening anew is somebody else's work.
TEST_F(IioImuTest, ADeviceThatGoesAndComesBackCostsNextNoHeapAndNoMoreTimeThanItMayTake) {
  open();
  gyro_.opening_takes = 300 * rt::kNsPerMs;
  const rt::HeapCounts before = rt::rt_heap_counts();
  gyro_.gone = true;
  {
    const rt::RtScope real_time;
    EXPECT_EQ(next(), ImuStatus::kFault);
    gyro_.gone = false;
    for (int i = 0; i < 100 && imu_->counters().restarts == 0; ++i) {
      const rt::TimeNs began = now_;
      EXPECT_NE(next(), ImuStatus::kSample);
      EXPECT_LE(now_ - began, 10 * rt::kNsPerMs);
    }
  }
  EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
  EXPECT_EQ(imu_->counters().restarts, 1u);
}

TEST_F(IioImuTest, AccelerationOfASecondDeviceIsInterpolatedToTheRates) {
  gyro_.is.has_accel = false;
  accel_.is.has_gyro = false;
  open(true);
  const rt::TimeNs t0 = now_;
  now_ += 100 * rt::kNsPerMs;
  for (int i = 0; i < 8; ++i) {
    accel_.scans.push_back({t0 + i * 10 * rt::kNsPerMs, {100 * i, 0, 0, 0, 0, 0}});
    gyro_.scans.push_back({t0 + 2 * rt::kNsPerMs + i * 5 * rt::kNsPerMs, {0, 0, 0, i, 0, 0}});
  }
  for (int i = 0; i < 8; ++i) {
    ASSERT_EQ(next(), ImuStatus::kSample);
    EXPECT_EQ(s_.t_ns, t0 + 2 * rt::kNsPerMs + i * 5 * rt::kNsPerMs);
    EXPECT_NEAR(s_.accel_m_s2[0], 0.001 * (20 + 50 * i), 1e-12);
  }
  // A rate whose later acceleration has not come waits for it.
  gyro_.scans.push_back({t0 + 95 * rt::kNsPerMs, {0, 0, 0, 9, 0, 0}});
  EXPECT_EQ(next(), ImuStatus::kTimeout);
  accel_.scans.push_back({t0 + 110 * rt::kNsPerMs, {1100, 0, 0, 0, 0, 0}});
  now_ += 20 * rt::kNsPerMs;
  ASSERT_EQ(next(), ImuStatus::kSample);
  EXPECT_EQ(s_.t_ns, t0 + 95 * rt::kNsPerMs);
}

// A device that takes its time to be opened, or to say that it is none.
TEST(LibiioPort, AThreadThatHangsIsNamedAndKeepsNoEndAway) {
  auto port = libiio_port("no such device", 0, nullptr);
  EXPECT_EQ(test::abandoned_while_stands("gw-iio", [&] { port.reset(); }), "gw-iio");
}

}  // namespace
}  // namespace godwit::hal::iio_imu_test
