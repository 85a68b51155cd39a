#include "hal/imu/axis_map.h"

namespace godwit::hal {

std::optional<AxisMap> parse_axis_map(std::string_view text) {
  AxisMap out;
  std::size_t axes = 0;
  int sign = 1;
  for (const char c : text) {
    if (c == '-' && sign == 1) {
      sign = -1;
    } else if (c >= 'x' && c <= 'z' && axes < 3) {
      out.from[axes] = c - 'x';
      out.sign[axes++] = sign;
      sign = 1;
    } else if (c != ' ' || sign != 1) {
      return std::nullopt;
    }
  }
  if (axes != 3 || sign != 1) return std::nullopt;
  // Even permutation: x y z and its two turns.
  const auto& f = out.from;
  if (f[0] == f[1] || f[1] == f[2] || f[0] == f[2]) return std::nullopt;
  const int parity = (f[1] - f[0] + 3) % 3 == 1 ? 1 : -1;
  if (parity * out.sign[0] * out.sign[1] * out.sign[2] != 1) return std::nullopt;
  return out;
}

}  // namespace godwit::hal
