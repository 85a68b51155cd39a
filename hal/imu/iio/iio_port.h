// What the IIO sensor asks of the machine: a thin layer over libiio, so that tests can play a driver that lies.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "hal/rt/result.h"
#include "hal/rt/time.h"

namespace godwit::hal {

/// One device of the kernel's Industrial I/O, as it was opened.
struct IioDescription {
  bool has_accel = false, has_gyro = false;
  double accel_scale = 0, gyro_scale = 0;  ///< m/s^2 and rad/s a unit
  int accel_bits = 16, gyro_bits = 16;     ///< of a signed reading
  double rate_hz = 0;                      ///< as the driver says after it was set
};

/// One buffered reading: acceleration x y z, gyro x y z in units; what the device does not measure is 0.
struct IioScan {
  rt::TimeNs t_ns = 0;
  std::array<std::int32_t, 6> raw{};
};

/// Opening and closing block and allocate: a thread of the port's own does both. Everything else belongs to the thread
/// that reads, which neither allocates nor locks here.
class IioPort {
 public:
  enum class State : std::uint8_t {
    kBusy,    ///< an order is under way
    kOpen,    ///< description() holds, read() may be called
    kClosed,  ///< by order
    kFailed   ///< what it was: error()
  };
  enum class Read : std::uint8_t { kScans, kNothing, kGone };

  virtual ~IioPort() = default;
  /// Orders that the device be opened (or opened anew), its rate and its clock set, and its buffer switched on. From
  /// now on until kOpen nothing may be read.
  virtual void begin_open() = 0;
  /// Orders that it be closed.
  virtual void begin_close() = 0;
  virtual State state() = 0;
  /// Precondition: kOpen.
  virtual const IioDescription& description() = 0;
  /// Which step failed last on which device, and what there is; empty: none. Any thread; locks and allocates.
  virtual std::string error() = 0;
  /// Up to `capacity` readings in the order of the driver; waits at most timeout_ns for the first.
  virtual Read read(IioScan* scans, int capacity, rt::TimeNs timeout_ns, int* count) = 0;
  /// What to add now to its times to have CLOCK_MONOTONIC: 0 where the driver's clock could be set to it.
  virtual rt::TimeNs clock_offset_ns() = 0;
  virtual rt::TimeNs now_ns() = 0;
  virtual void sleep_until(rt::TimeNs t_ns) = 0;
};

/// The device with this name ("mpu6000", "icm42688-gyro") or id ("iio:device0"). tell: hears error() when it changes,
/// from the port's own thread; "": it is open.
std::unique_ptr<IioPort> libiio_port(const std::string& device, double rate_hz,
                                     std::function<void(const std::string&)> tell);

/// A rate as drivers read it: without a fraction where there is none, since some (inv_mpu6050) read whole numbers only.
std::string iio_rate_text(double rate_hz);

}  // namespace godwit::hal
