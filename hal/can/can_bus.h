// One interface to a CAN bus: the kernel's SocketCAN, or UDP multicast where there is no kernel CAN.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "hal/can/can_frame.h"
#include "hal/rt/result.h"
#include "hal/rt/time.h"

namespace godwit::hal {

/// What became of one frame given to CanBus::send.
enum class CanSend : std::uint8_t {
  kSent,     ///< the bus took it
  kFull,     ///< no room in the queue below (EAGAIN, ENOBUFS): try the same frame again later
  kRefused,  ///< the interface cannot carry this frame, now or ever: let it go
  kDown      ///< the bus is off, down or gone: nothing can be sent now
};

/// How the controller stands towards the bus (ISO 11898-1 error states), and whether the interface is there at all.
enum class CanState : std::uint8_t { kActive, kWarning, kPassive, kBusOff, kGone };

/// Everything that was sent, received or lost since the bus was opened.
struct CanCounters {
  std::uint64_t sent = 0;
  std::uint64_t received = 0;
  std::uint64_t send_full = 0;          ///< sends refused because the queue below was full
  std::uint64_t send_failed = 0;        ///< sends refused for another reason
  std::uint64_t receive_failed = 0;     ///< reads that failed
  std::uint64_t receive_malformed = 0;  ///< datagrams or frames that were no CAN frame
  std::uint64_t receive_overflow = 0;   ///< frames the kernel dropped because we read too slowly
  std::uint64_t error_frames = 0;
  std::uint64_t bus_off = 0;
  std::uint64_t reopened = 0;  ///< times the interface was opened again after it went
};

/// A frame passes where (id & mask) == (this id & mask) and the identifier lengths are the same.
struct CanFilter {
  std::uint32_t id = 0;
  std::uint32_t mask = 0;
  bool extended = true;
};

/// A bus. One thread calls it. After opening: no allocation, no blocking call.
class CanBus {
 public:
  virtual ~CanBus() = default;
  /// Hands one frame to the bus.
  virtual CanSend send(const CanFrame& frame) = 0;
  /// Takes one received frame; false where none waits. Frames sent by this object are not received.
  virtual bool receive(CanFrame* frame) = 0;
  /// Only frames that pass one of these are received from now on; none given: all. At most kMaxFilters.
  virtual rt::Result<void> set_filters(std::span<const CanFilter> filters) = 0;
  /// Brings back a bus that went off or away; call it every few milliseconds. Tries at most every 100 ms.
  virtual void maintain(rt::TimeNs now_ns) = 0;
  virtual CanState state() const = 0;
  virtual const CanCounters& counters() const = 0;
  /// File descriptor to poll for reading; -1 while the interface is gone.
  virtual int descriptor() const = 0;
  /// True where FD frames can be sent.
  virtual bool supports_fd() const = 0;
  /// Nominal bit rate [bit/s], 0 where it is not known.
  virtual std::uint32_t bit_rate() const = 0;
  /// What a user should change about the interface, in words, each with the command; found when it was opened.
  virtual const std::vector<std::string>& advice() const = 0;

  static constexpr std::size_t kMaxFilters = 32;
};

/// Opens "multicast:N" (N 0..9, section 3 of the interface notes; "multicast:N:ADDRESS" picks the network interface
/// with this IPv4 address) or "socketcan:IFACE". The error names what was wrong and, where there is one, the remedy.
/// wait_for_it: an interface of the kernel that is not there yet is no error but a bus that is gone, and is looked for
/// as one that vanished.
rt::Result<std::unique_ptr<CanBus>> open_can(const std::string& address, bool wait_for_it = false);

/// Whether open_can would understand this address; opens nothing.
rt::Result<void> check_can_address(const std::string& address);

/// True where a frame passes the filters (none: everything passes).
bool passes(std::span<const CanFilter> filters, const CanFrame& frame);

}  // namespace godwit::hal
