#include "firmware_app/commands/top_screen.h"

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace godwit::app {
namespace {

using Json = nlohmann::json;

/// One value as people read it; what is missing, null or of another kind: "-".
std::string words(const Json& j, const char* key, int digits = 0) {
  const auto at = j.find(key);
  if (at == j.end() || at->is_null()) return "-";
  if (at->is_string()) return at->get<std::string>();
  if (at->is_boolean()) return at->get<bool>() ? "yes" : "no";
  if (at->is_number_integer()) return fmt::format("{}", at->get<std::int64_t>());
  if (at->is_number()) return fmt::format("{:.{}f}", at->get<double>(), digits);
  return "-";
}

std::string spread(const Json& j, const char* key) {
  const auto at = j.find(key);
  if (at == j.end() || !at->is_object()) return fmt::format("{:>8}{:>8}{:>8}", "-", "-", "-");
  return fmt::format("{:>8}{:>8}{:>8}", words(*at, "p50", 2), words(*at, "p95", 2), words(*at, "max", 2));
}

std::string place(const Json& j) {
  const auto at = j.find("position");
  if (at == j.end() || !at->is_array() || at->size() != 3) return "-";
  std::string out;
  for (const Json& value : *at) {
    if (!value.is_number()) return "-";
    out += fmt::format("{:.3f} ", value.get<double>());
  }
  const bool metric = words(j, "metric") == "yes";
  return out + fmt::format("{}  sigma {}", metric ? "m" : "(units of the map)", words(j, "position_sigma", 3));
}

/// Control characters would move the cursor; a character of several bytes is not cut.
void add_line(std::string text, std::size_t columns, std::string* out) {
  for (char& c : text) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7F) c = ' ';
  }
  if (text.size() > columns) {
    text.resize(columns);
    while (!text.empty() && (static_cast<unsigned char>(text.back()) & 0x80) != 0) text.pop_back();
  }
  *out += text + "\n";
}

}  // namespace

rt::Result<std::string> top_screen(std::string_view line, std::size_t columns) {
  const Json j = Json::parse(line, nullptr, false);
  if (!j.is_object()) return rt::Error{"what is told there is not godwitd's"};
  if (j.contains("error")) return rt::Error{words(j, "error")};
  if (!j.contains("state")) return rt::Error{"what is told there is not godwitd's"};
  std::string out;
  const auto add = [&](std::string text) { add_line(std::move(text), columns, &out); };
  add(fmt::format("godwitd {}  pid {}  up {} s", words(j, "version"), words(j, "pid"), words(j, "uptime_s", 0)));
  add(fmt::format("state        {}  {}", words(j, "state"), words(j, "reason")));
  add(fmt::format("quality      {}  trust {}  metric {}", words(j, "quality"), words(j, "trust", 2),
                  words(j, "metric")));
  add(fmt::format("position     {}", place(j)));
  add(fmt::format("north        {}  sigma {}  fixes {}  used {}  refused {}", words(j, "north"),
                  words(j, "north_sigma_deg", 1), words(j, "fixes"), words(j, "fixes_used"),
                  words(j, "fixes_refused")));
  add(fmt::format("rates        {} pictures/s  {} poses/s  last picture {} s ago", words(j, "pictures_hz", 1),
                  words(j, "poses_hz", 1), words(j, "last_frame_s", 2)));
  add(fmt::format("frames       {}  tracked {}  not flown {}", words(j, "frames"), words(j, "tracked"),
                  words(j, "not_flown")));
  add(fmt::format("map          {}  keyframes {}  points {}  seeds {}  features {}", words(j, "map"),
                  words(j, "keyframes"), words(j, "points"), words(j, "seeds"), words(j, "features")));
  add(fmt::format("[ms]         {:>8}{:>8}{:>8}", "p50", "p95", "max"));
  add("age at pose  " + spread(j, "age_ms"));
  add("our share    " + spread(j, "own_ms"));
  add("tracking     " + spread(j, "tracking_ms"));
  add(fmt::format("rung         {}", words(j, "rung")));
  add(fmt::format("temperature  {} C{}", words(j, "temperature_c", 1),
                  words(j, "throttled") == "yes" ? "  the machine slows its processors down" : ""));
  const auto events = j.find("events");
  if (events == j.end() || !events->is_array()) return out;
  add("events");
  for (const Json& event : *events) {
    if (event.is_string()) add("  " + event.get<std::string>());
  }
  return out;
}

}  // namespace godwit::app
