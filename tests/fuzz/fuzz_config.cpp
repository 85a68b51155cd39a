#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "firmware_app/config/config.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto report = godwit::app::parse_config({reinterpret_cast<const char*>(data), size}, "godwit.toml");
  for (const auto& mistake : report.mistakes) {
    if (mistake.find("godwit.toml:") != 0) std::abort();
  }
  if (report.ok()) {
    // What was accepted is shown in words that are accepted again, and mean the same: every value is in its range.
    const auto shown = godwit::app::show_config(report.config);
    std::string text;
    for (const auto& line : shown) text += line + "\n";
    const auto again = godwit::app::parse_config(text, "shown.toml");
    if (!again.ok() || godwit::app::show_config(again.config) != shown) std::abort();
  }
  return 0;
}
