// What godwitd tells whoever looks at it: the state of the flight as one line of JSON.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <functional>
#include <mutex>
#include <string>

#include "firmware_app/output/event_line.h"
#include "firmware_app/pipeline/frame_record.h"
#include "hal/machine/machine_state.h"
#include "hal/rt/log_ring.h"

namespace godwit::app {

/// frame() and event() are the collector's; snapshot() any other thread's. Of fixed size but for the last lines.
class LiveStatus {
 public:
  struct Sources {
    std::string version;
    std::function<int()> quality;  ///< as the autopilot was told last; empty: there is no link
    const hal::MachineMonitor* machine = nullptr;
  };
  explicit LiveStatus(Sources sources) : sources_(std::move(sources)), t_begin_ns_(rt::monotonic_now_ns()) {}

  void frame(const FrameRecord& record) noexcept;
  /// line: as the journal has it.
  void event(const rt::LogEntry& entry, const std::string& line) noexcept;

  /// {"version":..,"uptime_s":..,"state":..,..}, a line without its end. What is not known is null. docs/live.md names
  /// the fields.
  std::string snapshot(rt::TimeNs now_ns);

 private:
  /// Over so long rates and latencies are told.
  static constexpr rt::TimeNs kWindowNs = 2 * rt::kNsPerSecond;
  static constexpr std::size_t kFrames = 512;  ///< of the window at most
  static constexpr std::size_t kLines = 12;

  struct Frame {
    rt::TimeNs t_ns = 0;  ///< when it was heard of
    bool processed = false, tracked = false, late = false;
    float age_ms = 0, own_ms = 0, tracking_ms = 0;
  };

  Sources sources_;
  const rt::TimeNs t_begin_ns_;
  mutable std::mutex mutex_;
  std::array<Frame, kFrames> frames_{};
  std::uint64_t seen_ = 0, tracked_ = 0, not_flown_ = 0;
  FrameRecord last_;       ///< that went through the tracker
  bool any_ = false;       ///< last_ is one
  MappingRecord mapping_;  ///< the last that told something
  const char* rung_ = "full";
  std::deque<std::string> lines_;
  std::uint64_t line_count_ = 0;  ///< since the start
  rt::TimeNs t_machine_ns_ = 0;   ///< the snapshot's alone, as the next
  hal::MachineState machine_;
};

}  // namespace godwit::app
