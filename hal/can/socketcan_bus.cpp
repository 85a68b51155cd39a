#include "hal/can/socketcan_bus.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

namespace godwit::hal {
CanState state_after_error_frame(CanState before, const canfd_frame& raw) {
  if ((raw.can_id & CAN_ERR_BUSOFF) != 0) return CanState::kBusOff;
  if ((raw.can_id & CAN_ERR_RESTARTED) != 0) return CanState::kActive;
  if ((raw.can_id & CAN_ERR_CRTL) != 0) {
    const unsigned controller = raw.data[1];
    if ((controller & (CAN_ERR_CRTL_RX_PASSIVE | CAN_ERR_CRTL_TX_PASSIVE)) != 0) return CanState::kPassive;
    if ((controller & (CAN_ERR_CRTL_RX_WARNING | CAN_ERR_CRTL_TX_WARNING)) != 0) return CanState::kWarning;
    if ((controller & CAN_ERR_CRTL_ACTIVE) != 0) return CanState::kActive;
  }
  return before;
}

rt::Result<std::unique_ptr<SocketCanBus>> SocketCanBus::open(const std::string& interface, bool wait_for_it) {
  const std::string name = "CAN bus socketcan:" + interface + ": ";
  if (interface.size() >= IFNAMSIZ) return rt::Error{name + "the interface name is too long"};
  std::unique_ptr<SocketCanBus> self(new SocketCanBus(interface));
  const char* failed = self->connect();
  const int reason = failed != nullptr ? errno : 0;
  const bool absent = reason == ENODEV || reason == EAFNOSUPPORT;
  if (absent && wait_for_it) {
    self->disconnect();
    self->restarter_ = std::make_unique<CanRestarter>();
    self->fd_frames_ = true;  // what it will be like is not known: the kernel refuses what it cannot carry
    self->advice_ = {name + "the interface is not there (yet); it is looked for"};
    return self;
  }
  if (failed != nullptr && reason != ENETDOWN) {  // an interface that is down is told in words and waited for
    std::string message = name + failed + ": " + std::strerror(reason);
    if (reason == EAFNOSUPPORT) message += "; this kernel has no CAN: modprobe can_raw, or use multicast:0";
    if (reason == ENODEV) message += "; ip link shows the interfaces there are";
    return rt::Error{message};
  }
  self->restarter_ = std::make_unique<CanRestarter>();
  const auto link = read_can_link(interface);
  if (!link.ok()) return rt::Error{name + link.error().message};
  self->bit_rate_ = link.value().bit_rate;
  self->fd_frames_ = link.value().fd || link.value().kind == "vcan";
  self->advice_ = can_link_advice(link.value());
  return self;
}

std::unique_ptr<SocketCanBus> SocketCanBus::adopt(int descriptor) {
  std::unique_ptr<SocketCanBus> self(new SocketCanBus("adopted"));
  self->fd_ = descriptor;
  self->fd_frames_ = true;
  self->reopen_ = false;
  self->state_ = CanState::kActive;
  return self;
}

SocketCanBus::~SocketCanBus() {
  disconnect();
}

void SocketCanBus::disconnect() {
  if (fd_ >= 0) close(fd_);
  fd_ = -1;
  state_ = CanState::kGone;
}

const char* SocketCanBus::connect() {
  fd_ = socket(PF_CAN, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, CAN_RAW);
  if (fd_ < 0) return "socket";
  interface_index_ = static_cast<int>(if_nametoindex(interface_.c_str()));
  if (interface_index_ == 0) return "find interface";
  const int on = 1;
  const can_err_mask_t errors = CAN_ERR_MASK;
  if (setsockopt(fd_, SOL_CAN_RAW, CAN_RAW_ERR_FILTER, &errors, sizeof errors) != 0) return "CAN_RAW_ERR_FILTER";
  count_overflow(fd_);
  // Only lets FD frames through the socket; whether the interface takes them was read when it was opened. Old kernels
  // lack the option, and then also FD interfaces.
  setsockopt(fd_, SOL_CAN_RAW, CAN_RAW_FD_FRAMES, &on, sizeof on);
  ifreq flags{};
  std::copy(interface_.begin(), interface_.end(), flags.ifr_name);
  if (ioctl(fd_, SIOCGIFFLAGS, &flags) != 0) return "SIOCGIFFLAGS";
  if ((flags.ifr_flags & IFF_UP) == 0) {
    disconnect();
    errno = ENETDOWN;
    return "interface";
  }
  sockaddr_can address{};
  address.can_family = AF_CAN;
  address.can_ifindex = interface_index_;
  if (bind(fd_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) return "bind";
  if (!apply_filters()) return "CAN_RAW_FILTER";
  state_ = CanState::kActive;
  return nullptr;
}

CanSend SocketCanBus::send(const CanFrame& frame) {
  if (fd_ < 0 || state_ == CanState::kBusOff) return CanSend::kDown;
  canfd_frame raw{};
  raw.can_id = frame.id | (frame.extended ? CAN_EFF_FLAG : 0U);
  raw.len = frame.length;
  raw.flags = frame.fd ? CANFD_BRS : 0;
  std::copy_n(frame.data.begin(), frame.length, raw.data);
  const std::size_t size = frame.fd ? CANFD_MTU : CAN_MTU;
  const CanSend sent = send_datagram(fd_, {reinterpret_cast<const std::uint8_t*>(&raw), size}, &counters_);
  if (sent != CanSend::kDown) return sent;
  if (errno == EINVAL || errno == EMSGSIZE) return CanSend::kRefused;
  if (reopen_ || errno != ENETDOWN) disconnect();
  return CanSend::kDown;
}

void SocketCanBus::take_error_frame(const canfd_frame& raw) {
  ++counters_.error_frames;
  if ((raw.can_id & CAN_ERR_BUSOFF) != 0) ++counters_.bus_off;
  state_ = state_after_error_frame(state_, raw);
}

bool SocketCanBus::receive(CanFrame* frame) {
  for (int i = 0; i < kSkipsPerReceive && fd_ >= 0; ++i) {
    canfd_frame raw{};
    const CanDatagram got =
        receive_datagram(fd_, {reinterpret_cast<std::uint8_t*>(&raw), sizeof raw}, &counters_.receive_overflow);
    if (got.size < 0) {
      if (errno == EAGAIN || errno == EINTR) return false;
      ++counters_.receive_failed;
      disconnect();
      return false;
    }
    const bool fd = got.size == static_cast<ssize_t>(CANFD_MTU);
    if ((!fd && got.size != static_cast<ssize_t>(CAN_MTU)) || raw.len > (fd ? kFdCanBytes : kClassicCanBytes)) {
      ++counters_.receive_malformed;
      continue;
    }
    if ((raw.can_id & CAN_ERR_FLAG) != 0) {
      take_error_frame(raw);
      continue;
    }
    if ((raw.can_id & CAN_RTR_FLAG) != 0) continue;               // nobody on this bus answers remote requests
    if (state_ == CanState::kBusOff) state_ = CanState::kActive;  // frames arrive: the controller is on the bus again
    frame->extended = (raw.can_id & CAN_EFF_FLAG) != 0;
    frame->id = raw.can_id & (frame->extended ? CAN_EFF_MASK : CAN_SFF_MASK);
    frame->fd = fd;
    frame->length = raw.len;
    std::copy_n(raw.data, raw.len, frame->data.begin());
    if (!passes(filters_.get(), *frame)) continue;
    ++counters_.received;
    return true;
  }
  return false;
}

rt::Result<void> SocketCanBus::set_filters(std::span<const CanFilter> filters) {
  if (auto kept = filters_.set(filters); !kept.ok()) return kept;
  // Without a socket they are set when there is one.
  if (reopen_ && fd_ >= 0 && !apply_filters()) return rt::Error{"CAN filters: " + std::string(std::strerror(errno))};
  return {};
}

bool SocketCanBus::apply_filters() {
  std::array<can_filter, kMaxFilters> kernel{};
  std::size_t count = 0;
  for (const CanFilter& f : filters_.get()) {
    kernel[count].can_id = f.id | (f.extended ? CAN_EFF_FLAG : 0U);
    kernel[count++].can_mask = f.mask | CAN_EFF_FLAG | CAN_RTR_FLAG;
  }
  if (count == 0) count = 1;  // one of zeros lets everything through
  return setsockopt(fd_, SOL_CAN_RAW, CAN_RAW_FILTER, kernel.data(),
                    static_cast<socklen_t>(count * sizeof(can_filter))) == 0;
}

void SocketCanBus::maintain(rt::TimeNs now_ns) {
  const bool gone = state_ == CanState::kGone && reopen_, off = state_ == CanState::kBusOff;
  if ((!gone && !off) || now_ns < next_attempt_ns_) return;
  next_attempt_ns_ = now_ns + kCanRetryNs;
  if (off) {
    // Nothing can be sent meanwhile, so the short stay of this call in the kernel costs nobody anything. Where we may
    // not ask (no CAP_NET_ADMIN), restart-ms of the interface does it and a RESTARTED error frame tells us.
    if (restarter_) restarter_->request(interface_index_);
    return;
  }
  if (connect() == nullptr) {
    ++counters_.reopened;
  } else {
    disconnect();
  }
}

}  // namespace godwit::hal
