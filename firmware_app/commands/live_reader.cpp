#include "firmware_app/commands/live_reader.h"

#include <cerrno>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>
#include <vector>

#include "hal/rt/time.h"

namespace godwit::app {
namespace {

/// godwitd tells something five times a second; who is silent for so long hangs.
constexpr rt::TimeNs kSilentNs = 5 * rt::kNsPerSecond;
/// More than a picture.
constexpr std::size_t kLongestLine = 1 << 20;
constexpr std::size_t kBlock = 1 << 16;

}  // namespace

LiveReader::~LiveReader() {
  close(fd_);
}

rt::Result<std::string> LiveReader::next(const std::atomic<bool>& stop) {
  const rt::TimeNs give_up_ns = rt::monotonic_now_ns() + kSilentNs;
  std::vector<char> block(whole() ? 0 : kBlock);
  while (!stop.load(std::memory_order_relaxed)) {
    if (whole()) {
      std::string line = text_.substr(0, end_);
      text_.erase(0, end_ + 1);
      end_ = text_.find('\n');
      return line;
    }
    if (text_.size() > kLongestLine) return rt::Error{"a line without end: that is no godwitd"};
    if (rt::monotonic_now_ns() > give_up_ns) return rt::Error{"godwitd is silent"};
    pollfd waiting{fd_, POLLIN, 0};
    if (poll(&waiting, 1, 100) <= 0) continue;
    const ssize_t n = recv(fd_, block.data(), block.size(), 0);
    if (n < 0 && (errno == EINTR || errno == EAGAIN)) continue;
    if (n <= 0) return rt::Error{"godwitd has ended"};
    const std::size_t before = text_.size();
    text_.append(block.data(), n);
    end_ = text_.find('\n', before);
  }
  return std::string();
}

rt::Result<std::string> LiveReader::newest(const std::atomic<bool>& stop) {
  auto line = next(stop);
  while (line.ok() && whole()) line = next(stop);
  return line;
}

}  // namespace godwit::app
