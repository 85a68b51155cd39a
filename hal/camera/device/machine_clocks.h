// The machine's clocks as a camera needs them, so that tests can play them.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "hal/rt/time.h"

namespace godwit::hal {

/// How other clocks stand to CLOCK_MONOTONIC: what to add to their times. 0: the same, or unknown.
struct ClockOffsets {
  rt::TimeNs boottime_ns = 0;
  rt::TimeNs realtime_ns = 0;
  std::optional<rt::TimeNs> counter_ns;  ///< between it and Tegra's TSC, as L4T's clocksource0/offset_ns has it
};

class MachineClocks {
 public:
  virtual ~MachineClocks() = default;
  /// CLOCK_MONOTONIC. No allocation.
  virtual rt::TimeNs now_ns() = 0;
  /// All of them. Reads a file: blocks.
  virtual ClockOffsets clock_offsets() = 0;
  /// BOOTTIME and REALTIME alone. No allocation, no file; does not block.
  virtual void read_clocks(ClockOffsets* offsets) = 0;
};

/// The kernel's. sys: where sysfs is mounted.
std::unique_ptr<MachineClocks> linux_clocks(const std::string& sys = "/sys");

}  // namespace godwit::hal
