#include "hal/imu/mpu6000/mpu6000.h"

#include <cmath>
#include <cstring>
#include <gtest/gtest.h>
#include <vector>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"

namespace godwit::hal::mpu6000_test {
namespace {

/// What the chip does must not count as an allocation of the thread that reads it.
template <typename T>
std::vector<T> reserved(std::size_t n) {
  std::vector<T> out;
  out.reserve(n);
  return out;
}

/// A chip whose oscillator is `off` from its nominal step, in a time of its own that goes only when somebody sleeps or
/// transfers. What it measures is scripted.
struct Chip {
  rt::TimeNs now = 1000 * rt::kNsPerSecond;
  double off = 0;
  std::uint8_t who = 0x68;
  bool there = true;
  bool keeps_registers = true;
  bool runs = true;
  bool dead_bus = false;                                              ///< all bits set
  bool mute = false;                                                  ///< registers answer, samples are not taken
  std::array<std::int16_t, 7> value{100, -200, -2048, 340, 5, 6, 7};  ///< acceleration, temperature, gyro
  bool noisy = true;
  std::uint8_t reg[128] = {};
  std::vector<std::uint8_t> fifo = reserved<std::uint8_t>(1024);
  double next_sample = 0;
  std::vector<rt::TimeNs> taken = reserved<rt::TimeNs>(200);  ///< when, in order
  rt::TimeNs look_takes = 50'000;

  double step_ns() const { return 1e6 * (1 + reg[0x19]) * (1 + off); }
  void advance(rt::TimeNs to) {
    now = std::max(now, to);
    if ((reg[0x6B] & 0x40) != 0 || mute) {
      next_sample = static_cast<double>(now) + step_ns();
      return;
    }
    while (next_sample <= static_cast<double>(now)) {
      sample(static_cast<rt::TimeNs>(next_sample));
      next_sample += step_ns();
    }
  }
  void sample(rt::TimeNs t) {
    if (noisy) value[0] = static_cast<std::int16_t>(100 + (t / 1000) % 7);
    for (int i = 0; i < 7; ++i) {
      reg[0x3B + 2 * i] = static_cast<std::uint8_t>(value[static_cast<std::size_t>(i)] >> 8);
      reg[0x3C + 2 * i] = static_cast<std::uint8_t>(value[static_cast<std::size_t>(i)]);
    }
    if ((reg[0x6A] & 0x40) == 0 || reg[0x23] != 0xF8) return;
    if (fifo.size() + 14 > 1024) {
      reg[0x3A] |= 0x10;
      return;
    }
    fifo.insert(fifo.end(), reg + 0x3B, reg + 0x3B + 14);
    if (taken.size() == taken.capacity()) taken.erase(taken.begin());  // nobody follows them
    taken.push_back(t);
  }
};

class FakePort final : public SpiPort {
 public:
  explicit FakePort(Chip* chip) : c_(*chip) {}
  bool open(const char*, std::uint32_t) override { return c_.there; }
  void close() override {}
  rt::TimeNs now_ns() override { return c_.now; }
  void sleep_until(rt::TimeNs t_ns) override { c_.advance(t_ns); }
  bool transfer(const std::uint8_t* tx, std::uint8_t* rx, std::size_t bytes) override {
    if (!c_.there) return false;
    c_.advance(c_.now + c_.look_takes);
    std::uint8_t a = tx[0] & 0x7F;
    for (std::size_t i = 1; i < bytes; ++i) {
      if ((tx[0] & 0x80) != 0) {
        rx[i] = c_.dead_bus ? 0xFF : read(a);
      } else {
        write(a, tx[i]);
      }
      if (a != 0x74) ++a;
    }
    return true;
  }

 private:
  std::uint8_t read(std::uint8_t a) {
    if (a == 0x75) return c_.who;
    if (a == 0x72) return static_cast<std::uint8_t>(c_.fifo.size() >> 8);
    if (a == 0x73) return static_cast<std::uint8_t>(c_.fifo.size());
    if (a == 0x74) {
      if (c_.fifo.empty()) return 0xFF;
      const std::uint8_t v = c_.fifo.front();
      c_.fifo.erase(c_.fifo.begin());
      return v;
    }
    const std::uint8_t v = c_.reg[a];
    if (a == 0x3A) c_.reg[a] = 0;
    return v;
  }
  void write(std::uint8_t a, std::uint8_t v) {
    if (a == 0x6B && (v & 0x80) != 0) {
      std::memset(c_.reg, 0, sizeof c_.reg);
      c_.reg[0x6B] = 0x40;
      c_.fifo.clear();
      return;
    }
    if (a == 0x6A && (v & 0x04) != 0) {
      c_.fifo.clear();
      c_.taken.clear();
      v = static_cast<std::uint8_t>(v & ~0x04);
    }
    if (a == 0x1B || a == 0x1C || a == 0x19 || a == 0x1A) {
      if (!c_.keeps_registers) return;
    }
    c_.reg[a] = v;
  }
  Chip& c_;
};

class Mpu6000Test : public ::testing::Test {
 protected:
  void open() {
    auto imu = Mpu6000::open(std::make_unique<FakePort>(&chip_), settings_);
    ASSERT_TRUE(imu.ok()) << imu.error().message;
    imu_ = std::move(imu).value();
  }
  ImuStatus next() { return imu_->next(&s_, 100 * rt::kNsPerMs); }
  std::string trouble() { return imu_->trouble() == nullptr ? "" : imu_->trouble(); }

