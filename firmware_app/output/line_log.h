// Lines for people on the error stream, written by a thread of their own: whoever says one never waits for its reader.
//
// Not spdlog: where its queue is full it blocks, or drops the oldest line, in 1.10 as Debian 12 has it, and at the end
// it waits for the thread that writes, however long the reader of the stream does not read. Here somebody always waits:
// the end of a flight.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "hal/rt/time.h"

namespace godwit::app {

/// A stream that is full, slow, broken or gone costs lines and nothing else: they are counted, and the count is told
/// when lines can be written again. Never throws. The lines that wait, and the thread that writes them, outlive the log
/// where that thread hangs.
class LineLog {
 public:
  /// fd outlives the process or the last line. SIGPIPE must be ignored where it may be a pipe.
  explicit LineLog(int fd);
  ~LineLog();
  LineLog(const LineLog&) = delete;
  LineLog& operator=(const LineLog&) = delete;

  /// Any thread that may allocate and lock. `line` gets its newline here. Returns at once; where another thread stands
  /// in the middle of this log, after 0.1 s and without the line.
  void put(std::string line) noexcept;
  /// Waits until all lines are written, at most so long. False: some are not.
  bool flush(rt::TimeNs patience_ns) noexcept;
  /// Lines that were not written, for want of room or because the stream failed.
  std::uint64_t lost() const noexcept;

 private:
  struct State;
  std::shared_ptr<State> state_;
};

/// The process' error stream.
LineLog& error_log();

}  // namespace godwit::app
