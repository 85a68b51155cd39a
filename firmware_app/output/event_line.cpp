#include "firmware_app/output/event_line.h"

#include <fmt/format.h>
#include <string_view>

namespace godwit::app {

std::string event_line(const rt::LogEntry& e, rt::TimeNs t_first_ns) {
  std::string out = fmt::format("t={:.2f} s", rt::to_seconds(e.t_ns - t_first_ns));
  // States speak for themselves.
  if (std::string_view(e.what) != "state") out += fmt::format(" {}", e.what);
  if (e.before[0] != '\0') out += fmt::format(" {} ->", e.before);
  if (e.which[0] != '\0') out += fmt::format(" {}", e.which);
  const bool figure = e.value != 0 || e.limit != 0;
  if (e.why[0] != '\0' || figure) out += fmt::format(": {}", e.why);
  if (figure) out += fmt::format(" {:.4g}", e.value);
  if (e.limit != 0) out += fmt::format(", limit {:.4g}", e.limit);
  return out;
}

}  // namespace godwit::app
