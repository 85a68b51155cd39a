#include "hal/imu/reading_check.h"

#include <algorithm>

namespace godwit::hal {

const char* ReadingCheck::look(const std::array<std::int32_t, 6>& raw) {
  same_ = any_ && raw == last_ ? same_ + 1 : 1;
  last_ = raw;
  any_ = true;
  const auto all = [&](int v) { return std::all_of(raw.begin(), raw.end(), [&](int r) { return r == v; }); };
  if (same_ >= kEmptySamples && all(0)) return "all readings are zero: the sensor sleeps, or nothing is wired";
  if (same_ >= kEmptySamples && all(-1)) return "all bits are set: the chip does not drive the bus";
  if (same_ >= kStuckSamples) return "the readings are stuck";
  return nullptr;
}

}  // namespace godwit::hal
