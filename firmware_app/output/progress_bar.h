// How far a run is, on a terminal.
#pragma once

#include <cstdint>

#include "hal/rt/time.h"

namespace godwit::app {

/// Draws to the error stream, at most ten times a second, and only if that is a terminal. One thread.
class ProgressBar {
 public:
  explicit ProgressBar(std::int64_t total);
  /// Wipes the bar away.
  ~ProgressBar();
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;

  /// done of total frames; state of the newest.
  void show(std::int64_t done, const char* state);
  /// Makes room for a line of text on the error stream; the bar comes back with the next show().
  void make_way();

 private:
  const std::int64_t total_;
  const bool terminal_;
  rt::TimeNs last_ns_ = 0;
};

}  // namespace godwit::app
