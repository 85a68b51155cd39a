// InvenSense MPU-6000 over spidev, the sensor that the paper flew. Registers: RM-MPU-6000A, rev. 4.2.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <string>

#include "hal/imu/axis_map.h"
#include "hal/imu/imu.h"
#include "hal/imu/mpu6000/spi_port.h"
#include "hal/imu/reading_check.h"
#include "hal/imu/sample_clock.h"
#include "hal/rt/log_ring.h"
#include "hal/rt/result.h"

namespace godwit::hal {

struct Mpu6000Settings {
  std::string device = "/dev/spidev0.0";
  int rate_hz = 200;           ///< 1000 over a whole number from 1 to 100
  int gyro_range_deg_s = 500;  ///< 250, 500, 1000 or 2000
  int accel_range_g = 8;       ///< 2, 4, 8 or 16
  AxisMap axes;
  bool self_test = false;  ///< once at the first start; the sensor must lie still, it takes a quarter of a second
};

struct Mpu6000Counters {
  std::uint64_t samples = 0;
  std::uint64_t overflows = 0;  ///< its buffer ran over before anybody looked
  std::uint64_t saturated = 0;
  std::uint64_t bus_errors = 0;  ///< transfers that failed
  std::uint64_t nonsense = 0;    ///< all zero, all ones, or the same reading for too long
  std::uint64_t restarts = 0;
};

/// Reads the chip's buffer (FIFO): next() looks into it some times around the moment at which a sample is expected.
/// Times are the chip's even steps on CLOCK_MONOTONIC, less the delay of its low-pass filter. A chip that fails, lies
/// or is gone is set up anew, five times a second, within next(), step by step: no call waits longer than it may. One
/// thread; no allocation, no lock in next().
class Mpu6000 final : public Imu {
 public:
  /// Error: settings that the chip cannot do. A chip that is not there, or another one, is no error: see trouble() and
  /// events(); it is looked for.
  static rt::Result<std::unique_ptr<Mpu6000>> open(std::unique_ptr<SpiPort> port, const Mpu6000Settings& settings);

  double rate_hz() const override { return settings_.rate_hz; }
  ImuRanges ranges() const override;
  ImuStatus next(ImuSample* sample, rt::TimeNs timeout_ns) override;
  rt::LogRing* events() override { return &events_; }

  const Mpu6000Counters& counters() const { return counters_; }
  /// Of the newest reading. Any thread.
  float temperature_c() const { return temperature_c_.load(std::memory_order_relaxed); }
  /// What keeps it from running, static text; null: it runs. The thread of next().
  const char* trouble() const { return trouble_; }
  /// Change of the self-test's response from the factory's, the largest of the six axes [%]; below 14 passes (PS-MPU-
  /// 6000A, table 6.1 and 6.2). Negative: not made, or the chip holds no factory values.
  double self_test_percent() const { return self_test_percent_; }

 private:
  static constexpr rt::TimeNs kRetryNs = 200 * rt::kNsPerMs;
  static constexpr int kBatch = 16;  ///< samples read at once; the chip's buffer holds 73

  Mpu6000(std::unique_ptr<SpiPort> port, const Mpu6000Settings& settings)
      : port_(std::move(port)), settings_(settings) {}

  bool read(std::uint8_t address, std::uint8_t* to, std::size_t bytes);
  bool write(std::uint8_t address, std::uint8_t value);
  /// What comes next on the way to a chip that runs.
  enum class Step : std::uint8_t { kReset, kSignalPath, kIdentify, kTestWithout, kTestWith, kConfigure, kRunning };
  /// Goes on with setting up until give_up_ns. Static text of what failed; null: it runs, or there was no more time.
  const char* set_up(rt::TimeNs give_up_ns);
  const char* take_step();
  /// After this long.
  void then(Step step, rt::TimeNs wait_ns);
  const char* reset();
  const char* identify();
  const char* configure();
  const char* set_registers();
  bool empty_buffer();
  /// One of the readings whose mean the self-test needs. True: that was the last one.
  bool read_for_test(std::array<double, 6>* mean, bool* last);
  bool begin_test(std::uint8_t gyro, std::uint8_t accel, Step step);
  bool judge_self_test();
  ImuStatus fail(const char* why);
  ImuStatus look(rt::TimeNs give_up_ns);
  ImuStatus fetch(int count, rt::TimeNs before_ns);
  bool convert(const std::uint8_t* raw, ImuSample* sample);

  std::unique_ptr<SpiPort> port_;
  const Mpu6000Settings settings_;
  Mpu6000Counters counters_;
  rt::LogRing events_;
  std::atomic<float> temperature_c_{0};  ///< a number alone
  const char* trouble_ = "not set up yet";
  Step step_ = Step::kReset;
  rt::TimeNs step_due_ns_ = 0;
  bool tested_ = false;
  int test_readings_ = 0;
  std::array<double, 6> test_without_{}, test_with_{};  ///< gyro, acceleration
  double self_test_percent_ = -1;
  SampleClock clock_;
  ReadingCheck check_;
  rt::TimeNs empty_ns_ = 0;  ///< the last look that found nothing, or took everything
  rt::TimeNs heard_ns_ = 0;  ///< the last look that found something
  std::array<ImuSample, kBatch> ready_{};
  int ready_count_ = 0, ready_next_ = 0;
  bool gap_ = false;
};

}  // namespace godwit::hal
