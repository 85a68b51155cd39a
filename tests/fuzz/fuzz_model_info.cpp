#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "detector/model_info.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto parsed = godwit::detector::parse_model_info({reinterpret_cast<const char*>(data), size}, "m.toml");
  if (!parsed.ok()) {
    if (parsed.error().message.find("m.toml") != 0) std::abort();
    return 0;
  }
  // Whatever is accepted can be run with.
  const auto& info = parsed.value();
  if (info.input_width < 32 || info.input_height < 32 || info.output_rows() < 1) std::abort();
  if (!std::isfinite(info.scale) || info.classes.empty() || info.movable.size() != info.classes.size()) std::abort();
  return 0;
}
