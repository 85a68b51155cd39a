#include "hal/can/can_link.h"

#include <cstring>
#include <linux/can/netlink.h>
#include <linux/if_link.h>
#include <linux/rtnetlink.h>
#include <net/if.h>
#include <netlink/attr.h>
#include <netlink/msg.h>
#include <netlink/netlink.h>
#include <netlink/route/link.h>
#include <netlink/route/link/can.h>
#include <span>
#include <sys/socket.h>

namespace godwit::hal {
namespace {

constexpr std::uint32_t kBurstFrames = 100;  // an ODOMETRY of 40 frames, another behind it, and a long answer

struct LinkDeleter {
  void operator()(rtnl_link* link) const { rtnl_link_put(link); }
};
using Link = std::unique_ptr<rtnl_link, LinkDeleter>;

/// Null: no socket to be had.
std::unique_ptr<nl_sock, NetlinkSocketDeleter> connect_netlink(std::string* why) {
  std::unique_ptr<nl_sock, NetlinkSocketDeleter> out(nl_socket_alloc());
  const int failed = out ? nl_connect(out.get(), NETLINK_ROUTE) : -NLE_NOMEM;
  if (failed == 0) return out;
  *why = nl_geterror(failed);
  return nullptr;
}

std::string text(const char* words) {
  return words != nullptr ? words : "";
}

}  // namespace

void NetlinkSocketDeleter::operator()(nl_sock* socket) const {
  nl_socket_free(socket);
}

rt::Result<CanLinkInfo> read_can_link(const std::string& interface) {
  const std::string prefix = "network interface " + interface + ": ";
  std::string why;
  const auto socket = connect_netlink(&why);
  if (!socket) return rt::Error{prefix + "netlink: " + why};
  const timeval patience{1, 0};
  setsockopt(nl_socket_get_fd(socket.get()), SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  rtnl_link* found = nullptr;
  if (const int failed = rtnl_link_get_kernel(socket.get(), 0, interface.c_str(), &found); failed < 0) {
    return rt::Error{prefix + nl_geterror(failed)};
  }
  const Link link(found);
  CanLinkInfo info;
  info.name = interface;
  info.kind = text(rtnl_link_get_type(link.get()));
  info.qdisc = text(rtnl_link_get_qdisc(link.get()));
  info.up = (rtnl_link_get_flags(link.get()) & IFF_UP) != 0;
  info.txqueuelen = rtnl_link_get_txqlen(link.get());
  if (!rtnl_link_is_can(link.get())) return info;
  // What the driver does not tell stays as it is: not known, off.
  can_bittiming timing{};
  std::uint32_t mode = 0;
  if (rtnl_link_can_get_bittiming(link.get(), &timing) == 0) info.bit_rate = timing.bitrate;
  if (rtnl_link_can_get_ctrlmode(link.get(), &mode) == 0) info.fd = (mode & CAN_CTRLMODE_FD) != 0;
  rtnl_link_can_get_restart_ms(link.get(), &info.restart_ms);
  return info;
}

std::vector<std::string> can_link_advice(const CanLinkInfo& info) {
  std::vector<std::string> advice;
  const std::string set = "ip link set " + info.name;
  if (!info.up) {
    advice.push_back(info.name + " is down: " + set + " up" + (info.kind == "can" ? " type can bitrate 1000000" : ""));
  }
  if (info.txqueuelen < kBurstFrames) {
    advice.push_back(info.name + " queues only " + std::to_string(info.txqueuelen) +
                     " frames, a pose message has 40: " + set + " txqueuelen 200");
  }
  if (!info.qdisc.empty() && info.qdisc != "noqueue" && info.qdisc != "noop" && !info.qdisc.starts_with("pfifo")) {
    advice.push_back(info.name + " has the queueing discipline " + info.qdisc +
                     ", which may drop or reorder frames unseen: tc qdisc replace dev " + info.name +
                     " root pfifo limit 200");
  }
  if (info.kind == "can" && info.restart_ms == 0) {
    advice.push_back(info.name + " stays off after a bus-off: " + set + " type can restart-ms 100");
  }
  return advice;
}

std::vector<std::uint8_t> can_restart_message() {
  // rtnl_link_can_restart() would be the call for it, but libnl 3.7 leaves the order itself out of the message that it
  // makes (a test looks): the attributes are put in one by one.
  std::vector<std::uint8_t> out;
  nl_msg* made = nlmsg_alloc_simple(RTM_NEWLINK, NLM_F_REQUEST);
  if (made == nullptr) return out;
  ifinfomsg link{};
  bool whole = nlmsg_append(made, &link, sizeof link, NLMSG_ALIGNTO) == 0;
  nlattr* const info = nla_nest_start(made, IFLA_LINKINFO);
  whole = whole && info != nullptr && nla_put_string(made, IFLA_INFO_KIND, "can") == 0;
  nlattr* const data = whole ? nla_nest_start(made, IFLA_INFO_DATA) : nullptr;
  whole = data != nullptr && nla_put_u32(made, IFLA_CAN_RESTART, 1) == 0;
  if (whole) {
    nla_nest_end(made, data);
    nla_nest_end(made, info);
    const auto* begin = reinterpret_cast<const std::uint8_t*>(nlmsg_hdr(made));
    out.assign(begin, begin + nlmsg_hdr(made)->nlmsg_len);
  }
  nlmsg_free(made);
  return out;
}

CanRestarter::CanRestarter() : message_(can_restart_message()) {
  std::string why;
  socket_ = connect_netlink(&why);
}

bool CanRestarter::request(int interface_index) {
  if (!socket_ || message_.size() < NLMSG_LENGTH(sizeof(ifinfomsg))) return false;
  ifinfomsg link{};
  std::memcpy(&link, message_.data() + NLMSG_HDRLEN, sizeof link);
  link.ifi_index = interface_index;
  std::memcpy(message_.data() + NLMSG_HDRLEN, &link, sizeof link);
  return ::send(nl_socket_get_fd(socket_.get()), message_.data(), message_.size(), MSG_DONTWAIT) ==
         static_cast<ssize_t>(message_.size());
}

}  // namespace godwit::hal
