// What no inertial sensor gives: readings that are empty or do not change.
#pragma once

#include <array>
#include <cstdint>

namespace godwit::hal {

/// Looks at raw readings, one after the other: acceleration and rate, six numbers.
class ReadingCheck {
 public:
  /// Readings of a sensor that works differ: its noise is a unit or more on each of six axes, so that two in a row are
  /// the same once in some thousand times. The same one for longer than this is a register that nobody writes any more.
  static constexpr int kStuckSamples = 20;
  /// Three in a row: one may be chance.
  static constexpr int kEmptySamples = 3;
  /// What is wrong, static text; null: nothing. No allocation.
  const char* look(const std::array<std::int32_t, 6>& raw);
  void reset() { *this = {}; }

 private:
  std::array<std::int32_t, 6> last_{};
  int same_ = 0;
  bool any_ = false;
};

}  // namespace godwit::hal
