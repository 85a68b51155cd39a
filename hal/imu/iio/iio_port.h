// What the IIO sensor asks of the machine: a thin layer over libiio, so that tests can play a driver that lies.
#pragma once

#include <array>
#include <cstdint>
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
  /// What to add to its times to have CLOCK_MONOTONIC: 0 where the driver's clock could be set to it.
  rt::TimeNs clock_offset_ns = 0;
};

/// One buffered reading: acceleration x y z, gyro x y z in units; what the device does not measure is 0.
struct IioScan {
  rt::TimeNs t_ns = 0;
  std::array<std::int32_t, 6> raw{};
};

class IioPort {
 public:
  enum class Read : std::uint8_t { kScans, kNothing, kGone };

  virtual ~IioPort() = default;
  /// Opens the device with this name ("mpu6000", "icm42688-gyro") or id ("iio:device0"), sets its rate and its clock,
  /// and switches its buffer on. Blocks and allocates. Error: which step failed on which device, and what there is.
  virtual rt::Result<IioDescription> open(const std::string& device, double rate_hz) = 0;
  virtual void close() = 0;
  /// Up to `capacity` readings in the order of the driver; waits at most timeout_ns for the first.
  virtual Read read(IioScan* scans, int capacity, rt::TimeNs timeout_ns, int* count) = 0;
  virtual rt::TimeNs now_ns() = 0;
  virtual void sleep_until(rt::TimeNs t_ns) = 0;
};

std::unique_ptr<IioPort> libiio_port();

/// A rate as drivers read it: without a fraction where there is none, since some (inv_mpu6050) read whole numbers only.
std::string iio_rate_text(double rate_hz);

}  // namespace godwit::hal
