// A bus on which the test puts frames; what is sent goes nowhere.
#pragma once

#include <string>
#include <vector>

#include "hal/can/can_bus.h"

namespace godwit {

class StrangeBus final : public hal::CanBus {
 public:
  hal::CanSend send(const hal::CanFrame&) override { return hal::CanSend::kSent; }
  bool receive(hal::CanFrame* frame) override {
    if (next == frames.size()) return false;
    *frame = frames[next++];
    return true;
  }
  rt::Result<void> set_filters(std::span<const hal::CanFilter>) override { return {}; }
  void maintain(rt::TimeNs) override {}
  hal::CanState state() const override { return hal::CanState::kActive; }
  const hal::CanCounters& counters() const override { return counts; }
  int descriptor() const override { return -1; }
  bool supports_fd() const override { return fd; }
  std::uint32_t bit_rate() const override { return 0; }
  const std::vector<std::string>& advice() const override { return none; }

  std::vector<hal::CanFrame> frames;
  std::size_t next = 0;
  bool fd = true;
  hal::CanCounters counts;
  std::vector<std::string> none;
};

}  // namespace godwit
