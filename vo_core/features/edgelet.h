// Edgelets: points on straight edges, of use where there is no corner (Forster et al., TRO 2017, section VI).
#pragma once

#include "hal/rt/image.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// The point of strongest gradient in a part of a picture.
struct Edgelet {
  int x = 0, y = 0;
  float magnitude = 0.0f;            ///< of the gradient [grey levels a pixel]
  Vec2f direction = Vec2f::UnitX();  ///< unit gradient direction, from dark to bright
};

/// Smallest distance of a pixel from the picture's edge.
constexpr int kEdgeletBorder = 2;

/// Strongest gradient (Sobel) among the pixels [x_begin, x_end) x [y_begin, y_end) that are not masked (`mask` empty:
/// none is). False if all are masked or flatter than min_magnitude [grey levels a pixel]. Precondition: the pixels are
/// at least 1 from the edge. No allocation, any thread.
bool find_edgelet(const rt::ImageView& image, const rt::ImageView& mask, int x_begin, int y_begin, int x_end, int y_end,
                  float min_magnitude, Edgelet* edgelet);

}  // namespace godwit::vo
