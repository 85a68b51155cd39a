// What both kinds of bus do with their sockets in the same way.
#pragma once

#include <array>
#include <cstdint>
#include <netinet/in.h>
#include <span>
#include <sys/types.h>

#include "hal/can/can_bus.h"

namespace godwit::hal {

/// How often a bus that went away is looked for again.
constexpr rt::TimeNs kCanRetryNs = 100 * rt::kNsPerMs;
/// Frames that one CanBus::receive passes over at most, so that a flood of them cannot hold the caller.
constexpr int kSkipsPerReceive = 64;

/// Asks the kernel to tell with each datagram how many it dropped because we read too slowly.
void count_overflow(int fd);

struct CanDatagram {
  ssize_t size = -1;  ///< below zero: nothing was read, errno says why
  bool truncated = false;
  sockaddr_in from{};  ///< UDP
};

/// One datagram without waiting, counted. kDown: it cannot be sent, errno says why.
CanSend send_datagram(int fd, std::span<const std::uint8_t> bytes, CanCounters* counters);

/// One datagram without waiting; *overflow becomes what the kernel counted, where it says so.
CanDatagram receive_datagram(int fd, std::span<std::uint8_t> into, std::uint64_t* overflow);

/// The filters of a bus.
class CanFilterList {
 public:
  rt::Result<void> set(std::span<const CanFilter> filters);
  std::span<const CanFilter> get() const { return {filters_.data(), count_}; }

 private:
  std::array<CanFilter, CanBus::kMaxFilters> filters_{};
  std::size_t count_ = 0;
};

}  // namespace godwit::hal
