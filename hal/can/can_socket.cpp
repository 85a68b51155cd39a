#include "hal/can/can_socket.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <string>
#include <sys/socket.h>

namespace godwit::hal {

void count_overflow(int fd) {
  const int on = 1;
  setsockopt(fd, SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof on);
}

CanSend send_datagram(int fd, std::span<const std::uint8_t> bytes, CanCounters* counters) {
  if (::send(fd, bytes.data(), bytes.size(), MSG_DONTWAIT) == std::ssize(bytes)) {
    ++counters->sent;
    return CanSend::kSent;
  }
  if (errno == EAGAIN || errno == ENOBUFS || errno == EINTR) {
    ++counters->send_full;
    return CanSend::kFull;
  }
  ++counters->send_failed;
  return CanSend::kDown;
}

CanDatagram receive_datagram(int fd, std::span<std::uint8_t> into, std::uint64_t* overflow) {
  CanDatagram out;
  iovec part{into.data(), into.size()};
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(std::uint32_t))> control;
  msghdr message{};
  message.msg_name = &out.from;
  message.msg_namelen = sizeof out.from;
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  message.msg_control = control.data();
  message.msg_controllen = control.size();
  out.size = recvmsg(fd, &message, MSG_DONTWAIT);
  if (out.size < 0) return out;
  out.truncated = (message.msg_flags & MSG_TRUNC) != 0;
  for (cmsghdr* c = CMSG_FIRSTHDR(&message); c != nullptr; c = CMSG_NXTHDR(&message, c)) {
    if (c->cmsg_level != SOL_SOCKET || c->cmsg_type != SO_RXQ_OVFL) continue;
    std::uint32_t dropped = 0;
    std::memcpy(&dropped, CMSG_DATA(c), sizeof dropped);
    *overflow = dropped;
  }
  return out;
}

rt::Result<void> CanFilterList::set(std::span<const CanFilter> filters) {
  if (filters.size() > filters_.size()) return rt::Error{"CAN filters: at most " + std::to_string(filters_.size())};
  std::copy(filters.begin(), filters.end(), filters_.begin());
  count_ = filters.size();
  return {};
}

}  // namespace godwit::hal
