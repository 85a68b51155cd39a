#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "firmware_app/config.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto report = godwit::app::parse_config({reinterpret_cast<const char*>(data), size}, "godwit.toml");
  for (const auto& mistake : report.mistakes) {
    if (mistake.find("godwit.toml:") != 0) std::abort();
  }
  if (report.ok()) {
    const auto& p = report.config.pipeline;
    if (p.frame_slots < 0 || p.frame_slots > 128 || p.mapper_delay_frames < 1 || p.mapper_delay_frames > 30)
      std::abort();
  }
  return 0;
}
