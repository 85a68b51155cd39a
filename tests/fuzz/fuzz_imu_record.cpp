#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "hal/imu/replay/imu_record.h"

namespace {

/// What every record that was accepted must hold.
void check(const godwit::rt::Result<godwit::hal::ImuRecord>& record) {
  if (!record.ok()) {
    if (record.error().message.empty()) std::abort();
    return;
  }
  if (record.value().samples.empty()) std::abort();
  godwit::rt::TimeNs newest = -1;
  for (const godwit::hal::ImuSample& s : record.value().samples) {
    if (s.t_ns <= newest) std::abort();
    newest = s.t_ns;
    for (const double v : s.gyro_rad_s) {
      if (!(std::abs(v) <= 100)) std::abort();
    }
    for (const double v : s.accel_m_s2) {
      if (!(std::abs(v) <= 1000)) std::abort();
    }
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  check(godwit::hal::parse_tum_imu(text, "imu.txt"));
  check(godwit::hal::parse_euroc_imu(text, "data.csv"));
  return 0;
}
