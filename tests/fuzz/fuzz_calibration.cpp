#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "hal/camera/calibration.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto c = godwit::hal::parse_calibration({reinterpret_cast<const char*>(data), size}, "camera.yaml");
  if (!c.ok()) {
    if (c.error().message.find("camera.yaml") != 0) std::abort();
    return 0;
  }
  // Whatever is accepted can be flown with.
  const auto& v = c.value();
  if (v.width < 1 || v.height < 1 || !(v.fx > 0) || !(v.fy > 0) || !(v.cx > 0 && v.cx < v.width)) std::abort();
  for (const double k : v.distortion) {
    if (!std::isfinite(k)) std::abort();
  }
  if (v.channels != 1 && v.channels != 3) std::abort();
  return 0;
}
