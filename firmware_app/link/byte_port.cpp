#include "firmware_app/link/byte_port.h"

#include <algorithm>
#include <arpa/inet.h>
#include <bit>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <fcntl.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <termios.h>
#include <unistd.h>
#include <utility>
#include <vector>

namespace godwit::link {
namespace {

/// What is not there is looked for so often.
constexpr rt::TimeNs kLookNs = rt::kNsPerSecond;

/// Closes what failed on the way; errno stays that of the failure.
const char* given_up(int fd, const char* failed) {
  const int why = errno;
  close(fd);
  errno = why;
  return failed;
}

/// Without a way to the other end, as before the network is up, it is gone.
class UdpPort final : public BytePort {
 public:
  UdpPort(const sockaddr_in& to, std::uint16_t local) : to_(to), local_(local) {}
  ~UdpPort() override {
    if (fd_ >= 0) close(fd_);
  }

  static std::string name() { return ""; }
  /// Null: it is open; else what failed, with errno. No allocation.
  const char* reopen() {
    const int fd = socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (fd < 0) return "socket";
    sockaddr_in from{};
    from.sin_family = AF_INET;
    from.sin_port = htons(local_);
    const char* failed = nullptr;
    if (local_ != 0 && bind(fd, reinterpret_cast<const sockaddr*>(&from), sizeof from) != 0) failed = "bind";
    if (failed == nullptr && connect(fd, reinterpret_cast<const sockaddr*>(&to_), sizeof to_) != 0) failed = "connect";
    if (failed != nullptr) return given_up(fd, failed);
    fd_ = fd;
    return nullptr;
  }

  bool send(std::span<const std::uint8_t> message, TxClass) override {
    return ::send(fd_, message.data(), message.size(), MSG_DONTWAIT) == static_cast<ssize_t>(message.size());
  }
  void flush() override {}  // a datagram is gone or refused at once
  std::size_t receive(std::span<std::uint8_t> into) override {
    const ssize_t n = recv(fd_, into.data(), into.size(), MSG_DONTWAIT);
    return n > 0 ? n : 0;
  }
  int descriptor() const override { return fd_; }
  void maintain(rt::TimeNs now_ns) override {
    if (fd_ >= 0 || now_ns < t_next_try_ns_) return;
    t_next_try_ns_ = now_ns + kLookNs;
    static_cast<void>(reopen() == nullptr);
  }
  bool gone() const override { return fd_ < 0; }

 private:
  const sockaddr_in to_;
  const std::uint16_t local_;
  int fd_ = -1;
  rt::TimeNs t_next_try_ns_ = 0;
};

/// A device that is unplugged or whose driver goes away answers with an end or an error for ever: it is closed, so that
/// nobody spins on it, and opened again when it is back.
class SerialPort final : public BytePort {
 public:
  SerialPort(std::string device, speed_t speed, double baud_rate)
      : device_(std::move(device)), speed_(speed), baud_rate_(baud_rate) {}
  ~SerialPort() override { leave(); }

