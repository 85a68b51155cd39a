// A small read-only HTTP server for the page of `godwit view`: GET and HEAD, an answer, and the connection ends.
//
// Of our own, since Debian's cpp-httplib is a shared library only, with OpenSSL and Brotli behind it, and Ubuntu 20.04,
// for which the Jetson's package is made, has none.
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <string>

#include "hal/rt/result.h"

namespace godwit::app {

struct PageAnswer {
  int status = 200;
  std::string type;  ///< as Content-Type says it
  std::string body;
};

/// What a request's first lines ask for.
struct PageRequest {
  int refused = 0;      ///< the status to refuse it with; 0: it is one that is answered
  bool head = false;    ///< without the body
  std::string path;     ///< without what follows a '?'
  std::string because;  ///< words for the refusal
};

/// Of everything up to the empty line. local: the server listens on this machine alone, and only who calls it by a name
/// of this machine is answered: a page from elsewhere that has its own name point here gets nothing.
PageRequest read_request(const std::string& head, bool local);

class PageServer {
 public:
  /// Called by run()'s thread, which should not be kept.
  using Answer = std::function<PageAnswer(const std::string& path)>;

  /// address: as numbers, IPv4 or IPv6. port 0: any that is free. Error: what is wrong with them, or that the port is
  /// taken.
  static rt::Result<std::unique_ptr<PageServer>> open(const std::string& address, int port, Answer answer);
  ~PageServer();
  PageServer(const PageServer&) = delete;
  PageServer& operator=(const PageServer&) = delete;

  int port() const;
  /// Whether it listens on this machine alone.
  bool local() const;
  /// Answers until *stop. Nobody who is slow, silent or too long holds another up.
  void run(const std::atomic<bool>& stop);

 private:
  struct State;
  explicit PageServer(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

}  // namespace godwit::app
