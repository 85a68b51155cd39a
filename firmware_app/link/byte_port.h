// Bytes to and from an autopilot without CAN (PX4): UDP or a serial port.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>

#include "firmware_app/link/tx_queue.h"
#include "hal/rt/result.h"
#include "hal/rt/time.h"

namespace godwit::link {

/// One thread; never blocks; no allocation after opening.
class BytePort {
 public:
  virtual ~BytePort() = default;
  /// Takes a whole message or none of it. A pose takes the place of a waiting pose.
  virtual bool send(std::span<const std::uint8_t> message, TxClass tx_class) = 0;
  /// Sends what waited. Call it every few milliseconds.
  virtual void flush() = 0;
  /// Bytes that came, at most into.size(); 0 where there are none.
  virtual std::size_t receive(std::span<std::uint8_t> into) = 0;
  /// To wait on; -1 while it is gone.
  virtual int descriptor() const = 0;
  /// Once a step: tries to open again what went away, once a second. One open() and what sets it.
  virtual void maintain(rt::TimeNs now_ns) = 0;
  /// The device is not there, or there is no way to the other end.
  virtual bool gone() const = 0;
  /// Of a serial line; 0: it is none.
  virtual double baud_rate() const { return 0; }
};

/// "udp:HOST:PORT" (HOST an IPv4 address; answers are taken from there alone; "udp:HOST:PORT:LOCALPORT" binds) or
/// "serial:DEVICE:BAUD". The error names what was wrong. wait_for_it: a device that is not there yet, or a network that
/// is not up, is no error but a port that is gone, and is looked for.
rt::Result<std::unique_ptr<BytePort>> open_byte_port(const std::string& address, bool wait_for_it = false);

/// Whether open_byte_port would understand this address; opens nothing.
rt::Result<void> check_byte_port_address(const std::string& address);

/// Whole messages waiting for a stream that takes what it can: a message that began is finished, others of class kPose
/// give way to newer ones.
class ByteQueue {
 public:
  static constexpr std::size_t kMessages = 16;
  static constexpr std::size_t kMessageBytes = 300;
  bool push(std::span<const std::uint8_t> message, TxClass tx_class);
  /// What is to be written next; empty where nothing waits.
  std::span<const std::uint8_t> front() const;
  void consume(std::size_t bytes);
  std::uint64_t poses_replaced() const { return poses_replaced_; }

 private:
  struct Slot {
    TxClass tx_class = TxClass::kService;
    std::size_t size = 0;
    std::array<std::uint8_t, kMessageBytes> bytes{};
  };
  std::array<Slot, kMessages> slots_{};
  std::array<std::uint8_t, kMessages> order_{};  // indices of slots, oldest first
  std::uint32_t free_ = (1U << kMessages) - 1;
  std::size_t count_ = 0;
  std::size_t written_ = 0;  // of the oldest
  std::uint64_t poses_replaced_ = 0;
};

}  // namespace godwit::link