  Chip chip_;
  Mpu6000Settings settings_;
  std::unique_ptr<Mpu6000> imu_;
  ImuSample s_;
};

TEST_F(Mpu6000Test, GivesSiUnitsInTheBodysAxes) {
  settings_.axes = *parse_axis_map("y x -z");
  open();
  ASSERT_EQ(trouble(), "");
  ASSERT_EQ(next(), ImuStatus::kSample);
  EXPECT_NEAR(s_.accel_m_s2[0], -200 * 8 * 9.80665 / 32768, 1e-12);
  EXPECT_NEAR(s_.accel_m_s2[2], 2048 * 8 * 9.80665 / 32768, 1e-12);
  EXPECT_NEAR(s_.gyro_rad_s[0], 6 * 500 * M_PI / 180 / 32768, 1e-12);
  EXPECT_NEAR(s_.gyro_rad_s[2], -7 * 500 * M_PI / 180 / 32768, 1e-12);
  EXPECT_NEAR(imu_->temperature_c(), 37.53, 1e-4);
  EXPECT_EQ(s_.flags, 0);
}

TEST_F(Mpu6000Test, TimesAreTheChipsEvenStepsLessTheFiltersDelay) {
  for (const double off : {-0.01, 0.0, 0.01}) {
    chip_ = {};
    chip_.off = off;
    open();
    double worst_ms = 0;
    rt::TimeNs last = 0;
    const rt::HeapCounts before = rt::rt_heap_counts();
    for (int i = 0; i < 4000; ++i) {
      // Now and then nobody looks for a while.
      if (i % 100 == 99) chip_.advance(chip_.now + 23 * rt::kNsPerMs);
      const rt::RtScope real_time;
      ASSERT_EQ(next(), ImuStatus::kSample);
      ASSERT_GT(s_.t_ns, last);
      last = s_.t_ns;
      const rt::TimeNs truth = chip_.taken.front() - 2'900'000;
      chip_.taken.erase(chip_.taken.begin());
      if (i > 1000) worst_ms = std::max(worst_ms, std::abs(static_cast<double>(s_.t_ns - truth)) * 1e-6);
    }
    EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
    EXPECT_LT(worst_ms, 1.3) << off;  // two looks lie an eighth of a step (0.6 ms) apart
    EXPECT_EQ(imu_->counters().overflows, 0u);
  }
}

TEST_F(Mpu6000Test, ABufferThatRanOverIsAGapAndItGoesOn) {
  open();
  ASSERT_EQ(next(), ImuStatus::kSample);
  chip_.advance(chip_.now + rt::kNsPerSecond);
  while (next() == ImuStatus::kSample) {
  }
  EXPECT_EQ(imu_->counters().overflows, 1u);
  ASSERT_EQ(next(), ImuStatus::kSample);
  EXPECT_EQ(s_.flags, kImuGap);
  ASSERT_EQ(next(), ImuStatus::kSample);
  EXPECT_EQ(s_.flags, 0);
}

TEST_F(Mpu6000Test, SaturationIsFlagged) {
  open();
  chip_.value[4] = 32767;
  chip_.value[2] = -32768;
  ASSERT_EQ(next(), ImuStatus::kSample);
  for (int i = 0; i < 3; ++i) ASSERT_EQ(next(), ImuStatus::kSample);
  EXPECT_EQ(s_.flags, kImuGyroSaturated | kImuAccelSaturated);
  EXPECT_EQ(saturated_flags(s_, imu_->ranges().gyro_rad_s, imu_->ranges().accel_m_s2), s_.flags)
      << "as a replay finds it";
}

TEST_F(Mpu6000Test, ChipsThatLieAreToldInWordsAndTakenBackWhenTheyStop) {
  const auto fails = [&](const std::string& words, const std::function<void()>& mend) {
    for (int i = 0; i < 200 && next() != ImuStatus::kFault; ++i) {
    }
    EXPECT_NE(trouble().find(words), std::string::npos) << words << ": " << trouble();
    mend();
    // It comes back within a second of its own time.
    const rt::TimeNs began = chip_.now;
    while (next() != ImuStatus::kSample) ASSERT_LT(chip_.now, began + rt::kNsPerSecond);
    EXPECT_EQ(trouble(), "");
    EXPECT_EQ(s_.flags & kImuGap, kImuGap);
  };
  open();
  chip_.noisy = false;
  fails("stuck", [&] { chip_.noisy = true; });
  chip_.noisy = false;
  const auto value = chip_.value;
  chip_.value = {};
  fails("all readings are zero", [&] {
    chip_.value = value;
    chip_.noisy = true;
  });
  chip_.dead_bus = true;
  fails("nonsense", [&] { chip_.dead_bus = false; });
  chip_.there = false;
  fails("the bus fails", [&] { chip_.there = true; });
  chip_.mute = true;
  fails("takes no samples", [&] { chip_.mute = false; });
  EXPECT_EQ(imu_->counters().restarts, 5u);
}

// As the thread that reads it runs: it has a heartbeat, and other things to look at.
TEST_F(Mpu6000Test, SettingUpAnewTakesNoCallLongerThanItMayWait) {
  for (const bool self_test : {false, true}) {
    settings_.self_test = self_test;
    chip_ = {};
    chip_.there = !self_test;  // the test is made at the first start, which is here in next()
    open();
    chip_.there = false;
    next();
    chip_.there = true;
    const std::uint64_t restarts = imu_->counters().restarts;
    while (imu_->counters().restarts == restarts) {
      const rt::TimeNs began = chip_.now;
      imu_->next(&s_, 10 * rt::kNsPerMs);
      ASSERT_LE(chip_.now - began, 13 * rt::kNsPerMs);  // and a few transfers
      ASSERT_LT(chip_.now, 1005 * rt::kNsPerSecond);
    }
    EXPECT_EQ(trouble(), "");
    rt::LogEntry e;
    bool judged = false;
    while (imu_->events()->take(&e)) judged = judged || std::string(e.what).find("self-test") != std::string::npos;
    EXPECT_EQ(judged, self_test);
  }
}

TEST(SampleClock, SamplesThatSeemToComeTogetherAreSetApart) {
  constexpr rt::TimeNs kStep = 5 * rt::kNsPerMs;
  SampleClock clock;
  clock.start(kStep);
  // The first look came late: its sample was nearly a step old, and the next one is there at once.
  rt::TimeNs last = clock.take(1, 0, 1000 * rt::kNsPerMs);
  for (int i = 1; i < 400; ++i) {
    const rt::TimeNs t = 995'100'000 + i * kStep;
    const rt::TimeNs found = clock.take(1, t - kStep, t + 100'000);
    ASSERT_GE(found - last, kStep * 2 / 5) << i;
    last = found;
  }
  // A buffer with several: the last of them counts, too.
  const rt::TimeNs oldest = clock.take(4, last, last + kStep / 10);
  EXPECT_GE(oldest - last, kStep * 2 / 5);
  const rt::TimeNs newest = oldest + 3 * clock.step_ns();
  EXPECT_GE(clock.take(1, newest, newest + 1) - newest, kStep * 2 / 5);
}

TEST_F(Mpu6000Test, AnotherChipIsNamed) {
  const auto at_start = [&](const std::string& words) {
    open();
    EXPECT_NE(trouble().find(words), std::string::npos) << trouble();
    EXPECT_EQ(next(), ImuStatus::kTimeout);
  };
  chip_.who = 0x47;
  at_start("ICM-42688-P");
  chip_.who = 0x55;
  at_start("WHO_AM_I is not 0x68");
  chip_.who = 0xFF;
  at_start("nothing answers");
  chip_.who = 0x68;
  chip_.keeps_registers = false;
  at_start("does not keep");
  chip_.there = false;
  at_start("cannot be opened");
}

TEST_F(Mpu6000Test, SettingsThatTheChipCannotDoAreRefused) {
  settings_.rate_hz = 300;
  EXPECT_FALSE(Mpu6000::open(std::make_unique<FakePort>(&chip_), settings_).ok());
  settings_.rate_hz = 200;
  settings_.gyro_range_deg_s = 300;
  EXPECT_FALSE(Mpu6000::open(std::make_unique<FakePort>(&chip_), settings_).ok());
}

TEST(AxisMap, OnlyTurnsAreMountings) {
  int allowed = 0;
  for (const char* a : {"x", "-x", "y", "-y", "z", "-z"}) {
    for (const char* b : {"x", "-x", "y", "-y", "z", "-z"}) {
      for (const char* c : {"x", "-x", "y", "-y", "z", "-z"}) {
        const std::string text = std::string(a) + " " + b + " " + c;
        const auto map = parse_axis_map(text);
        if (!map) continue;
        ++allowed;
        // Forward x right is down.
        const auto f = map->apply({1, 0, 0}), r = map->apply({0, 1, 0}), d = map->apply({0, 0, 1});
        EXPECT_EQ(f[0] * (r[1] * d[2] - r[2] * d[1]) - r[0] * (f[1] * d[2] - f[2] * d[1]) +
                      d[0] * (f[1] * r[2] - f[2] * r[1]),
                  1)
            << text;
      }
    }
  }
  EXPECT_EQ(allowed, 24);
  for (const char* text : {"", "x y", "x y z x", "x x z", "x - y z", "--x y z", "a b c", "x y -"}) {
    EXPECT_FALSE(parse_axis_map(text)) << text;
  }
  EXPECT_EQ(parse_axis_map("y -x z")->apply({1, 2, 3})[1], -1);
}

}  // namespace
}  // namespace godwit::hal::mpu6000_test
