#include "firmware_app/commands/page_server.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <netdb.h>
#include <netinet/in.h>
#include <poll.h>
#include <string_view>
#include <sys/socket.h>
#include <unistd.h>
#include <vector>

#include "hal/rt/time.h"

namespace godwit::app {
namespace {

constexpr std::size_t kLongestHead = 8192;
constexpr std::size_t kMostCalls = 32;  // at a time; further ones wait
constexpr rt::TimeNs kPatienceNs = 5 * rt::kNsPerSecond;
constexpr int kTurnMs = 100;
/// Nothing from anywhere but this server may be loaded by the page, nor run in it but what is in it.
constexpr const char* kSafety =
    "Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n"
    "Content-Security-Policy: default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\n";

const char* words_of(int status) {
  switch (status) {
    case 200:
      return "OK";
    case 400:
      return "Bad Request";
    case 403:
      return "Forbidden";
    case 404:
      return "Not Found";
    case 405:
      return "Method Not Allowed";
    case 431:
      return "Request Header Fields Too Large";
    default:
      return "Internal Server Error";
  }
}

PageRequest refused(int status, std::string because) {
  PageRequest out;
  out.refused = status;
  out.because = std::move(because);
  return out;
}

/// A name of this machine that no other can point here, with or without a port.
bool is_own_name(std::string_view host) {
  if (const std::size_t colon = host.rfind(':'); colon != std::string_view::npos && host.back() != ']') {
    if (host.find_first_not_of("0123456789", colon + 1) != std::string_view::npos) return false;
    host = host.substr(0, colon);
  }
  if (host == "localhost" || host == "[::1]") return true;
  return host.starts_with("127.") && host.find_first_not_of("0123456789.") == std::string_view::npos;
}

std::string_view trimmed(std::string_view s) {
  while (!s.empty() && (s.front() == ' ' || s.front() == '\t')) s.remove_prefix(1);
  while (!s.empty() && (s.back() == ' ' || s.back() == '\t')) s.remove_suffix(1);
  return s;
}

std::string lower(std::string_view s) {
  std::string out(s);
  for (char& c : out) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return out;
}

std::string reply_of(const PageAnswer& a, bool head) {
  std::string out = "HTTP/1.1 " + std::to_string(a.status) + " " + words_of(a.status) + "\r\nContent-Type: " + a.type +
                    "\r\nContent-Length: " + std::to_string(a.body.size()) + "\r\nConnection: close\r\n" + kSafety;
  if (a.status == 405) out += "Allow: GET, HEAD\r\n";
  out += "\r\n";
  if (!head) out += a.body;
  return out;
}

}  // namespace

PageRequest read_request(const std::string& text, bool local) {
  const std::string_view head = text;
  const std::size_t first_end = head.find("\r\n");
  const std::string_view first = head.substr(0, first_end);
  const std::size_t one = first.find(' ');
  const std::size_t two = one == std::string_view::npos ? one : first.find(' ', one + 1);
  if (two == std::string_view::npos || !first.substr(two + 1).starts_with("HTTP/1.")) {
    return refused(400, "that is no HTTP");
  }
  const std::string_view method = first.substr(0, one), target = first.substr(one + 1, two - one - 1);
  if (method != "GET" && method != "HEAD") return refused(405, "this page is for looking only");
  if (!target.starts_with('/')) return refused(400, "a path begins with /");
  bool named = false;
  for (std::size_t at = first_end; at != std::string_view::npos;) {
    const std::size_t begin = at + 2, end = head.find("\r\n", begin);
    const std::string_view line = head.substr(begin, end == std::string_view::npos ? end : end - begin);
    at = end;
    const std::size_t colon = line.find(':');
    if (colon == std::string_view::npos || lower(line.substr(0, colon)) != "host") continue;
    if (named) return refused(400, "one Host is enough");
    named = true;
    if (local && !is_own_name(lower(trimmed(line.substr(colon + 1))))) {
      return refused(403, "call it localhost: other names are answered only where --address is not of this machine");
    }
  }
  if (!named) return refused(400, "there is no Host");
  PageRequest out;
  out.head = method == "HEAD";
  out.path = target.substr(0, target.find('?'));
  return out;
}

struct PageServer::State {
  struct Call {
    int fd = -1;
    rt::TimeNs give_up_ns = 0;
    std::string asked, reply;
    std::size_t sent = 0;
    bool answering() const { return !reply.empty(); }
  };

  ~State() {
    for (const Call& call : calls) ::close(call.fd);
    if (listening >= 0) ::close(listening);
  }

  Answer answer;
  int listening = -1, port = 0;
  bool local = false;
  std::vector<Call> calls;

