#include "hal/can/can_link.h"

#include <array>
#include <cerrno>
#include <cstring>
#include <linux/can/netlink.h>
#include <linux/if_link.h>
#include <linux/rtnetlink.h>
#include <net/if.h>
#include <span>
#include <sys/socket.h>
#include <unistd.h>

namespace godwit::hal {
namespace {

constexpr std::uint32_t kBurstFrames = 100;  // an ODOMETRY of 40 frames, another behind it, and a long answer

using Bytes = std::span<const std::uint8_t>;

// Calls visit(type, payload) for each netlink attribute of a block.
template <typename Visit>
void for_each_attribute(Bytes block, Visit visit) {
  while (block.size() >= sizeof(rtattr)) {
    rtattr attribute{};
    std::memcpy(&attribute, block.data(), sizeof attribute);
    if (attribute.rta_len < sizeof attribute || attribute.rta_len > block.size()) return;
    visit(attribute.rta_type & NLA_TYPE_MASK, block.subspan(RTA_LENGTH(0), attribute.rta_len - RTA_LENGTH(0)));
    block = block.subspan(std::min<std::size_t>(RTA_ALIGN(attribute.rta_len), block.size()));
  }
}

std::string text(Bytes bytes) {
  const auto* begin = reinterpret_cast<const char*>(bytes.data());
  return {begin, strnlen(begin, bytes.size())};
}

template <typename T>
T scalar(Bytes bytes) {
  T value{};
  if (bytes.size() >= sizeof value) std::memcpy(&value, bytes.data(), sizeof value);
  return value;
}

void read_can_attributes(Bytes block, CanLinkInfo* info) {
  for_each_attribute(block, [&](int type, Bytes value) {
    if (type == IFLA_CAN_RESTART_MS) info->restart_ms = scalar<std::uint32_t>(value);
    if (type == IFLA_CAN_BITTIMING) info->bit_rate = scalar<can_bittiming>(value).bitrate;
    if (type == IFLA_CAN_CTRLMODE) info->fd = (scalar<can_ctrlmode>(value).flags & CAN_CTRLMODE_FD) != 0;
  });
}

void read_link_info(Bytes block, CanLinkInfo* info) {
  for_each_attribute(block, [&](int type, Bytes value) {
    if (type == IFLA_INFO_KIND) info->kind = text(value);
    if (type == IFLA_INFO_DATA && info->kind == "can") read_can_attributes(value, info);
  });
}

// Appends an attribute to a message in `buffer`; returns where it stands.
rtattr* append(nlmsghdr* header, std::uint16_t type, const void* data, std::size_t size) {
  auto* attribute = reinterpret_cast<rtattr*>(reinterpret_cast<char*>(header) + NLMSG_ALIGN(header->nlmsg_len));
  attribute->rta_type = type;
  attribute->rta_len = static_cast<std::uint16_t>(RTA_LENGTH(size));
  if (size > 0) std::memcpy(RTA_DATA(attribute), data, size);
  header->nlmsg_len = static_cast<std::uint32_t>(NLMSG_ALIGN(header->nlmsg_len) + RTA_ALIGN(attribute->rta_len));
  return attribute;
}

void close_nest(nlmsghdr* header, rtattr* nest) {
  nest->rta_len =
      static_cast<std::uint16_t>(reinterpret_cast<char*>(header) + header->nlmsg_len - reinterpret_cast<char*>(nest));
}

}  // namespace

rt::Result<CanLinkInfo> read_can_link(const std::string& interface) {
  const std::string prefix = "network interface " + interface + ": ";
  const unsigned index = if_nametoindex(interface.c_str());
  if (index == 0) return rt::Error{prefix + std::strerror(errno)};
  const int fd = open_netlink();
  if (fd < 0) return rt::Error{prefix + "netlink: " + std::strerror(errno)};
  struct {
    nlmsghdr header;
    ifinfomsg link;
  } request{};
  request.header.nlmsg_len = NLMSG_LENGTH(sizeof(ifinfomsg));
  request.header.nlmsg_type = RTM_GETLINK;
  request.header.nlmsg_flags = NLM_F_REQUEST;
  request.link.ifi_index = static_cast<int>(index);
  alignas(nlmsghdr) std::array<std::uint8_t, 16384> reply;
  const timeval patience{1, 0};
  setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  ssize_t size = ::send(fd, &request, request.header.nlmsg_len, 0);
  if (size >= 0) size = recv(fd, reply.data(), reply.size(), 0);
  const int reason = errno;
  close(fd);
  if (size < 0) return rt::Error{prefix + "netlink: " + std::strerror(reason)};
  nlmsghdr header{};
  const auto length = static_cast<std::size_t>(size);
  if (length >= sizeof header) std::memcpy(&header, reply.data(), sizeof header);
  if (header.nlmsg_type != RTM_NEWLINK || header.nlmsg_len > length ||
      header.nlmsg_len < NLMSG_LENGTH(sizeof(ifinfomsg))) {
    return rt::Error{prefix + "the kernel gave no description of the link"};
  }
  CanLinkInfo info;
  info.name = interface;
  ifinfomsg link{};
  std::memcpy(&link, reply.data() + NLMSG_HDRLEN, sizeof link);
  info.up = (link.ifi_flags & IFF_UP) != 0;
  const std::size_t attributes = NLMSG_SPACE(sizeof(ifinfomsg));
  for_each_attribute(Bytes(reply).subspan(attributes, header.nlmsg_len - attributes), [&](int type, Bytes value) {
    if (type == IFLA_TXQLEN) info.txqueuelen = scalar<std::uint32_t>(value);
    if (type == IFLA_QDISC) info.qdisc = text(value);
    if (type == IFLA_LINKINFO) read_link_info(value, &info);
  });
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

int open_netlink() {
  return socket(AF_NETLINK, SOCK_RAW | SOCK_CLOEXEC, NETLINK_ROUTE);
}

bool request_can_restart(int netlink_fd, int interface_index) {
  alignas(nlmsghdr) std::array<std::uint8_t, 256> buffer{};
  auto* header = reinterpret_cast<nlmsghdr*>(buffer.data());
  header->nlmsg_len = NLMSG_LENGTH(sizeof(ifinfomsg));
  header->nlmsg_type = RTM_NEWLINK;
  header->nlmsg_flags = NLM_F_REQUEST;
  static_cast<ifinfomsg*>(NLMSG_DATA(header))->ifi_index = interface_index;
  const std::uint32_t restart = 1;
  rtattr* info = append(header, IFLA_LINKINFO, nullptr, 0);
  append(header, IFLA_INFO_KIND, "can", 3);
  rtattr* data = append(header, IFLA_INFO_DATA, nullptr, 0);
  append(header, IFLA_CAN_RESTART, &restart, sizeof restart);
  close_nest(header, data);
  close_nest(header, info);
  return ::send(netlink_fd, header, header->nlmsg_len, MSG_DONTWAIT) == static_cast<ssize_t>(header->nlmsg_len);
}

}  // namespace godwit::hal
