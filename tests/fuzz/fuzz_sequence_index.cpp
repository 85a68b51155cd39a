#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "hal/camera/replay/picture_file.h"
#include "hal/camera/replay/sequence_index.h"

namespace {

/// What every index that was accepted must hold.
void check(const godwit::rt::Result<godwit::hal::SequenceIndex>& index) {
  using godwit::hal::TimeFault;
  if (!index.ok()) {
    if (index.error().message.empty()) std::abort();
    return;
  }
  if (index.value().entries.empty()) std::abort();
  godwit::rt::TimeNs newest = -1;
  int line = 0;
  for (const auto& entry : index.value().entries) {
    if (entry.t_ns < 0 || entry.file.empty() || entry.line <= line) std::abort();
    if ((entry.fault == TimeFault::kNone) != (entry.t_ns > newest)) std::abort();
    if (entry.fault == TimeFault::kNone) newest = entry.t_ns;
    line = entry.line;
    // Times survive being written and read again.
    godwit::rt::TimeNs again = -1;
    if (!godwit::hal::parse_decimal_seconds(godwit::hal::format_seconds(entry.t_ns), &again) || again != entry.t_ns) {
      std::abort();
    }
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  check(godwit::hal::parse_tum_index(text, "rgb.txt"));
  check(godwit::hal::parse_euroc_index(text, "data.csv"));
  godwit::hal::picture_is_whole({data, size});
  return 0;
}
