#include "hal/camera/replay/sequence_index.h"

#include <utility>

namespace godwit::hal {
namespace {

/// read_time: what is wrong with the time; the rest of the line is the file's name.
template <typename ReadTime>
rt::Result<SequenceIndex> parse(std::string_view text, const std::string& name, char separator, ReadTime&& read_time) {
  SequenceIndex index;
  rt::TimeNs newest = -1;
  const auto read = for_each_record(text, name, [&](std::string_view file, int number) -> std::string {
    SequenceEntry entry;
    entry.line = number;
    std::string reason = read_time(take_field(&file, separator), &entry.t_ns);
    if (!reason.empty()) return reason;
    if (file.empty()) return "no file name behind the time";
    if (file.find('\0') != std::string_view::npos) return "a zero byte in the file name";
    entry.file = std::string(file);
    if (entry.t_ns == newest) entry.fault = TimeFault::kRepeats;
    if (entry.t_ns < newest) entry.fault = TimeFault::kGoesBack;
    if (entry.t_ns > newest) newest = entry.t_ns;
    index.entries.push_back(std::move(entry));
    return {};
  });
  if (!read) return read.error();
  index.cut_off = read.value();
  if (index.entries.empty()) return rt::Error{name + ": lists no pictures"};
  return index;
}

}  // namespace

rt::Result<SequenceIndex> parse_tum_index(std::string_view text, const std::string& name) {
  return parse(text, name, ' ', [](std::string_view time, rt::TimeNs* t_ns) -> std::string {
    if (parse_decimal_seconds(time, t_ns)) return {};
    return quoted(time) + " is not a time in decimal seconds";
  });
}

rt::Result<SequenceIndex> parse_euroc_index(std::string_view text, const std::string& name) {
  return parse(text, name, ',', [](std::string_view time, rt::TimeNs* t_ns) -> std::string {
    if (parse_nanoseconds(time, t_ns)) return {};
    return quoted(time) + " is not a time in whole nanoseconds";
  });
}

}  // namespace godwit::hal
