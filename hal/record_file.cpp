#include "hal/record_file.h"

#include <array>
#include <cerrno>
#include <charconv>
#include <cstdio>
#include <cstring>
#include <fcntl.h>
#include <memory>
#include <sys/stat.h>
#include <unistd.h>

namespace godwit::hal {
namespace {

/// Year 2255. Beyond it a rebased time could leave 64 bits.
constexpr rt::TimeNs kLatestNs = 9'000'000'000 * rt::kNsPerSecond;
/// More is no picture, list or configuration.
constexpr off_t kLargestFile = off_t{1} << 30;
constexpr std::string_view kBlanks = " \t\r\v\f";

std::string_view trim(std::string_view s) {
  const std::size_t begin = s.find_first_not_of(kBlanks);
  if (begin == std::string_view::npos) return {};
  return s.substr(begin, s.find_last_not_of(kBlanks) - begin + 1);
}

bool all_digits(std::string_view s) {
  return !s.empty() && s.find_first_not_of("0123456789") == std::string_view::npos;
}

}  // namespace

rt::Result<std::vector<std::uint8_t>> read_whole_file(const std::string& file) {
  // Without waiting: a FIFO without a writer would hold the program for ever, and a device has no end.
  const int fd = ::open(file.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC);
  if (fd < 0) return rt::Error{file + ": " + std::strerror(errno)};
  const auto close = [](std::FILE* f) { std::fclose(f); };
  const std::unique_ptr<std::FILE, decltype(close)> in(::fdopen(fd, "rb"), close);
  if (in == nullptr) {
    const std::string why = std::strerror(errno);
    ::close(fd);
    return rt::Error{file + ": " + why};
  }
  struct stat about {};
  if (::fstat(fd, &about) != 0) return rt::Error{file + ": " + std::strerror(errno)};
  if (S_ISDIR(about.st_mode)) return rt::Error{file + ": " + std::strerror(EISDIR)};
  if (!S_ISREG(about.st_mode)) return rt::Error{file + ": not a regular file"};
  if (about.st_size > kLargestFile) return rt::Error{file + ": larger than a gigabyte"};
  std::vector<std::uint8_t> bytes;
  std::array<std::uint8_t, 65536> block{};
  while (true) {
    errno = 0;
    const std::size_t n = std::fread(block.data(), 1, block.size(), in.get());
    bytes.insert(bytes.end(), block.begin(), block.begin() + static_cast<std::ptrdiff_t>(n));
    if (n == block.size()) continue;
    if (std::ferror(in.get()) != 0) return rt::Error{file + ": " + std::strerror(errno)};
    return bytes;
  }
}

rt::Result<std::string> read_text_file(const std::string& file) {
  auto bytes = read_whole_file(file);
  if (!bytes) return bytes.error();
  return std::string(bytes.value().begin(), bytes.value().end());
}

rt::Result<std::string> for_each_record(
    std::string_view text, const std::string& name,
    const std::function<std::string(std::string_view line, int number)>& read_line) {
  int number = 0;
  bool any = false;
  while (!text.empty()) {
    const std::size_t end = text.find('\n');
    const std::string_view line = trim(text.substr(0, end));
    const bool cut_off = end == std::string_view::npos;
    text.remove_prefix(cut_off ? text.size() : end + 1);
    ++number;
    if (line.empty() || line.front() == '#') continue;
    const std::string reason = read_line(line, number);
    const std::string words = std::string(name).append(":").append(std::to_string(number)).append(": ").append(reason);
    if (!reason.empty() && cut_off && any) return words + "; the file breaks off there, what comes before is used";
    if (!reason.empty()) return rt::Error{words};
    any = true;
  }
  return std::string();
}

std::string_view take_field(std::string_view* text, char separator) {
  const std::size_t end = separator == ' ' ? text->find_first_of(kBlanks) : text->find(separator);
  const std::string_view field = trim(text->substr(0, end));
  *text = end == std::string_view::npos ? std::string_view() : trim(text->substr(end + 1));
  return field;
}

bool parse_decimal_seconds(std::string_view text, rt::TimeNs* t_ns) {
  const std::size_t dot = text.find('.');
  const std::string_view whole = text.substr(0, dot);
  std::string_view decimals = dot == std::string_view::npos ? std::string_view("0") : text.substr(dot + 1);
  if (!all_digits(whole) || !all_digits(decimals)) return false;
  if (decimals.size() > 9) decimals = decimals.substr(0, 9);
  rt::TimeNs seconds = 0;
  if (std::from_chars(whole.data(), whole.data() + whole.size(), seconds).ec != std::errc()) return false;
  if (seconds >= kLatestNs / rt::kNsPerSecond) return false;
  rt::TimeNs fraction = 0;
  std::from_chars(decimals.data(), decimals.data() + decimals.size(), fraction);
  for (std::size_t i = decimals.size(); i < 9; ++i) fraction *= 10;
  *t_ns = seconds * rt::kNsPerSecond + fraction;
  return true;
}

bool parse_nanoseconds(std::string_view text, rt::TimeNs* t_ns) {
  return all_digits(text) && std::from_chars(text.data(), text.data() + text.size(), *t_ns).ec == std::errc() &&
         *t_ns < kLatestNs;
}

std::string format_seconds(rt::TimeNs t_ns) {
  char text[40];
  std::snprintf(text, sizeof(text), "%lld.%09lld", static_cast<long long>(t_ns / rt::kNsPerSecond),
                static_cast<long long>(t_ns % rt::kNsPerSecond));
  return text;
}

std::string quoted(std::string_view text) {
  std::string out = "'";
  for (const char c : text.substr(0, 40)) out += (c >= ' ' && c <= '~') ? c : '.';
  return out + (text.size() > 40 ? "...'" : "'");
}

}  // namespace godwit::hal
