#include "hal/sim/world/spline.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <utility>

namespace godwit::sim {
namespace {
// Basis polynomials of the uniform quintic B-spline times 120; row = control point, column = power of u.
constexpr std::array<std::array<double, 6>, 6> kBasis = {{{1, -5, 10, -10, 5, -1},
                                                          {26, -50, 20, 20, -20, 5},
                                                          {66, 0, -60, 0, 30, -10},
                                                          {26, 50, 20, -20, -20, 10},
                                                          {1, 5, 10, 10, 5, -5},
                                                          {0, 0, 0, 0, 0, 1}}};
}  // namespace

QuinticSpline::QuinticSpline(std::vector<Vec6> control, double knot_s) : control_(std::move(control)), knot_s_(knot_s) {
  assert(control_.size() >= 6 && knot_s > 0);
}

SplineSample QuinticSpline::sample(double t_s) const {
  const double spans = static_cast<double>(control_.size() - 5);
  const double s = std::clamp(t_s / knot_s_, 0.0, spans);
  const double span = std::min(std::floor(s), spans - 1.0);
  const double u = s - span;
  const auto first = static_cast<std::size_t>(span);
  SplineSample out{Vec6::Zero(), Vec6::Zero(), Vec6::Zero()};
  for (std::size_t i = 0; i < 6; ++i) {
    // Horner for the polynomial and its two derivatives at once.
    double p = 0, dp = 0, ddp = 0;
    for (int k = 5; k >= 0; --k) {
      ddp = ddp * u + 2.0 * dp;
      dp = dp * u + p;
      p = p * u + kBasis[i][k];
    }
    const Vec6& c = control_[first + i];
    out.value += p / 120.0 * c;
    out.first += dp / (120.0 * knot_s_) * c;
    out.second += ddp / (120.0 * knot_s_ * knot_s_) * c;
  }
  return out;
}

}  // namespace godwit::sim
