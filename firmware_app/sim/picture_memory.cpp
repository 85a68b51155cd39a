#include "firmware_app/sim/picture_memory.h"

#include <fstream>
#include <string>

namespace godwit::app {
namespace {

/// Memory that the kernel thinks it can give without swapping [bytes]; 0 if it does not say.
std::uint64_t available_memory() {
  std::ifstream meminfo("/proc/meminfo");
  std::string key, unit;
  for (std::uint64_t kib = 0; meminfo >> key >> kib; std::getline(meminfo, unit)) {
    if (key == "MemAvailable:") return kib * 1024;
  }
  return 0;
}

}  // namespace

rt::Result<void> room_for_pictures(std::int64_t pictures, int width, int height) {
  const std::uint64_t there = available_memory();
  const std::uint64_t needed =
      static_cast<std::uint64_t>(pictures) * static_cast<std::uint64_t>(width) * static_cast<std::uint64_t>(height);
  if (there == 0 || needed <= there / 5 * 4) return {};
  return rt::Error{std::to_string(pictures) + " pictures need " + std::to_string(needed >> 20) + " MB, and " +
                   std::to_string(there >> 20) + " MB of memory are free"};
}

}  // namespace godwit::app
