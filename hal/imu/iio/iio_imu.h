// Inertial sensors with a kernel driver (Industrial I/O): MPU-6000, ICM-42688-P, BMI088, the Intel D435i's over HID.
#pragma once

#include <array>
#include <memory>
#include <string>

#include "hal/imu/axis_map.h"
#include "hal/imu/iio/iio_port.h"
#include "hal/imu/iio/own_clock.h"
#include "hal/imu/imu.h"
#include "hal/imu/reading_check.h"
#include "hal/rt/log_ring.h"

namespace godwit::hal {

struct IioSettings {
  double rate_hz = 200;
  AxisMap axes;
};

struct IioCounters {
  std::uint64_t samples = 0;
  std::uint64_t gaps = 0;          ///< steps of more than one and a half intervals
  std::uint64_t out_of_order = 0;  ///< readings that were not later than the one before: left out
  std::uint64_t wrong_time = 0;    ///< of the future or of long ago: left out
  std::uint64_t saturated = 0;
  std::uint64_t nonsense = 0;
  std::uint64_t restarts = 0;
};

/// Times are the driver's, taken at the interrupt, on CLOCK_MONOTONIC, or its device's own, which are followed. Where
/// rates and acceleration come from two devices, acceleration is interpolated to the times of the rates. A device that
/// is gone is looked for five times a second, by the port's own thread. One thread; next() neither allocates nor locks.
class IioImu final : public Imu {
 public:
  /// gyro: the device that measures rates, and acceleration unless accel does (ICM-42688-P, BMI088 and D435i have two:
  /// "gyro_3d", "accel_3d"); accel may be null. Waits for them to open, at most two seconds. A device that is not
  /// there is no error: see trouble() and events().
  static std::unique_ptr<IioImu> open(std::unique_ptr<IioPort> gyro, std::unique_ptr<IioPort> accel,
                                      const IioSettings& settings);

  /// What the device gives, which may be another rate than was wanted; that one while the device was never seen.
  double rate_hz() const override { return lines_[0].is.rate_hz > 0 ? lines_[0].is.rate_hz : settings_.rate_hz; }
  ImuRanges ranges() const override;  ///< once it was seen
  ImuStatus next(ImuSample* sample, rt::TimeNs timeout_ns) override;
  rt::LogRing* events() override { return &events_; }

  const IioCounters& counters() const { return counters_; }
  /// What keeps it from running, in words; empty: it runs. The thread of next(); allocates.
  std::string trouble() const;

 private:
  static constexpr rt::TimeNs kRetryNs = 200 * rt::kNsPerMs;
  static constexpr rt::TimeNs kSilentNs = 500 * rt::kNsPerMs;
  static constexpr rt::TimeNs kLookNs = 5 * rt::kNsPerMs;  ///< between two looks whether a port is open
  static constexpr int kBatch = 32;

  /// One device's readings that have not been used.
  struct Line {
    std::unique_ptr<IioPort> port;
    IioDescription is;
    std::array<IioScan, kBatch> scans{};
    int count = 0, next = 0;
    rt::TimeNs heard_ns = 0, last_ns = 0;
    rt::TimeNs offset_ns = 0;
    OwnClock clock;
  };
  struct Accel {
    rt::TimeNs t_ns = 0;
    std::array<std::int32_t, 3> raw{};
  };

  explicit IioImu(const IioSettings& settings) : settings_(settings) {}
  bool two() const { return lines_[1].port != nullptr; }
  const IioDescription& accel_is() const { return lines_[two() ? 1 : 0].is; }
  /// Waits for the ports. kSample: they are open, and good.
  ImuStatus come_up(rt::TimeNs give_up_ns);
  /// What is wrong with what was opened, static text; null: nothing.
  const char* start();
  ImuStatus fail(const char* why);
  /// Next reading in order of this device; kTimeout where there is none in time.
  ImuStatus take(Line* line, rt::TimeNs give_up_ns, IioScan* scan);
  /// Acceleration at t_ns from what was heard; waits for a later one.
  ImuStatus accel_at(rt::TimeNs t_ns, rt::TimeNs give_up_ns, std::array<double, 3>* raw);
  ImuStatus finish(const IioScan& scan, const std::array<double, 3>& accel, ImuSample* sample);

  const IioSettings settings_;
  std::array<Line, 2> lines_;
  IioCounters counters_;
  rt::LogRing events_;
  const char* trouble_ = nullptr;  ///< static text; null: none, or error() of a port says it
  bool running_ = false;
  bool opening_ = false;
  rt::TimeNs retry_ns_ = 0;
  ReadingCheck check_;
  std::array<Accel, 2> around_{};  ///< the two newest accelerations
  bool waiting_ = false;           ///< held_ waits for its acceleration
  IioScan held_;
  bool gap_ = false;
  rt::TimeNs last_ns_ = 0;
};

}  // namespace godwit::hal
