#include "hal/imu/mpu6000/mpu6000.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

namespace godwit::hal {
namespace {

// Registers (RM-MPU-6000A, chapter 3).
constexpr std::uint8_t kSelfTestX = 0x0D, kSampleRateDivider = 0x19, kGyroConfig = 0x1B, kAccelConfig = 0x1C,
                       kFifoEnable = 0x23, kInterruptStatus = 0x3A, kAccelXHigh = 0x3B, kSignalPathReset = 0x68,
                       kUserControl = 0x6A, kPower1 = 0x6B, kPower2 = 0x6C, kFifoCount = 0x72, kFifo = 0x74,
                       kWhoAmI = 0x75;
constexpr std::uint8_t kMpu6000 = 0x68;
constexpr std::uint8_t kOverflow = 0x10;
constexpr std::uint8_t kNoI2c = 0x10, kFifoOn = 0x40, kFifoReset = 0x04;
constexpr std::uint8_t kFifoAll = 0xF8;  ///< temperature, gyro, acceleration
constexpr std::size_t kSampleBytes = 14;
constexpr std::size_t kMostBytes = 1 + 16 * kSampleBytes;
/// Registers other than the sensors' may be read at 1 MHz (PS-MPU-6000A, table 6.6).
constexpr std::uint32_t kSpeedHz = 1'000'000;
constexpr double kGravity = 9.80665;
constexpr rt::TimeNs kResetNs = 100 * rt::kNsPerMs;
constexpr const char* kBusFails = "the bus fails";
constexpr const char* kTestBusFails = "the bus fails in the self-test";

/// The low-pass filter (register CONFIG) and the mean of its delays for gyro and accelerometer.
struct Filter {
  std::uint8_t code;
  double bandwidth_hz;
  rt::TimeNs delay_ns;
};
constexpr Filter kFilters[] = {{1, 184, 1'950'000}, {2, 94, 2'900'000},  {3, 44, 4'850'000},
                               {4, 21, 8'400'000},  {5, 10, 13'600'000}, {6, 5, 18'800'000}};

/// The widest filter below half the rate.
const Filter& filter_for(int rate_hz) {
  for (const Filter& f : kFilters) {
    if (f.bandwidth_hz <= 0.5 * rate_hz) return f;
  }
  return kFilters[5];
}

int code_of(int range, int smallest) {
  for (int code = 0; code < 4; ++code) {
    if (range == smallest << code) return code;
  }
  return -1;
}

std::int16_t word(const std::uint8_t* p) {
  return static_cast<std::int16_t>(p[0] << 8 | p[1]);
}

}  // namespace

rt::Result<std::unique_ptr<Mpu6000>> Mpu6000::open(std::unique_ptr<SpiPort> port, const Mpu6000Settings& settings) {
  if (settings.rate_hz < 10 || settings.rate_hz > 1000 || 1000 % settings.rate_hz != 0) {
    return rt::Error{"mpu6000: a rate of " + std::to_string(settings.rate_hz) +
                     " Hz; 1000 over a whole number is allowed, from 10 to 1000"};
  }
  if (code_of(settings.gyro_range_deg_s, 250) < 0) {
    return rt::Error{"mpu6000: gyro range: 250, 500, 1000 or 2000 degrees a second are allowed"};
  }
  if (code_of(settings.accel_range_g, 2) < 0)
    return rt::Error{"mpu6000: accelerometer range: 2, 4, 8 or 16 g are allowed"};
  std::unique_ptr<Mpu6000> out(new Mpu6000(std::move(port), settings));
  constexpr rt::TimeNs kLongEnoughNs = 2 * rt::kNsPerSecond;
  if (const char* const why = out->set_up(out->port_->now_ns() + kLongEnoughNs)) out->fail(why);
  if (out->step_ == Step::kRunning) out->trouble_ = nullptr;
  return out;
}

bool Mpu6000::read(std::uint8_t address, std::uint8_t* to, std::size_t bytes) {
  std::uint8_t tx[kMostBytes] = {}, rx[kMostBytes];
  tx[0] = static_cast<std::uint8_t>(address | 0x80);
  if (!port_->transfer(tx, rx, bytes + 1)) {
    ++counters_.bus_errors;
    return false;
  }
  std::copy(rx + 1, rx + 1 + bytes, to);
  return true;
}

bool Mpu6000::write(std::uint8_t address, std::uint8_t value) {
  const std::uint8_t tx[2] = {address, value};
  std::uint8_t rx[2];
  if (port_->transfer(tx, rx, 2)) return true;
  ++counters_.bus_errors;
  return false;
}

const char* Mpu6000::set_registers() {
  const auto rate_divider = static_cast<std::uint8_t>(1000 / settings_.rate_hz - 1);
  const std::uint8_t wanted[4] = {rate_divider, filter_for(settings_.rate_hz).code,
                                  static_cast<std::uint8_t>(code_of(settings_.gyro_range_deg_s, 250) << 3),
                                  static_cast<std::uint8_t>(code_of(settings_.accel_range_g, 2) << 3)};
  for (std::uint8_t i = 0; i < 4; ++i) {
    if (!write(static_cast<std::uint8_t>(kSampleRateDivider + i), wanted[i])) return kBusFails;
  }
  std::uint8_t held[4] = {};
  if (!read(kSampleRateDivider, held, 4)) return kBusFails;
  return std::equal(wanted, wanted + 4, held) ? nullptr : "the chip does not keep what is written to it";
}

void Mpu6000::then(Step step, rt::TimeNs wait_ns) {
  step_ = step;
  step_due_ns_ = port_->now_ns() + wait_ns;
}

ImuRanges Mpu6000::ranges() const {
  constexpr double kDegree = 3.14159265358979323846 / 180;
  return {settings_.gyro_range_deg_s * kDegree, settings_.accel_range_g * kGravity};
}

const char* Mpu6000::set_up(rt::TimeNs give_up_ns) {
  while (step_ != Step::kRunning) {
    port_->sleep_until(std::min(give_up_ns, step_due_ns_));
    if (port_->now_ns() < step_due_ns_) return nullptr;
    if (const char* const why = take_step()) return why;
  }
  return nullptr;
}

const char* Mpu6000::take_step() {
  bool last = false;
  switch (step_) {
    case Step::kReset:
      return reset();
    case Step::kSignalPath:
      if (!write(kSignalPathReset, 0x07)) return kBusFails;
      then(Step::kIdentify, kResetNs);
      return nullptr;
    case Step::kIdentify:
      return identify();
    case Step::kTestWithout:
      if (!read_for_test(&test_without_, &last)) return kTestBusFails;
      if (last && !begin_test(0xE0, 0xF0, Step::kTestWith)) return kTestBusFails;
      return nullptr;
    case Step::kTestWith:
      if (!read_for_test(&test_with_, &last)) return kTestBusFails;
      if (!last) return nullptr;
      if (!judge_self_test()) return kTestBusFails;
      then(Step::kConfigure, 0);
      return nullptr;
    case Step::kConfigure:
      return configure();
    case Step::kRunning:
      break;
  }
  return nullptr;
}

const char* Mpu6000::reset() {
  if (!port_->open(settings_.device.c_str(), kSpeedHz)) return "the SPI device cannot be opened";
  if (!write(kPower1, 0x80)) return kBusFails;
  then(Step::kSignalPath, kResetNs);
  return nullptr;
}

const char* Mpu6000::identify() {
  // After power-on the chip listens to I2C, too, and may take our traffic for it (RM, USER_CTRL).
  if (!write(kUserControl, kNoI2c)) return kBusFails;
  std::uint8_t who = 0;
  if (!read(kWhoAmI, &who, 1)) return kBusFails;
  switch (who) {
    case kMpu6000:
      break;
    case 0x00:
    case 0xFF:
      return "nothing answers on the bus";
    case 0x70:
      return "another chip answers: an MPU-6500 (WHO_AM_I 0x70)";
    case 0x71:
      return "another chip answers: an MPU-9250 (WHO_AM_I 0x71)";
    case 0x12:
      return "another chip answers: an ICM-20602 (WHO_AM_I 0x12)";
    case 0x47:
      return "another chip answers: an ICM-42688-P (WHO_AM_I 0x47); imu.source = \"iio\" takes it";
    default:
      return "another chip answers: WHO_AM_I is not 0x68";
  }
  // The gyro's oscillator is better than the chip's own (RM, PWR_MGMT_1).
  if (!write(kPower1, 0x01) || !write(kPower2, 0x00)) return kBusFails;
  then(Step::kConfigure, 0);
  if (!settings_.self_test || tested_) return nullptr;
  // RM-MPU-6000A, 4.1 to 4.5: ranges 250 deg/s and 8 g. Never again: a chip that comes back does so in flight.
  tested_ = true;
  return begin_test(0x00, 0x10, Step::kTestWithout) ? nullptr : kTestBusFails;
}

const char* Mpu6000::configure() {
  if (const char* const why = set_registers()) return why;
  if (!write(kFifoEnable, kFifoAll) || !empty_buffer()) return kBusFails;
  clock_.start(rt::kNsPerSecond / settings_.rate_hz);
  check_.reset();
  ready_count_ = ready_next_ = 0;
  step_ = Step::kRunning;
  return nullptr;
}

bool Mpu6000::empty_buffer() {
  if (!write(kUserControl, kNoI2c | kFifoReset) || !write(kUserControl, kNoI2c | kFifoOn)) return false;
  std::uint8_t status = 0;
  if (!read(kInterruptStatus, &status, 1)) return false;  // an overflow from before is read away
  empty_ns_ = heard_ns_ = port_->now_ns();
  return true;
}

bool Mpu6000::begin_test(std::uint8_t gyro, std::uint8_t accel, Step step) {
  if (!write(kGyroConfig, gyro) || !write(kAccelConfig, accel)) return false;
  test_readings_ = 0;
  (step == Step::kTestWith ? test_with_ : test_without_) = {};
  then(step, 50 * rt::kNsPerMs);  // the response settles (AN-MPU-6000A-00)
  return true;
}

bool Mpu6000::read_for_test(std::array<double, 6>* mean, bool* last) {
  constexpr int kReadings = 20;
  std::uint8_t raw[kSampleBytes] = {};
  if (!read(kAccelXHigh, raw, kSampleBytes)) return false;
  for (std::size_t a = 0; a < 3; ++a) {
    (*mean)[a] += word(raw + 8 + 2 * a) / static_cast<double>(kReadings);
    (*mean)[3 + a] += word(raw + 2 * a) / static_cast<double>(kReadings);
  }
  *last = ++test_readings_ == kReadings;
  step_due_ns_ = port_->now_ns() + rt::kNsPerMs;
  return true;
}

bool Mpu6000::judge_self_test() {
  // Response: with less without; the factory's from SELF_TEST.
  const std::array<double, 6>&without = test_without_, &with = test_with_;
  std::uint8_t code[4] = {};
  if (!read(kSelfTestX, code, 4)) return false;
  double worst = -1;
  for (std::size_t a = 0; a < 3; ++a) {
    const int gyro = code[a] & 0x1F;
    const int accel = (code[a] >> 5 & 0x07) << 2 | (code[3] >> (4 - 2 * a) & 0x03);
    const double gyro_trim = (a == 1 ? -1 : 1) * 25 * 131 * std::pow(1.046, gyro - 1);
    const double accel_trim = 4096 * 0.34 * std::pow(0.92 / 0.34, (accel - 1) / 30.0);
    if (gyro != 0) worst = std::max(worst, 100 * std::abs((with[a] - without[a]) / gyro_trim - 1));
    if (accel != 0) worst = std::max(worst, 100 * std::abs((with[3 + a] - without[3 + a]) / accel_trim - 1));
  }
  self_test_percent_ = worst;
  const bool good = worst >= 0 && worst <= 14;
  events_.say({.t_ns = port_->now_ns(),
               .level = good ? rt::LogLevel::kInfo : rt::LogLevel::kWarning,
               .what = worst < 0 ? "IMU self-test: the chip holds no factory values"
                       : good    ? "IMU self-test passed"
                                 : "IMU self-test failed",
               .why = "off the factory's by [%]",
               .value = worst,
               .limit = 14});
  return true;
}

ImuStatus Mpu6000::fail(const char* why) {
  if (trouble_ != why) {
    events_.say({.t_ns = port_->now_ns(), .level = rt::LogLevel::kWarning, .what = "IMU fails", .which = why});
  }
  trouble_ = why;
  gap_ = true;
  ready_count_ = ready_next_ = 0;
  port_->close();
  then(Step::kReset, kRetryNs);
  return ImuStatus::kFault;
}

ImuStatus Mpu6000::next(ImuSample* sample, rt::TimeNs timeout_ns) {
  const rt::TimeNs give_up = port_->now_ns() + timeout_ns;
  if (trouble_ != nullptr) {
    if (const char* const why = set_up(give_up)) return fail(why);
    if (step_ != Step::kRunning) return ImuStatus::kTimeout;
    ++counters_.restarts;
    trouble_ = nullptr;
    events_.say({.t_ns = port_->now_ns(), .what = "IMU is back"});
  }
  if (ready_next_ == ready_count_) {
    const ImuStatus status = look(give_up);
    if (status != ImuStatus::kSample) return status;
  }
  *sample = ready_[ready_next_++];
  return ImuStatus::kSample;
}

ImuStatus Mpu6000::look(rt::TimeNs give_up_ns) {
  const rt::TimeNs step = clock_.step_ns();
  // A quarter of a step early, so that a look finds nothing before one finds something: both together tell when.
  rt::TimeNs at = clock_.next_ns() == 0 ? port_->now_ns() : clock_.next_ns() - step / 4;
  // A chip whose clock stands gives nothing at all; a few steps of silence are a fault.
  constexpr int kSilentSteps = 20;
  while (true) {
    port_->sleep_until(std::min(at, give_up_ns));
    const rt::TimeNs before = port_->now_ns();
    if (before < at && before >= give_up_ns) return ImuStatus::kTimeout;
    // The status register lies elsewhere than the count: two transfers.
    std::uint8_t status = 0, count[2] = {};
    if (!read(kFifoCount, count, 2)) return fail(kBusFails);
    const rt::TimeNs after = port_->now_ns();
    const int bytes = count[0] << 8 | count[1];
    // While a sample is being written the count may stand in its middle; more than the chip holds is no count.
    if (bytes > 1024) return fail("the bus gives nonsense");
    const int whole = bytes / static_cast<int>(kSampleBytes);
    if (whole > 60) {
      if (!read(kInterruptStatus, &status, 1)) return fail(kBusFails);
      if ((status & kOverflow) != 0 || bytes >= 1010) {
        // What is left in a buffer that ran over no longer begins at a sample.
        ++counters_.overflows;
        gap_ = true;
        if (!empty_buffer()) return fail(kBusFails);
        clock_.start(rt::kNsPerSecond / settings_.rate_hz);
        return ImuStatus::kFault;
      }
    }
    if (whole > 0) return fetch(whole, after);
    if (before - heard_ns_ > kSilentSteps * step) return fail("it is there, but takes no samples");
    empty_ns_ = before;
    if (before >= give_up_ns) return ImuStatus::kTimeout;
    at = before + step / 8;
  }
}

ImuStatus Mpu6000::fetch(int count, rt::TimeNs before_ns) {
  const int batch = std::min(count, kBatch);
  std::uint8_t raw[16 * kSampleBytes];
  if (!read(kFifo, raw, batch * kSampleBytes)) return fail(kBusFails);
  // Those left in the chip were taken after these: the newest of these is older by as many steps.
  const rt::TimeNs rest = clock_.step_ns() * (count - batch);
  const rt::TimeNs t = clock_.take(batch, empty_ns_ - rest, before_ns - rest);
  if (count == batch) empty_ns_ = before_ns;
  heard_ns_ = before_ns;
  const rt::TimeNs delay = filter_for(settings_.rate_hz).delay_ns;
  ready_count_ = ready_next_ = 0;
  for (int i = 0; i < batch; ++i) {
    ImuSample s;
    s.t_ns = t + i * clock_.step_ns() - delay;
    if (!convert(raw + i * kSampleBytes, &s)) return ImuStatus::kFault;
    if (gap_) s.flags |= kImuGap;
    gap_ = false;
    ready_[ready_count_++] = s;
    ++counters_.samples;
  }
  return ImuStatus::kSample;
}

bool Mpu6000::convert(const std::uint8_t* raw, ImuSample* sample) {
  std::array<std::int32_t, 6> r{};  // acceleration, gyro
  for (std::size_t a = 0; a < 3; ++a) {
    r[a] = word(raw + 2 * a);
    r[3 + a] = word(raw + 8 + 2 * a);
  }
  if (const char* const why = check_.look(r)) {
    ++counters_.nonsense;
    fail(why);
    return false;
  }
  temperature_c_.store(static_cast<float>(word(raw + 6) / 340.0 + 36.53), std::memory_order_relaxed);
  const double accel_unit = ranges().accel_m_s2 / 32768, gyro_unit = ranges().gyro_rad_s / 32768;
  std::array<double, 3> accel{}, gyro{};
  for (std::size_t a = 0; a < 3; ++a) {
    accel[a] = r[a] * accel_unit;
    gyro[a] = r[3 + a] * gyro_unit;
    if (std::abs(r[a]) >= 32767) sample->flags |= kImuAccelSaturated;
    if (std::abs(r[3 + a]) >= 32767) sample->flags |= kImuGyroSaturated;
  }
  if (sample->flags != 0) ++counters_.saturated;
  sample->accel_m_s2 = settings_.axes.apply(accel);
  sample->gyro_rad_s = settings_.axes.apply(gyro);
  return true;
}

}  // namespace godwit::hal
