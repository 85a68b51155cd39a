// A CAN bus over UDP multicast, as ArduPilot's simulator and pydronecan's mcast driver speak it: one frame a datagram
// to 239.65.82.N, port 57732; little-endian u16 magic 0x2934, u16 CRC over all behind it, u16 flags (bit 0: FD), u32 id
// (bit 31: extended), data.
#pragma once

#include <array>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "hal/can/can_socket.h"

namespace godwit::hal {

constexpr std::size_t kMulticastHeaderBytes = 10;
using MulticastDatagram = std::array<std::uint8_t, kMulticastHeaderBytes + kFdCanBytes>;

/// Writes the datagram of a frame; returns its length.
std::size_t encode_datagram(const CanFrame& frame, MulticastDatagram* out);
/// Reads a datagram; false where magic, CRC or length say that it is none.
bool decode_datagram(std::span<const std::uint8_t> datagram, CanFrame* frame);

class MulticastBus final : public CanBus {
 public:
  /// bus 0 to 9; interface_address: IPv4 address of the network interface, empty for the one the routes choose.
  static rt::Result<std::unique_ptr<MulticastBus>> open(int bus, const std::string& interface_address);
  ~MulticastBus() override;
  MulticastBus(const MulticastBus&) = delete;
  MulticastBus& operator=(const MulticastBus&) = delete;

  CanSend send(const CanFrame& frame) override;
  bool receive(CanFrame* frame) override;
  rt::Result<void> set_filters(std::span<const CanFilter> filters) override;
  void maintain(rt::TimeNs now_ns) override;
  CanState state() const override { return state_; }
  const CanCounters& counters() const override { return counters_; }
  int descriptor() const override { return receive_fd_; }
  bool supports_fd() const override { return true; }
  std::uint32_t bit_rate() const override { return 0; }
  const std::vector<std::string>& advice() const override { return advice_; }

 private:
  MulticastBus(int bus, std::uint32_t interface_address) : bus_(bus), interface_address_(interface_address) {}
  /// Null where it worked, else the name of the call that failed (errno says why).
  const char* connect();
  void disconnect();

  int bus_;
  std::uint32_t interface_address_;  // network byte order, 0: by the routes
  int send_fd_ = -1;
  int receive_fd_ = -1;
  std::uint16_t own_port_ = 0;  // network byte order
  CanState state_ = CanState::kGone;
  rt::TimeNs next_attempt_ns_ = 0;
  CanCounters counters_;
  CanFilterList filters_;
  std::vector<std::string> advice_;
};

}  // namespace godwit::hal
