// How far a least-squares solution may be off, told by its own residuals: the variance of a robust estimate (Huber
// 1981, section 6.3) times what correlation between neighbours adds (Kish's design effect).
//
// Of normal white noise the first is its variance. Where residuals have long tails, as those of image patches do, it
// lies between the bulk's spread and the mean square, by how much the estimator's weights trust the tails. The second
// is 1 where errors are independent. A rolling shutter on a shaking camera, a lens that bends differently from its
// model or a surface whose depth is wrong move whole bands of the picture together: n measurements are then worth n /
// effect.
#pragma once

#include <array>
#include <cmath>

#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// Of Tukey's biweight: 95 % efficiency at the normal distribution (Holland and Welsch 1977).
inline constexpr double kTukey = 4.6851;

/// Sums over residuals in stated sigmas. Plain arithmetic, no allocation.
class ResidualSpread {
 public:
  /// Rows of the picture that are judged together.
  static constexpr int kBands = 8;

  /// psi: the residual r times the estimator's weight; slope: expected derivative of psi, averaged over directions;
  /// dimensions: 2, or 1 for edgelets (then r = (r, 0)); row: 0 to 1, where in the picture.
  void add(const Vec2& psi, double slope, int dimensions, double row) {
    square_ += psi.squaredNorm();
    slope_ += dimensions * slope;
    rows_ += dimensions;
    if (dimensions != 2) return;
    band_square_ += psi.squaredNorm();
    band_[band(row)] += psi;
  }

  static std::size_t band(double row) {
    const int b = row > 0.0 ? static_cast<int>(row * kBands) : 0;
    return b < kBands ? b : kBands - 1;
  }

  /// The residuals so far belong to one picture, the next ones to another.
  void close_picture() {
    for (Vec2& b : band_) {
      band_sum_square_ += b.squaredNorm();
      b.setZero();
    }
  }

  /// Variance of one measurement as the estimate feels it, in stated variances; the estimate has used up `unknowns`
  /// degrees of freedom. Negative: too few residuals to tell.
  double variance(int unknowns) const {
    const int left = rows_ - unknowns;
    if (left < 10 || !(slope_ > 0.05 * rows_)) return -1.0;
    const double slope = slope_ / rows_;
    return square_ / left / (slope * slope);
  }

  /// At least 1. From the sums below over closed pictures. A picture's pose may take up to six of its 2 kBands sums
  /// away: taken for six, which errs on the careful side (of independent errors this says up to 1.6).
  static double design_effect(double sum_square, double square) {
    return square > 0.0 ? std::fmax(1.0, sum_square / square * (2.0 * kBands / (2.0 * kBands - 6.0))) : 1.0;
  }
  double band_sum_square() const { return band_sum_square_; }
  double band_square() const { return band_square_; }

 private:
  double square_ = 0.0, slope_ = 0.0;
  int rows_ = 0;
  double band_square_ = 0.0, band_sum_square_ = 0.0;
  std::array<Vec2, kBands> band_{Vec2::Zero(), Vec2::Zero(), Vec2::Zero(), Vec2::Zero(),
                                 Vec2::Zero(), Vec2::Zero(), Vec2::Zero(), Vec2::Zero()};
};

}  // namespace godwit::vo
