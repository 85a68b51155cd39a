#include "firmware_app/output/live_server.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>
#include <vector>

#include "hal/rt/process_end.h"
#include "hal/rt/thread.h"

namespace godwit::app {
namespace {

constexpr rt::TimeNs kPatienceNs = 5 * rt::kNsPerSecond;
constexpr rt::TimeNs kEndNs = rt::kNsPerSecond;
constexpr int kWaiting = 8;
/// Larger than a line of the state, so that a reader who is a moment late loses none.
constexpr int kBufferBytes = 64 * 1024;
/// All that a reader may say at a time.
constexpr std::size_t kLongestAsked = 64;

rt::Error error_of(const std::string& socket, const char* doing) {
  return {socket + ": " + doing + ": " + std::strerror(errno)};
}

/// Nothing: the path is too long.
bool address_of(const std::string& socket, sockaddr_un* address) {
  *address = {};
  address->sun_family = AF_UNIX;
  if (socket.empty() || socket.size() >= sizeof address->sun_path) return false;
  std::memcpy(address->sun_path, socket.c_str(), socket.size() + 1);
  return true;
}

/// Does not wait. Below zero: *why is errno; ECONNREFUSED: nobody serves it, EAGAIN: too many wait for whoever does.
int try_connect(const std::string& socket, int* why) {
  sockaddr_un address{};
  *why = ENAMETOOLONG;
  if (!address_of(socket, &address)) return -1;
  const int fd = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  if (fd >= 0 && ::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0) return fd;
  *why = errno;
  if (fd >= 0) ::close(fd);
  return -1;
}

/// Makes the place free where a program that has died left its socket.
rt::Result<void> clear(const std::string& socket) {
  struct stat about {};
  if (::lstat(socket.c_str(), &about) != 0) return {};
  if (!S_ISSOCK(about.st_mode)) return rt::Error{socket + ": is there, and no socket"};
  int why = 0;
  const int other = try_connect(socket, &why);
  if (other >= 0) ::close(other);
  // One that hangs takes nobody any more, and it is still its socket.
  if (other >= 0 || why != ECONNREFUSED) return rt::Error{socket + ": another program serves it"};
  if (::unlink(socket.c_str()) != 0) return error_of(socket, "cannot be removed");
  return {};
}

}  // namespace

struct LiveServer::State {
  struct Reader {
    int fd = -1;
    rt::TimeNs t_taken_ns = 0;  // when it last took something
    std::string lines;          // what is told to it
    std::size_t sent = 0;       // of these
    std::string asked;          // a word that has not ended
    bool views = false;         // asked for pictures
    bool silent = false;        // says nothing any more
    bool behind() const { return sent < lines.size(); }
  };

  explicit State(LiveServerOptions o) : options(std::move(o)) {}
  ~State() {
    for (const Reader& reader : readers) ::close(reader.fd);
    if (listening >= 0) ::close(listening);
    if (end_fd >= 0) ::close(end_fd);
  }

  const LiveServerOptions options;
  int listening = -1, end_fd = -1;
  std::vector<Reader> readers;
  std::vector<pollfd> waiting;
  std::string line, views;  // of this turn; they keep their room
  rt::Thread thread;

  void run();
  bool await(rt::TimeNs t_next_ns);
  void let_in();
  void tell(rt::TimeNs now_ns);
  void attend(short happened, Reader* reader, rt::TimeNs now_ns) const;
  static bool hear(Reader* reader);
  static bool send_rest(Reader* reader, rt::TimeNs now_ns);
  static void let_go(Reader* reader) {
    ::close(reader->fd);
    reader->fd = -1;
  }
};

/// False: it has gone, or takes nothing.
bool LiveServer::State::send_rest(Reader* reader, rt::TimeNs now_ns) {
  while (reader->behind()) {
    const ssize_t n = ::send(reader->fd, reader->lines.data() + reader->sent, reader->lines.size() - reader->sent,
                             MSG_DONTWAIT | MSG_NOSIGNAL);
    if (n < 0 && errno == EINTR) continue;
    if (n <= 0) return n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK) && now_ns - reader->t_taken_ns < kPatienceNs;
    reader->sent += n;
    reader->t_taken_ns = now_ns;
  }
  return true;
}

/// False: it has gone.
bool LiveServer::State::hear(Reader* reader) {
  std::array<char, kLongestAsked> said;
  const ssize_t n = ::recv(reader->fd, said.data(), said.size(), MSG_DONTWAIT);
  if (n < 0) return errno == EINTR || errno == EAGAIN || errno == EWOULDBLOCK;
  if (n == 0) reader->silent = true;  // and may read on
  reader->asked.append(said.data(), n);
  if (reader->asked.find(kAskView) != std::string::npos) reader->views = true;
  const std::size_t end = reader->asked.rfind('\n');
  reader->asked.erase(0, end == std::string::npos ? 0 : end + 1);
  if (reader->asked.size() > kLongestAsked) reader->asked.clear();
  return true;
}

void LiveServer::State::attend(short happened, Reader* reader, rt::TimeNs now_ns) const {
  const bool gone = (happened & (POLLHUP | POLLERR)) != 0;
  if (gone || ((happened & POLLIN) != 0 && !hear(reader)) ||
      ((happened & POLLOUT) != 0 && !send_rest(reader, now_ns))) {
    let_go(reader);
  }
}