  const std::string& name() const { return device_; }
  /// Null: it is open; else what failed, with errno. No allocation.
  const char* reopen() {
    const int fd = open(device_.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    if (fd < 0) return "";
    termios mode{};
    const char* failed = tcgetattr(fd, &mode) != 0 ? ": no serial port" : nullptr;
    if (failed == nullptr) {
      cfmakeraw(&mode);
      mode.c_cflag |= CLOCAL | CREAD;
      mode.c_cflag &= ~static_cast<tcflag_t>(CRTSCTS | CSTOPB);
      cfsetispeed(&mode, speed_);
      cfsetospeed(&mode, speed_);
      if (tcsetattr(fd, TCSANOW, &mode) != 0) failed = "";
    }
    if (failed != nullptr) return given_up(fd, failed);
    fd_ = fd;
    return nullptr;
  }

  bool send(std::span<const std::uint8_t> message, TxClass tx_class) override {
    if (fd_ < 0 || !queue_.push(message, tx_class)) return false;
    flush();
    return true;
  }
  void flush() override {
    for (std::size_t i = 0; fd_ >= 0 && i <= ByteQueue::kMessages; ++i) {
      const auto next = queue_.front();
      if (next.empty()) return;
      const ssize_t n = write(fd_, next.data(), next.size());
      if (n <= 0) {
        if (n == 0 || !passing(errno)) leave();
        return;
      }
      queue_.consume(n);
    }
  }
  std::size_t receive(std::span<std::uint8_t> into) override {
    if (fd_ < 0) return 0;
    const ssize_t n = read(fd_, into.data(), into.size());
    if (n > 0) return n;
    if (n == 0 || !passing(errno)) leave();
    return 0;
  }
  int descriptor() const override { return fd_; }
  void maintain(rt::TimeNs now_ns) override {
    if (fd_ >= 0 || now_ns < t_next_try_ns_) return;
    t_next_try_ns_ = now_ns + kLookNs;
    if (access(device_.c_str(), F_OK) == 0) static_cast<void>(reopen() == nullptr);
  }
  bool gone() const override { return fd_ < 0; }
  double baud_rate() const override { return baud_rate_; }

 private:
  static bool passing(int error) { return error == EAGAIN || error == EWOULDBLOCK || error == EINTR; }
  void leave() {
    if (fd_ >= 0) close(fd_);
    fd_ = -1;
    queue_ = ByteQueue();  // half a message is none, and what waited is old
  }

  const std::string device_;
  const speed_t speed_;
  const double baud_rate_;
  int fd_ = -1;
  rt::TimeNs t_next_try_ns_ = 0;
  ByteQueue queue_;
};

std::vector<std::string> split(const std::string& text) {
  std::vector<std::string> parts(1);
  for (const char c : text) {
    if (c == ':') {
      parts.emplace_back();
    } else {
      parts.back() += c;
    }
  }
  return parts;
}

bool number(const std::string& text, unsigned most, unsigned* out) {
  const auto [end, failure] = std::from_chars(text.data(), text.data() + text.size(), *out);
  return failure == std::errc() && end == text.data() + text.size() && *out > 0 && *out <= most;
}

constexpr std::array<std::pair<unsigned, speed_t>, 7> kBaudRates{{{57600, B57600},
                                                                  {115200, B115200},
                                                                  {230400, B230400},
                                                                  {460800, B460800},
                                                                  {500000, B500000},
                                                                  {921600, B921600},
                                                                  {1500000, B1500000}}};

struct Address {
  sockaddr_in to{};         ///< UDP: whom to send to; a port of 0: it is a serial line
  std::uint16_t local = 0;  ///< UDP: our own port, 0: any
  std::string device;       ///< serial
  speed_t baud_rate = B0;
  double baud = 0;
};

rt::Error wrong(const std::string& address, const std::string& why) {
  return rt::Error{"MAVLink port \"" + address + "\": " + why};
}

rt::Result<Address> parse(const std::string& address) {
  const std::vector<std::string> parts = split(address);
  Address out;
  if (parts[0] == "udp" && (parts.size() == 3 || parts.size() == 4)) {
    unsigned port = 0, local = 0;
    out.to.sin_family = AF_INET;
    if (inet_pton(AF_INET, parts[1].c_str(), &out.to.sin_addr) != 1) {
      return wrong(address, parts[1] + " is no IPv4 address");
    }
    if (!number(parts[2], 65535, &port)) return wrong(address, "the port must be 1 to 65535");
    if (parts.size() == 4 && !number(parts[3], 65535, &local)) {
      return wrong(address, "the local port must be 1 to 65535");
    }
    out.to.sin_port = htons(static_cast<std::uint16_t>(port));
    out.local = static_cast<std::uint16_t>(local);
    return out;
  }
  if (parts[0] == "serial" && parts.size() >= 3 && !parts[1].empty()) {
    unsigned baud = 0;
    const bool is_number = number(parts.back(), 10000000, &baud);
    const auto* rate =
        std::find_if(kBaudRates.begin(), kBaudRates.end(), [&](const auto& r) { return r.first == baud; });
    if (!is_number || rate == kBaudRates.end()) {
      return wrong(address, "the baud rate must be 57600, 115200, 230400, 460800, 500000, 921600 or 1500000");
    }
    // Names by path hold colons: /dev/serial/by-path/platform-3610000.usb-usb-0:2.1:1.0-port0
    const std::size_t begin = parts[0].size() + 1;
    out.device = address.substr(begin, address.size() - parts.back().size() - 1 - begin);
    out.baud_rate = rate->second;
    out.baud = baud;
    return out;
  }
  return wrong(address, "expected udp:HOST:PORT[:LOCALPORT] or serial:DEVICE:BAUD");
}

/// One that cannot be opened is gone where somebody waits for it, unless it is another kind of device, or the port's
/// number is taken.
template <typename Port>
rt::Result<std::unique_ptr<BytePort>> opened(const std::string& address, std::unique_ptr<Port> port, bool wait_for_it) {
  const char* const failed = port->reopen();
  const int why = errno;
  const bool never = why == ENOTTY || why == EADDRINUSE;
  if (failed != nullptr && (never || !wait_for_it)) {
    return wrong(address, port->name() + failed + ": " + std::strerror(why));
  }
  return std::unique_ptr<BytePort>(std::move(port));
}

}  // namespace

rt::Result<std::unique_ptr<BytePort>> open_byte_port(const std::string& address, bool wait_for_it) {
  const auto parsed = parse(address);
  if (!parsed.ok()) return parsed.error();
  const Address& a = parsed.value();
  if (a.to.sin_port != 0) return opened(address, std::make_unique<UdpPort>(a.to, a.local), wait_for_it);
  return opened(address, std::make_unique<SerialPort>(a.device, a.baud_rate, a.baud), wait_for_it);
}

rt::Result<void> check_byte_port_address(const std::string& address) {
  const auto parsed = parse(address);
  if (!parsed.ok()) return parsed.error();
  return {};
}

bool ByteQueue::push(std::span<const std::uint8_t> message, TxClass tx_class) {
  if (message.empty() || message.size() > kMessageBytes) return false;
  if (tx_class == TxClass::kPose) {
    for (std::size_t i = written_ > 0 ? 1 : 0; i < count_; ++i) {
      if (slots_[order_[i]].tx_class != TxClass::kPose) continue;
      free_ |= 1U << order_[i];
      std::copy(order_.begin() + static_cast<std::ptrdiff_t>(i) + 1,
                order_.begin() + static_cast<std::ptrdiff_t>(count_), order_.begin() + static_cast<std::ptrdiff_t>(i));
      --count_;
      ++poses_replaced_;
      break;  // at most one waits
    }
  }
  if (free_ == 0) return false;
  const auto index = static_cast<std::uint8_t>(std::countr_zero(free_));
  free_ &= ~(1U << index);
  Slot& slot = slots_[index];
  slot.tx_class = tx_class;
  slot.size = message.size();
  std::copy(message.begin(), message.end(), slot.bytes.begin());
  order_[count_++] = index;
  return true;
}

std::span<const std::uint8_t> ByteQueue::front() const {
  if (count_ == 0) return {};
  const Slot& slot = slots_[order_[0]];
  return {slot.bytes.data() + written_, slot.size - written_};
}

void ByteQueue::consume(std::size_t bytes) {
  if (count_ == 0) return;
  written_ += bytes;
  if (written_ < slots_[order_[0]].size) return;
  written_ = 0;
  free_ |= 1U << order_[0];
  std::copy(order_.begin() + 1, order_.begin() + static_cast<std::ptrdiff_t>(count_), order_.begin());
  --count_;
}

}  // namespace godwit::link
