// How well a map point is found in a picture: the noise of an image measurement, by the pyramid level it was made on.
#pragma once

#include <cmath>

namespace godwit::vo {

/// One sigma of each coordinate of a map point's measured place against where a right pose expects it [level-0 px].
/// Two parts: what the map's points and the camera model are off by, the same on every level, and what the patch's
/// alignment is off by, in pixels of its level. Both from the residuals' medians at levels 0, 1 and 2: 0.45, 0.73 and
/// 1.20 px on tum_fr1_xyz, 0.40, 0.59 and 1.06 px on euroc_mh01.
inline double match_sigma_px(int level) {
  constexpr double kMapPx = 0.35, kAlignPx = 0.28;
  const double align = kAlignPx * static_cast<double>(1 << level);
  return std::sqrt(kMapPx * kMapPx + align * align);
}

}  // namespace godwit::vo
