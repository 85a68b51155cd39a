#include "vo_core/tracking/shake_fit.h"

#include <Eigen/Cholesky>
#include <cmath>

#include "hal/rt/count.h"

namespace godwit::vo {
namespace {
/// What is known of both beforehand, one sigma: sensors have low-passes that leave half of what shakes, and are late by
/// a few milliseconds [s].
constexpr double kShakeGainSigma = 0.5, kShakeDelaySigma = 3e-3;
constexpr double kShakeKept = 0.998;  ///< of the sums a picture later: how a sensor sits may change as it warms up
constexpr int kFewestTracks = 20;

/// By how much a turn of T_cam_world moves what is seen at xy on the plane z = 1.
Mat23 moved_by_turn(const Vec2& xy) {
  Mat23 out;
  out << -xy.x() * xy.y(), 1.0 + xy.x() * xy.x(), -xy.y(), -1.0 - xy.y() * xy.y(), xy.x() * xy.y(), xy.x();
  return out;
}
}  // namespace

void ShakeFit::fill(const MeasuredShake& measured, ReadoutMotion* motion) const {
  motion->shakes = measured.known;
  if (!motion->shakes) return;
  const auto gain = static_cast<float>(found_(0)), rate_s = static_cast<float>(found_(1));
  for (int k = 0; k < RowTurns::kRows; ++k)
    motion->shake.at[k] = gain * measured.turn.at[k] + rate_s * measured.rate.at[k];
}

double ShakeFit::off(const MeasuredShake& measured, const ReadoutMotion& motion) const {
  if (!measured.known || !motion.shakes) return 0.0;
  ReadoutMotion now;
  fill(measured, &now);
  double squares = 0.0;
  for (int k = 0; k < RowTurns::kRows; ++k) squares += (now.shake.at[k] - motion.shake.at[k]).squaredNorm();
  return std::sqrt(squares / RowTurns::kRows);
}

template <int kNuisances>
void ShakeFit::take(const Eigen::Matrix<double, kNuisances + 2, kNuisances + 2>& H,
                    const Eigen::Matrix<double, kNuisances + 2, 1>& b, const Vec2& about, double sure) {
  const Eigen::LDLT<Eigen::Matrix<double, kNuisances, kNuisances>> nuisances(
      H.template topLeftCorner<kNuisances, kNuisances>());
  if (nuisances.info() != Eigen::Success || !nuisances.isPositive()) return;
  Eigen::Matrix<double, kNuisances, 3> crossed;
  crossed << H.template topRightCorner<kNuisances, 2>(), b.template head<kNuisances>();
  const Eigen::Matrix<double, kNuisances, 3> taken = nuisances.solve(crossed);
  const auto across = H.template bottomLeftCorner<2, kNuisances>();
  const Eigen::Matrix2d seen = H.template bottomRightCorner<2, 2>() - across * taken.template leftCols<2>();
  const Vec2 more = b.template tail<2>() - across * taken.col(2);
  if (!seen.allFinite() || !more.allFinite() || !std::isfinite(sure)) return;
  information_ = kShakeKept * information_ + sure * seen;
  weighted_ = kShakeKept * weighted_ + sure * (more + seen * about);
  Eigen::Matrix2d all = information_;
  const Vec2 before(1.0 / (kShakeGainSigma * kShakeGainSigma), 1.0 / (kShakeDelaySigma * kShakeDelaySigma));
  all.diagonal() += before;
  found_ = all.ldlt().solve(weighted_ + before.cwiseProduct(Vec2::UnitX()));
}

void ShakeFit::learn(const CameraModel& camera, std::span<const PoseMeasurement> measurements, const SE3& T_cam_world,
                     double weight_scale, double correlated, const MeasuredShake& measured,
                     const ReadoutMotion& motion) {
  if (!measured.known) return;
  Eigen::Matrix<double, 8, 8> H = Eigen::Matrix<double, 8, 8>::Zero();
  Eigen::Matrix<double, 8, 1> b = Eigen::Matrix<double, 8, 1>::Zero();
  for (const PoseMeasurement& m : measurements) {
    JudgedResidual judged;
    if (!judge_residual(camera, T_cam_world, m, weight_scale, &judged) || judged.v >= 1.0) continue;
    const auto& [r, J, inv_sigma, v] = judged;
    const double weight = std::pow((1.0 - v) * inv_sigma, 2);
    const double row = m.px.y() / camera.height();
    Eigen::Matrix<double, 2, 8> A;
    A.leftCols<6>() = J;
    A.col(6) = J.rightCols<3>() * measured.turn.turn(row);
    A.col(7) = J.rightCols<3>() * measured.rate.turn(row);
    H.noalias() += weight * A.transpose() * A;
    b.noalias() -= weight * A.transpose() * r;
  }
  take<6>(H, b, motion.shakes ? Vec2(found_) : Vec2::Zero(), 1.0 / (weight_scale * weight_scale * correlated));
}

void ShakeFit::learn(std::span<const InitialTracks::InThreeViews> tracks,
                     const std::array<MeasuredShake, 3>& measured) {
  if (rt::count_of(tracks) < kFewestTracks) return;
  for (const MeasuredShake& m : measured)
    if (!m.known) return;
  Eigen::Matrix<double, 5, 5> H;
  Eigen::Matrix<double, 5, 1> b, x = Eigen::Matrix<double, 5, 1>::Zero();
  x.tail<2>() = found_;
  double variance = 0.0;
  // Where a track that goes evenly lies in the three views adds up to nothing by these, dropped pictures or not.
  const auto apart = [&](std::size_t i) { return static_cast<double>(measured[i].t_ns - measured[i + 1].t_ns); };
  if (!(apart(0) > 0.0 && apart(1) > 0.0)) return;
  const double longer = apart(0) / apart(1);
  const std::array<double, 3> evenly = {1.0, -1.0 - longer, longer};
  const auto equations = [&](const InitialTracks::InThreeViews& t, Eigen::Matrix<double, 2, 5>* A) {
    Vec2 off = Vec2::Zero();
    *A << moved_by_turn(t.xy[0]), Vec2::Zero(), Vec2::Zero();
    for (std::size_t i = 0; i < 3; ++i) {
      const Mat23 moved = moved_by_turn(t.xy[i]);
      off += evenly[i] * t.xy[i];
      A->col(3) += evenly[i] * moved * measured[i].turn.turn(t.row[i]);
      A->col(4) += evenly[i] * moved * measured[i].rate.turn(t.row[i]);
    }
    return off;
  };
  // Cauchy's weights about what is left by the solution before: what moves, or has slid along an edge, counts little.
  for (int round = 0; round < 4; ++round) {
    H.setZero();
    b.setZero();
    double weights = 0.0, squares = 0.0;
    for (const auto& t : tracks) {
      Eigen::Matrix<double, 2, 5> A;
      const Vec2 off = equations(t, &A);
      const double left = (off - A * x).squaredNorm();
      const double weight = round == 0 ? 1.0 : 1.0 / (1.0 + left / variance);
      H.noalias() += weight * A.transpose() * A;
      b.noalias() += weight * A.transpose() * off;
      weights += weight;
      squares += weight * left;
    }
    x = H.ldlt().solve(b);
    variance = squares / (2.0 * weights);
    if (!x.allFinite() || !(variance > 0.0)) return;
  }
  take<3>(H, b, Vec2::Zero(), 1.0 / variance);
}

}  // namespace godwit::vo
