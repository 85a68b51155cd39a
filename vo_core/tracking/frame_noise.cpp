#include "vo_core/tracking/frame_noise.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>

#include "vo_core/geometry/residual_spread.h"

namespace godwit::vo {
namespace {
constexpr double kKept = 0.95;      ///< of the sums a frame later: an average over some 20 frames
constexpr int kFewestCorners = 16;  ///< corners, two a band
constexpr int kColumns = 4;         ///< parts of a band: who stands before two of them leaves the next but one alone

/// What strays alike in parts of a band that do not lie beside each other.
class AcrossRows {
 public:
  /// psi, slope: of the residual over its sigma; place: from 0 at the left to 1.
  void add(const Vec2& psi, double slope, double place, std::size_t band) {
    const int column = std::clamp(static_cast<int>(place * kColumns), 0, kColumns - 1);
    Part& part = parts_[band][static_cast<std::size_t>(column)];
    part.x += psi.x();
    part.y += psi.y();
    part.slope += slope;
  }
  /// Sum over pairs of the products of what both are off by, and of their weights: their ratio is the variance of a
  /// coordinate.
  void products(double* alike, double* pairs) const {
    for (const auto& band : parts_) {
      for (std::size_t a = 0; a + 2 < kColumns; ++a) {
        for (std::size_t b = a + 2; b < kColumns; ++b) {
          *alike += band[a].x * band[b].x + band[a].y * band[b].y;
          *pairs += 2.0 * band[a].slope * band[b].slope;
        }
      }
    }
  }

 private:
  struct Part {
    double x = 0.0, y = 0.0, slope = 0.0;
  };
  std::array<std::array<Part, kColumns>, ResidualSpread::kBands> parts_;
};
}  // namespace

FrameCovariance FrameNoise::covariance(const CameraModel& camera, std::span<const PoseMeasurement> measurements,
                                       const SE3& T_cam_world, double weight_scale) {
  constexpr int kBands = ResidualSpread::kBands;
  ResidualSpread spread;
  AcrossRows across;
  Mat6 H = Mat6::Zero();
  std::array<Mat26, kBands> in_band;  // sums of the Jacobians over stated sigmas
  std::array<int, kBands> count{};
  in_band.fill(Mat26::Zero());
  for (const PoseMeasurement& m : measurements) {
    JudgedResidual judged;
    if (!judge_residual(camera, T_cam_world, m, weight_scale, &judged)) continue;
    auto& [r, J, inv_sigma, v] = judged;
    const bool edgelet = m.type == FeatureType::kEdgelet;
    J *= inv_sigma;
    H.noalias() += J.transpose() * J;
    const double row = m.px.y() / camera.height();
    if (!edgelet) {
      in_band[ResidualSpread::band(row)] += J;
      ++count[ResidualSpread::band(row)];
    }
    if (v >= 1.0) {
      spread.add(Vec2::Zero(), 0.0, edgelet ? 1 : 2, row);
      continue;
    }
    // psi = r (1 - v)^2; its derivative is (1 - v)(1 - 5 v) along r and (1 - v)^2 across.
    const double slope = edgelet ? (1.0 - v) * (1.0 - 5.0 * v) : (1.0 - v) * (1.0 - 3.0 * v);
    const Vec2 psi = r * (inv_sigma * (1.0 - v) * (1.0 - v));
    spread.add(psi, slope, edgelet ? 1 : 2, row);
    if (!edgelet) across.add(psi, slope, m.px.x() / camera.width(), ResidualSpread::band(row));
  }
  spread.close_picture();
  FrameCovariance out;
  const double variance = spread.variance(6);
  const Eigen::LDLT<Mat6> ldlt(H);
  if (!(variance > 0.0) || ldlt.info() != Eigen::Success || !ldlt.isPositive()) return out;
  const Mat6 H_inv = ldlt.solve(Mat6::Identity());
  if (!H_inv.allFinite()) return out;

  // What the bands' sums would come to if all measurements were independent: 2 n less what the pose takes away.
  double sums = 0.0, squares = 0.0;
  int corners = 0;
  Mat26 J_all = Mat26::Zero();
  for (int k = 0; k < kBands; ++k) {
    sums += 2.0 * count[k] - (in_band[k] * H_inv * in_band[k].transpose()).trace();
    squares += static_cast<double>(count[k]) * count[k];
    corners += count[k];
    J_all += in_band[k];
  }
  if (corners < kFewestCorners) return {H_inv * variance, Mat6::Zero()};
  const double independent = spread.band_square() / (2.0 * corners - 6.0) * sums;
  // In units of what a patch alone makes of a measurement.
  const double stated = 1.0 + shake_;
  sums_ = kKept * sums_ + stated * spread.band_sum_square();
  independent_ = kKept * independent_ + stated * independent;
  squares_ = kKept * squares_ + squares;
  out.noise = H_inv * (variance * std::max(1.0, sums_ / independent_));
  out.strayed.setZero();
  if (!rolling_) return out;
  // Each band of a rolling shutter is another time. By how much the bands are off together, beyond chance, says how far
  // the camera strays within one readout from where the constant velocity has it; so far it may have strayed at the
  // capture time, for which the pose is told. What strays smoothly is just what a pose takes for its own: of the 2
  // kBands sums its six unknowns leave the rest.
  constexpr double kLeft = (2.0 * kBands - 6.0) / (2.0 * kBands);
  const double strayed = std::max(0.0, sums_ - independent_) / (2.0 * squares_ * kLeft);
  const Eigen::Matrix<double, 6, 2> moved = H_inv * J_all.transpose();
  out.strayed = strayed / stated * moved * moved.transpose();
  double alike = 0.0, pairs = 0.0;
  across.products(&alike, &pairs);
  if (!(pairs > 0.0)) return out;
  // Here as it is: what a pose has taken for its own is in no residual.
  const double now = stated * alike / pairs;
  alike_ = kKept * alike_ + now;
  alike_square_ = kKept * alike_square_ + now * now;
  weight_ = kKept * weight_ + 1.0;
  const double pictures = (1.0 + kKept) * weight_;  // that such a mean is worth
  const double mean = alike_ / weight_;
  shake_ = mean > 3.0 * std::sqrt(alike_square_ / weight_ / pictures) ? mean : 0.0;
  return out;
}

}  // namespace godwit::vo
