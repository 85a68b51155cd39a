// A reader's end of the socket that godwitd serves (output/live_server.h), line by line.
#pragma once

#include <atomic>
#include <cstddef>
#include <string>

#include "hal/rt/result.h"

namespace godwit::app {

/// One thread.
class LiveReader {
 public:
  /// fd: of connect_live(); closed at the end.
  explicit LiveReader(int fd) : fd_(fd) {}
  ~LiveReader();
  LiveReader(const LiveReader&) = delete;
  LiveReader& operator=(const LiveReader&) = delete;

  /// The next line without its end; empty: *stop. Error: godwitd ended, is silent for five seconds, or tells no lines.
  rt::Result<std::string> next(const std::atomic<bool>& stop);
  /// The newest of those that have come; waits for one. The same errors.
  rt::Result<std::string> newest(const std::atomic<bool>& stop);

 private:
  bool whole() const { return end_ != std::string::npos; }

  const int fd_;
  std::string text_;
  std::size_t end_ = std::string::npos;  ///< of the first line in text_; npos: it has not come
};

}  // namespace godwit::app
