#include "firmware_app/output/progress_bar.h"

#include <cstdio>
#include <string>
#include <unistd.h>

namespace godwit::app {
namespace {
constexpr std::int64_t kWidth = 40;
}

ProgressBar::ProgressBar(std::int64_t total) : total_(total), terminal_(isatty(STDERR_FILENO) == 1) {}

ProgressBar::~ProgressBar() {
  make_way();
}

void ProgressBar::make_way() {
  if (terminal_ && last_ns_ != 0) std::fputs("\r\033[K", stderr);
}

void ProgressBar::show(std::int64_t done, const char* state) {
  if (!terminal_ || total_ <= 0) return;
  const rt::TimeNs now = rt::monotonic_now_ns();
  if (now - last_ns_ < 100 * rt::kNsPerMs && done < total_) return;
  last_ns_ = now;
  const std::size_t filled = kWidth * done / total_;
  const std::string bar = std::string(filled, '#') + std::string(kWidth - filled, '.');
  std::fprintf(stderr, "\r[%s] %lld/%lld %-14s", bar.c_str(), static_cast<long long>(done),
               static_cast<long long>(total_), state);
  std::fflush(stderr);
}

}  // namespace godwit::app
