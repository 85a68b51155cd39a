// How an inertial sensor sits in the aircraft: which of its axes points forward, right and down.
#pragma once

#include <array>
#include <optional>
#include <string_view>

namespace godwit::hal {

/// A rotation by right angles: body axis i is sign[i] times sensor axis from[i].
struct AxisMap {
  std::array<int, 3> from{0, 1, 2};
  std::array<int, 3> sign{1, 1, 1};

  std::array<double, 3> apply(const std::array<double, 3>& v) const {
    std::array<double, 3> out{};
    for (std::size_t i = 0; i < 3; ++i) out[i] = sign[i] * v[from[i]];
    return out;
  }
};

/// "x y z", "y -x z", "-x y -z": the sensor's axes that point along the body's forward, right and down. Nothing: not
/// three different axes, or a mirror image, which no mounting makes.
std::optional<AxisMap> parse_axis_map(std::string_view text);

}  // namespace godwit::hal