  void let_in();
  bool read(Call* call) const;
  void answer_call(Call* call) const;
  static bool write(Call* call);
};

void PageServer::State::let_in() {
  const int fd = ::accept4(listening, nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK);
  if (fd < 0) return;
  Call& call = calls.emplace_back();
  call.fd = fd;
  call.give_up_ns = rt::monotonic_now_ns() + kPatienceNs;
}

void PageServer::State::answer_call(Call* call) const {
  const PageRequest request = call->asked.size() > kLongestHead
                                  ? refused(431, "so long a request is none for this page")
                                  : read_request(call->asked.substr(0, call->asked.find("\r\n\r\n")), local);
  PageAnswer a{request.refused, "text/plain; charset=utf-8", request.because + "\n"};
  if (request.refused == 0) a = answer(request.path);
  call->reply = reply_of(a, request.head);
}

/// False: it has gone.
bool PageServer::State::read(Call* call) const {
  std::array<char, 4096> block;
  const ssize_t n = ::recv(call->fd, block.data(), block.size(), 0);
  if (n < 0) return errno == EINTR || errno == EAGAIN || errno == EWOULDBLOCK;
  if (n == 0) return false;
  call->asked.append(block.data(), n);
  if (call->asked.size() > kLongestHead || call->asked.find("\r\n\r\n") != std::string::npos) answer_call(call);
  return true;
}

/// False: all is told, or it has gone.
bool PageServer::State::write(Call* call) {
  while (call->sent < call->reply.size()) {
    const ssize_t n = ::send(call->fd, call->reply.data() + call->sent, call->reply.size() - call->sent, MSG_NOSIGNAL);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return errno == EAGAIN || errno == EWOULDBLOCK;
    call->sent += n;
    call->give_up_ns = rt::monotonic_now_ns() + kPatienceNs;
  }
  return false;
}

PageServer::PageServer(std::unique_ptr<State> state) : state_(std::move(state)) {}
PageServer::~PageServer() = default;

int PageServer::port() const {
  return state_->port;
}

bool PageServer::local() const {
  return state_->local;
}

rt::Result<std::unique_ptr<PageServer>> PageServer::open(const std::string& address, int port, Answer answer) {
  addrinfo hints{};
  hints.ai_socktype = SOCK_STREAM;
  hints.ai_flags = AI_NUMERICHOST | AI_PASSIVE;
  addrinfo* found = nullptr;
  if (::getaddrinfo(address.c_str(), std::to_string(port).c_str(), &hints, &found) != 0 || found == nullptr) {
    return rt::Error{"\"" + address + "\" is no address: numbers like 127.0.0.1 or ::1 are"};
  }
  const std::unique_ptr<addrinfo, void (*)(addrinfo*)> own(found, &::freeaddrinfo);
  auto state = std::make_unique<State>();
  state->answer = std::move(answer);
  state->listening = ::socket(found->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
  const int yes = 1;
  // A page that ended a moment ago does not keep the port.
  ::setsockopt(state->listening, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
  if (::bind(state->listening, found->ai_addr, found->ai_addrlen) != 0 || ::listen(state->listening, 64) != 0) {
    const std::string where = address + ", port " + std::to_string(port);
    if (errno == EADDRINUSE) return rt::Error{where + ": is taken; another one can be had with --port"};
    if (errno == EADDRNOTAVAIL) return rt::Error{where + ": is no address of this machine"};
    return rt::Error{where + ": cannot be listened on: " + std::strerror(errno)};
  }
  sockaddr_storage bound{};
  socklen_t size = sizeof bound;
  ::getsockname(state->listening, reinterpret_cast<sockaddr*>(&bound), &size);
  if (bound.ss_family == AF_INET) {
    const auto& four = reinterpret_cast<const sockaddr_in&>(bound);
    state->port = ntohs(four.sin_port);
    state->local = (ntohl(four.sin_addr.s_addr) >> 24U) == 127;
  } else {
    const auto& six = reinterpret_cast<const sockaddr_in6&>(bound);
    state->port = ntohs(six.sin6_port);
    state->local = IN6_IS_ADDR_LOOPBACK(&six.sin6_addr);
  }
  return std::unique_ptr<PageServer>(new PageServer(std::move(state)));
}

void PageServer::run(const std::atomic<bool>& stop) {
  std::vector<State::Call>& calls = state_->calls;
  std::vector<pollfd> waiting;
  while (!stop.load(std::memory_order_relaxed)) {
    const bool room = calls.size() < kMostCalls;
    waiting.assign(1, {room ? state_->listening : -1, POLLIN, 0});
    for (const State::Call& call : calls) {
      waiting.push_back({call.fd, static_cast<short>(call.answering() ? POLLOUT : POLLIN), 0});
    }
    if (::poll(waiting.data(), waiting.size(), kTurnMs) < 0) continue;
    const rt::TimeNs now_ns = rt::monotonic_now_ns();
    for (std::size_t i = 0; i < calls.size(); ++i) {
      State::Call& call = calls[i];
      bool stays = now_ns < call.give_up_ns;
      if (stays && waiting[i + 1].revents != 0) {
        if (!call.answering()) stays = state_->read(&call);
        if (stays && call.answering()) stays = State::write(&call);
      }
      if (stays) continue;
      ::close(call.fd);
      call.fd = -1;
    }
    std::erase_if(calls, [](const State::Call& c) { return c.fd < 0; });
    if (waiting[0].revents != 0) state_->let_in();
  }
}

}  // namespace godwit::app
