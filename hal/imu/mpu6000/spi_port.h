// What the MPU-6000 asks of the machine: a thin layer over spidev, so that tests can play a chip that lies.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "hal/rt/time.h"

namespace godwit::hal {

class SpiPort {
 public:
  virtual ~SpiPort() = default;
  /// Opens the device in mode 0, 8 bits a word. False: see errno. No allocation of our own.
  virtual bool open(const char* path, std::uint32_t speed_hz) = 0;
  virtual void close() = 0;
  /// Full duplex under one chip select. False: see errno. No allocation.
  virtual bool transfer(const std::uint8_t* tx, std::uint8_t* rx, std::size_t bytes) = 0;
  virtual rt::TimeNs now_ns() = 0;
  virtual void sleep_until(rt::TimeNs t_ns) = 0;
};

std::unique_ptr<SpiPort> spidev_port();

}  // namespace godwit::hal
