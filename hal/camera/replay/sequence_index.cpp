#include "hal/camera/replay/sequence_index.h"

#include <charconv>
#include <cstdio>

namespace godwit::hal {
namespace {

/// Year 2255. Beyond it a rebased time could leave 64 bits.
constexpr rt::TimeNs kLatestNs = 9'000'000'000 * rt::kNsPerSecond;
constexpr std::string_view kBlanks = " \t\r\v\f";

std::string_view trim(std::string_view s) {
  const std::size_t begin = s.find_first_not_of(kBlanks);
  if (begin == std::string_view::npos) return {};
  return s.substr(begin, s.find_last_not_of(kBlanks) - begin + 1);
}

/// For error messages: what stands there, short and printable.
std::string quoted(std::string_view s) {
  std::string out = "'";
  for (const char c : s.substr(0, 40)) out += (c >= ' ' && c <= '~') ? c : '.';
  return out + (s.size() > 40 ? "...'" : "'");
}

rt::Error at_line(const std::string& name, int line, const std::string& reason) {
  return {name + ":" + std::to_string(line) + ": " + reason};
}

bool all_digits(std::string_view s) {
  return !s.empty() && s.find_first_not_of("0123456789") == std::string_view::npos;
}

template <typename SplitTime>
rt::Result<SequenceIndex> parse(std::string_view text, const std::string& name, SplitTime&& read_line) {
  SequenceIndex index;
  rt::TimeNs newest = -1;
  int line_number = 0;
  while (!text.empty()) {
    const std::size_t end = text.find('\n');
    const std::string_view line = trim(text.substr(0, end));
    text.remove_prefix(end == std::string_view::npos ? text.size() : end + 1);
    ++line_number;
    if (line.empty() || line.front() == '#') continue;
    SequenceEntry entry;
    entry.line = line_number;
    std::string_view file;
    std::string reason = read_line(line, &entry.t_ns, &file);
    if (reason.empty() && file.empty()) reason = "no file name behind the time";
    if (reason.empty() && file.find('\0') != std::string_view::npos) reason = "a zero byte in the file name";
    if (!reason.empty()) return at_line(name, line_number, reason);
    entry.file = std::string(file);
    if (entry.t_ns == newest) entry.fault = TimeFault::kRepeats;
    if (entry.t_ns < newest) entry.fault = TimeFault::kGoesBack;
    if (entry.t_ns > newest) newest = entry.t_ns;
    index.entries.push_back(std::move(entry));
  }
  if (index.entries.empty()) return rt::Error{name + ": lists no pictures"};
  return index;
}

}  // namespace

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

std::string format_seconds(rt::TimeNs t_ns) {
  char text[40];
  std::snprintf(text, sizeof(text), "%lld.%09lld", static_cast<long long>(t_ns / rt::kNsPerSecond),
                static_cast<long long>(t_ns % rt::kNsPerSecond));
  return text;
}

rt::Result<SequenceIndex> parse_tum_index(std::string_view text, const std::string& name) {
  return parse(text, name, [](std::string_view line, rt::TimeNs* t_ns, std::string_view* file) -> std::string {
    const std::size_t gap = line.find_first_of(kBlanks);
    const std::string_view time = line.substr(0, gap);
    if (!parse_decimal_seconds(time, t_ns)) return quoted(time) + " is not a time in decimal seconds";
    *file = gap == std::string_view::npos ? std::string_view() : trim(line.substr(gap));
    return {};
  });
}

rt::Result<SequenceIndex> parse_euroc_index(std::string_view text, const std::string& name) {
  return parse(text, name, [](std::string_view line, rt::TimeNs* t_ns, std::string_view* file) -> std::string {
    const std::size_t comma = line.find(',');
    const std::string_view time = trim(line.substr(0, comma));
    const bool whole = all_digits(time);
    if (!whole || std::from_chars(time.data(), time.data() + time.size(), *t_ns).ec != std::errc() ||
        *t_ns >= kLatestNs) {
      return quoted(time) + " is not a time in whole nanoseconds";
    }
    *file = comma == std::string_view::npos ? std::string_view() : trim(line.substr(comma + 1));
    return {};
  });
}

}  // namespace godwit::hal