void LiveServer::State::let_in() {
  const int fd = ::accept4(listening, nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK);
  if (fd < 0) return;
  if (readers.size() >= options.readers) {
    const std::string full = "{\"error\":\"" + std::to_string(readers.size()) + " others read already\"}\n";
    (void)!::send(fd, full.data(), full.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
    ::close(fd);
    return;
  }
  ::setsockopt(fd, SOL_SOCKET, SO_SNDBUF, &kBufferBytes, sizeof kBufferBytes);
  Reader& reader = readers.emplace_back();
  reader.fd = fd;
  reader.t_taken_ns = rt::monotonic_now_ns();
}

void LiveServer::State::tell(rt::TimeNs now_ns) {
  line = options.line();
  line += '\n';
  views.clear();
  // Who is still at the last pictures misses these: they are not even put together for him alone.
  const auto sees = [](const Reader& r) { return r.views && !r.behind(); };
  if (options.view && std::any_of(readers.begin(), readers.end(), sees)) options.view(&views);
  for (Reader& reader : readers) {
    if (!reader.behind()) {
      reader.lines.assign(line);
      if (reader.views) reader.lines.append(views);
      reader.sent = 0;
    }
    if (!send_rest(&reader, now_ns)) let_go(&reader);
  }
}

/// False: there is no waiting any more.
bool LiveServer::State::await(rt::TimeNs t_next_ns) {
  waiting.assign({{listening, POLLIN, 0}, {end_fd, POLLIN, 0}});
  for (const Reader& reader : readers) {
    const int events = (reader.silent ? 0 : POLLIN) | (reader.behind() ? POLLOUT : 0);
    waiting.push_back({reader.fd, static_cast<short>(events), 0});
  }
  int timeout_ms = -1;
  if (!readers.empty()) {
    timeout_ms = static_cast<int>(std::max<rt::TimeNs>(0, t_next_ns - rt::monotonic_now_ns()) / rt::kNsPerMs) + 1;
  }
  if (::poll(waiting.data(), waiting.size(), timeout_ms) >= 0) return true;
  for (pollfd& one : waiting) one.revents = 0;
  return errno == EINTR;
}

void LiveServer::State::run() {
  rt::TimeNs t_next_ns = 0;
  while (true) {
    if (!await(t_next_ns) || waiting[1].revents != 0) return;
    rt::TimeNs now_ns = rt::monotonic_now_ns();
    for (std::size_t i = 0; i < readers.size(); ++i) attend(waiting[i + 2].revents, &readers[i], now_ns);
    std::erase_if(readers, [](const Reader& r) { return r.fd < 0; });
    const bool came = waiting[0].revents != 0;
    if (came) let_in();
    now_ns = rt::monotonic_now_ns();
    if (readers.empty() || (!came && now_ns < t_next_ns)) continue;
    tell(now_ns);
    std::erase_if(readers, [](const Reader& r) { return r.fd < 0; });
    t_next_ns = now_ns + options.interval_ns;
  }
}

LiveServer::LiveServer(std::unique_ptr<State> state) : state_(std::move(state)) {}

rt::Result<std::unique_ptr<LiveServer>> LiveServer::start(LiveServerOptions options) {
  auto state = std::make_unique<State>(std::move(options));
  const std::string& socket = state->options.socket;
  sockaddr_un address{};
  if (!address_of(socket, &address)) return rt::Error{"\"" + socket + "\" is no name for a socket: 1 to 107 bytes are"};
  if (auto r = clear(socket); !r) return r.error();
  state->listening = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  state->end_fd = ::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  if (state->listening < 0 || state->end_fd < 0) return error_of(socket, "cannot be made");
  // The group may connect, which takes the right to write.
  ::fchmod(state->listening, 0660);
  if (::bind(state->listening, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
      ::chmod(socket.c_str(), 0660) != 0 || ::listen(state->listening, kWaiting) != 0) {
    return error_of(socket, "cannot be made");
  }
  State* const s = state.get();
  if (auto r = s->thread.start("gw-live", {}, [s] { s->run(); }); !r) return r.error();
  return std::unique_ptr<LiveServer>(new LiveServer(std::move(state)));
}

LiveServer::~LiveServer() {
  const std::uint64_t one = 1;
  (void)!::write(state_->end_fd, &one, sizeof one);
  rt::join_in_time(&state_->thread, kEndNs, state_->options.abandon);
  ::unlink(state_->options.socket.c_str());
}

rt::Result<int> connect_live(const std::string& socket) {
  int why = 0;
  const int fd = try_connect(socket, &why);
  if (fd >= 0) return fd;
  if (why == ENAMETOOLONG) return rt::Error{"\"" + socket + "\" is no name for a socket: 1 to 107 bytes are"};
  if (why == ENOENT || why == ECONNREFUSED) return rt::Error{socket + ": no godwitd serves it"};
  if (why == EAGAIN) return rt::Error{socket + ": a godwitd serves it, and takes nobody: it hangs"};
  errno = why;
  return error_of(socket, "cannot be read");
}

}  // namespace godwit::app
