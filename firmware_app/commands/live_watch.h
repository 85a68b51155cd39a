// What `godwit view` knows of a godwitd: the newest that its socket told, as long as somebody looks at the page.
#pragma once

#include <memory>
#include <string>

namespace godwit::app {

/// A thread reads the socket while somebody asks, and for five seconds after; else godwitd has no reader here. Where
/// nobody serves the socket, or no longer, it is tried again each half second.
class LiveWatch {
 public:
  explicit LiveWatch(std::string socket);
  ~LiveWatch();
  LiveWatch(const LiveWatch&) = delete;
  LiveWatch& operator=(const LiveWatch&) = delete;

  /// Each is one line of JSON, and {"error":".."} while there is nothing to tell. Any thread.
  /// State and figures, as godwitd told them.
  std::string status();
  /// The last picture, as docs/live.md says: a JPEG in place of its pixels.
  std::string picture();
  std::string track();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// The line of a picture with its pixels as JPEG; empty: it is none.
std::string with_jpeg(const std::string& line);

}  // namespace godwit::app
