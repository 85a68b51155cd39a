// The local socket on which godwitd tells what it does: a line of JSON (output/live_status.h) a few times a second, and
// who asks for it with "view" gets lines of pictures and of the track as well.
#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <string>

#include "hal/rt/result.h"
#include "hal/rt/time.h"

namespace godwit::app {

/// Where the service has its socket (RuntimeDirectory= in systemd/godwitd.service.in).
constexpr const char* kServiceSocket = "/run/godwit/live";

/// What a reader sends who wants to see pictures and track, too.
constexpr const char* kAskView = "view\n";

struct LiveServerOptions {
  std::string socket;                 ///< its folder must be there
  std::function<std::string()> line;  ///< the server's thread calls it only while somebody reads
  /// May be empty. Appends further lines, whole ones with their ends, for those who asked for them; the server's thread
  /// calls it only while one of them reads.
  std::function<void(std::string*)> view;
  rt::TimeNs interval_ns = rt::kNsPerSecond / 5;
  std::size_t readers = 8;  ///< a further one is told so and let go
  /// Called by the destructor where the thread does not end within a second; must not return. Null: it is waited for.
  std::function<void(const char* thread)> abandon;
};

/// A thread of its own serves; it sleeps while nobody reads, and waits for no reader: who is not quick enough misses
/// lines, and who takes none for five seconds is let go. Readers are those who may write to the socket: its owner and
/// his group. All that they can say is kAskView.
class LiveServer {
 public:
  /// A socket that nobody serves any more is replaced. Error: another program serves it, what lies there is no socket,
  /// or it cannot be made.
  static rt::Result<std::unique_ptr<LiveServer>> start(LiveServerOptions options);
  /// Ends the thread and removes the socket.
  ~LiveServer();
  LiveServer(const LiveServer&) = delete;
  LiveServer& operator=(const LiveServer&) = delete;

 private:
  struct State;
  explicit LiveServer(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

/// A reader's end. Error: in words whether nobody is there, or may not be asked.
rt::Result<int> connect_live(const std::string& socket);

}  // namespace godwit::app
