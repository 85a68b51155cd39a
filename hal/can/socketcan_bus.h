// The kernel's SocketCAN, raw, classic and FD.
#pragma once

#include <array>
#include <linux/can.h>
#include <memory>
#include <string>
#include <vector>

#include "hal/can/can_link.h"
#include "hal/can/can_socket.h"

namespace godwit::hal {

class SocketCanBus final : public CanBus {
 public:
  /// Opens a CAN network interface; it must exist. Whether it is up is told by state() and advice().
  static rt::Result<std::unique_ptr<SocketCanBus>> open(const std::string& interface, bool wait_for_it = false);
  /// Speaks the kernel's frame format over a given datagram socket, which it then owns: for a bus that another process
  /// or a test plays. Such a bus is not opened again once it is gone.
  static std::unique_ptr<SocketCanBus> adopt(int descriptor);
  ~SocketCanBus() override;
  SocketCanBus(const SocketCanBus&) = delete;
  SocketCanBus& operator=(const SocketCanBus&) = delete;

  CanSend send(const CanFrame& frame) override;
  bool receive(CanFrame* frame) override;
  rt::Result<void> set_filters(std::span<const CanFilter> filters) override;
  void maintain(rt::TimeNs now_ns) override;
  CanState state() const override { return state_; }
  const CanCounters& counters() const override { return counters_; }
  int descriptor() const override { return fd_; }
  bool supports_fd() const override { return fd_frames_; }
  std::uint32_t bit_rate() const override { return bit_rate_; }
  const std::vector<std::string>& advice() const override { return advice_; }

 private:
  explicit SocketCanBus(std::string interface) : interface_(std::move(interface)) {}
  const char* connect();
  void disconnect();
  bool apply_filters();
  void take_error_frame(const canfd_frame& raw);

  std::string interface_;
  int fd_ = -1;
  std::unique_ptr<CanRestarter> restarter_;  ///< null: an adopted bus
  int interface_index_ = 0;
  bool fd_frames_ = false;
  bool reopen_ = true;
  std::uint32_t bit_rate_ = 0;
  CanState state_ = CanState::kGone;
  rt::TimeNs next_attempt_ns_ = 0;
  CanCounters counters_;
  CanFilterList filters_;
  std::vector<std::string> advice_;
};

/// The state an error frame tells, given the state before (linux/can/error.h).
CanState state_after_error_frame(CanState before, const canfd_frame& raw);

}  // namespace godwit::hal
