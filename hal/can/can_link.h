// What the kernel says of a CAN network interface (rtnetlink, by libnl-route), what a user should change about it, and
// how to restart its controller after bus-off.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "hal/rt/result.h"

struct nl_sock;

namespace godwit::hal {

struct CanLinkInfo {
  std::string name;
  std::string kind;   ///< "can", "vcan", ... ; empty for other interfaces
  std::string qdisc;  ///< queueing discipline
  bool up = false;
  std::uint32_t txqueuelen = 0;
  std::uint32_t restart_ms = 0;  ///< 0: the kernel leaves a controller off after bus-off
  std::uint32_t bit_rate = 0;    ///< nominal [bit/s], 0 unknown
  bool fd = false;               ///< CAN FD switched on
};

/// Asks the kernel. Blocks for the length of one system call; allocates. Error: no such interface.
rt::Result<CanLinkInfo> read_can_link(const std::string& interface);

/// What does not fit a node that sends bursts of 40 frames, in words with the command that mends it. Queues shorter
/// than a burst give ENOBUFS (libcsp #74); fq_codel drops frames unseen (systemd #9194).
std::vector<std::string> can_link_advice(const CanLinkInfo& info);

struct NetlinkSocketDeleter {
  void operator()(nl_sock* socket) const;
};

/// Asks the kernel to restart a controller that is bus-off. Needs CAP_NET_ADMIN; without it restart-ms is the only way.
class CanRestarter {
 public:
  /// Opens the socket and makes the message by libnl, which allocates.
  CanRestarter();
  /// One system call; no allocation. False: it could not be asked.
  bool request(int interface_index);

 private:
  std::vector<std::uint8_t> message_;
  std::unique_ptr<nl_sock, NetlinkSocketDeleter> socket_;
};

/// What it sends, for interface 0; empty: libnl could not make it.
std::vector<std::uint8_t> can_restart_message();

}  // namespace godwit::hal
