#include "hal/can/multicast_bus.h"

#include <algorithm>
#include <arpa/inet.h>
#include <cerrno>
#include <cstring>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include "hal/can/crc16.h"

namespace godwit::hal {
namespace {

constexpr std::uint16_t kMagic = 0x2934;
constexpr std::uint16_t kPort = 57732;
constexpr std::uint16_t kFlagFd = 1;
constexpr std::uint32_t kExtendedBit = 1U << 31;

template <typename T>
void put(std::uint8_t* at, T value) {
  for (std::size_t i = 0; i < sizeof(T); ++i) at[i] = static_cast<std::uint8_t>(value >> (8 * i));
}

std::uint32_t get(const std::uint8_t* at, int bytes) {
  std::uint32_t value = 0;
  for (int i = bytes - 1; i >= 0; --i) value = value << 8 | at[i];
  return value;
}

sockaddr_in group_address(int bus) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(kPort);
  address.sin_addr.s_addr = htonl(239U << 24 | 65U << 16 | 82U << 8 | static_cast<std::uint32_t>(bus));
  return address;
}

}  // namespace

std::size_t encode_datagram(const CanFrame& frame, MulticastDatagram* out) {
  std::uint8_t* p = out->data();
  put<std::uint16_t>(p, kMagic);
  put<std::uint16_t>(p + 4, frame.fd ? kFlagFd : 0);
  put<std::uint32_t>(p + 6, frame.id | (frame.extended ? kExtendedBit : 0));
  std::copy_n(frame.data.begin(), frame.length, p + kMulticastHeaderBytes);
  const std::size_t length = kMulticastHeaderBytes + frame.length;
  put<std::uint16_t>(p + 2, crc16({p + 4, length - 4}));
  return length;
}

bool decode_datagram(std::span<const std::uint8_t> datagram, CanFrame* frame) {
  if (datagram.size() < kMulticastHeaderBytes || datagram.size() > kMulticastHeaderBytes + kFdCanBytes) return false;
  if (get(datagram.data(), 2) != kMagic || get(datagram.data() + 2, 2) != crc16(datagram.subspan(4))) return false;
  const std::size_t length = datagram.size() - kMulticastHeaderBytes;
  frame->fd = (get(datagram.data() + 4, 2) & kFlagFd) != 0;
  if (!frame->fd && length > kClassicCanBytes) return false;
  const std::uint32_t id = get(datagram.data() + 6, 4);
  frame->extended = (id & kExtendedBit) != 0;
  frame->id = id & (frame->extended ? 0x1FFFFFFFU : 0x7FFU);
  frame->length = static_cast<std::uint8_t>(length);
  std::copy(datagram.begin() + kMulticastHeaderBytes, datagram.end(), frame->data.begin());
  return true;
}

rt::Result<std::unique_ptr<MulticastBus>> MulticastBus::open(int bus, const std::string& interface_address) {
  const std::string name = "CAN bus multicast:" + std::to_string(bus);
  if (bus < 0 || bus > 9) return rt::Error{name + ": the bus number must be 0 to 9"};
  in_addr address{};
  if (!interface_address.empty() && inet_pton(AF_INET, interface_address.c_str(), &address) != 1) {
    return rt::Error{name + ": \"" + interface_address + "\" is no IPv4 address of a network interface"};
  }
  std::unique_ptr<MulticastBus> self(new MulticastBus(bus, address.s_addr));
  if (const char* failed = self->connect()) {
    const int reason = errno;
    std::string message = name + ": " + failed + ": " + std::strerror(reason);
    if (reason == ENODEV || reason == ENETUNREACH || reason == EADDRNOTAVAIL) {
      message += "; give multicast a route: ip link set lo multicast on; ip route add 239.0.0.0/8 dev lo";
    }
    return rt::Error{message};
  }
  return self;
}

MulticastBus::~MulticastBus() {
  disconnect();
}

void MulticastBus::disconnect() {
  if (send_fd_ >= 0) close(send_fd_);
  if (receive_fd_ >= 0) close(receive_fd_);
  send_fd_ = receive_fd_ = -1;
  state_ = CanState::kGone;
}

const char* MulticastBus::connect() {
  const sockaddr_in group = group_address(bus_);
  const auto* group_sockaddr = reinterpret_cast<const sockaddr*>(&group);
  const int on = 1;
  receive_fd_ = socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  send_fd_ = socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
  if (receive_fd_ < 0 || send_fd_ < 0) return "socket";
  if (setsockopt(receive_fd_, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on) != 0) return "SO_REUSEADDR";
  // A burst of a few hundred frames must not be lost while our thread is elsewhere; the kernel may give less.
  const int receive_buffer = 1 << 20;
  setsockopt(receive_fd_, SOL_SOCKET, SO_RCVBUF, &receive_buffer, sizeof receive_buffer);
  count_overflow(receive_fd_);
  if (bind(receive_fd_, group_sockaddr, sizeof group) != 0) return "bind";
  ip_mreqn membership{};
  membership.imr_multiaddr = group.sin_addr;
  membership.imr_address.s_addr = interface_address_;
  if (setsockopt(receive_fd_, IPPROTO_IP, IP_ADD_MEMBERSHIP, &membership, sizeof membership) != 0) return "join group";
  if (interface_address_ != 0 &&
      setsockopt(send_fd_, IPPROTO_IP, IP_MULTICAST_IF, &membership.imr_address, sizeof(in_addr)) != 0) {
    return "choose interface";
  }
  if (::connect(send_fd_, group_sockaddr, sizeof group) != 0) return "connect";
  sockaddr_in own{};
  socklen_t own_size = sizeof own;
  if (getsockname(send_fd_, reinterpret_cast<sockaddr*>(&own), &own_size) != 0) return "getsockname";
  own_port_ = own.sin_port;
  state_ = CanState::kActive;
  return nullptr;
}

CanSend MulticastBus::send(const CanFrame& frame) {
  if (send_fd_ < 0) return CanSend::kDown;
  MulticastDatagram datagram;
  const std::size_t length = encode_datagram(frame, &datagram);
  const CanSend sent = send_datagram(send_fd_, std::span(datagram).first(length), &counters_);
  if (sent == CanSend::kDown) disconnect();
  return sent;
}

bool MulticastBus::receive(CanFrame* frame) {
  for (int i = 0; i < kSkipsPerReceive && receive_fd_ >= 0; ++i) {
    MulticastDatagram datagram;
    const CanDatagram got = receive_datagram(receive_fd_, datagram, &counters_.receive_overflow);
    if (got.size < 0) {
      if (errno == EAGAIN || errno == EINTR) return false;
      ++counters_.receive_failed;
      if (errno != ECONNREFUSED) disconnect();
      return false;
    }
    if (got.from.sin_port == own_port_) continue;
    if (got.truncated || !decode_datagram(std::span(datagram).first(got.size), frame)) {
      ++counters_.receive_malformed;
      continue;
    }
    if (!passes(filters_.get(), *frame)) continue;
    ++counters_.received;
    return true;
  }
  return false;
}

rt::Result<void> MulticastBus::set_filters(std::span<const CanFilter> filters) {
  return filters_.set(filters);
}

void MulticastBus::maintain(rt::TimeNs now_ns) {
  if (state_ != CanState::kGone || now_ns < next_attempt_ns_) return;
  next_attempt_ns_ = now_ns + kCanRetryNs;
  if (connect() == nullptr) {
    ++counters_.reopened;
  } else {
    disconnect();
  }
}

}  // namespace godwit::hal
