#include "vo_core/tracking/sparse_image_align.h"

#include <Eigen/Cholesky>
#include <algorithm>

#include "hal/rt/count.h"
#include "vo_core/features/align_warp.h"
#include "vo_core/image/patch.h"

namespace godwit::vo {
namespace {
constexpr int kHalf = 2;  // 4x4 patch: pixels -2..+1 around the point
/// One sigma of a patch's own gain between two pictures, over what noise and warp leave of a residual [grey levels]:
/// under lamps on the mains a rolling shutter sees rows at 0.5 to 2 of what they were. Its offset is free.
constexpr float kGainSigma = 0.5f, kResidualSigma = 4.0f;
constexpr float kGainPrior = (kResidualSigma / kGainSigma) * (kResidualSigma / kGainSigma);
/// A patch weighs no less than this for want of contrast, and noise of a grey level makes no contrast [sum over it].
constexpr float kLeastShare = 0.01f, kNoiseVariance = 16.0f;
}  // namespace

void SparseImageAlign::look_at(std::span<const AlignPoint> points) {
  patch_count_ = std::min(rt::count_of(points), rt::count_of(patches_));
  for (int i = 0; i < patch_count_; ++i) {
    Patch& patch = patches_[i];
    for (int axis = 0; axis < 3; ++axis) p_ref_[axis][i] = static_cast<float>(points[i].p_ref(axis));
    Vec2 unused;
    Mat23 Jp;
    patch.in_view = camera_.project(points[i].p_ref, &unused, &Jp);
    if (!patch.in_view) continue;
    patch.J_level_0 =
        align_jacobian(Jp, points[i].p_ref, row_time(static_cast<double>(points[i].px.y()))).cast<float>();
  }
}

void SparseImageAlign::prepare(const rt::ImageView& ref, int level, std::span<const AlignPoint> points) {
  const hn::FixedTag<float, 4> df;
  const auto sum = [&](auto v) { return hn::GetLane(hn::SumOfLanes(df, v)); };
  const float scale = 1.0f / level_scale(level);
  for (int i = 0; i < patch_count_; ++i) {
    Patch& patch = patches_[i];
    const Vec2f px = to_level(points[i].px, level);
    patch.visible = patch.in_view && window_inside(ref, px, kHalf + 1, kHalf + 3);
    if (!patch.visible) continue;
    row_[i] = points[i].px.y();
    patch.J = patch.J_level_0 * scale;

    alignas(16) float window[6 * 8];  // rows of 8: the patch with a border of 1 pixel
    sample_grid(ref, px.x() - kHalf - 1, px.y() - kHalf - 1, 2, 6, window);
    auto values = hn::Zero(df);
    for (int y = 0; y < 4; ++y) values = hn::Add(values, hn::LoadU(df, window + (y + 1) * 8 + 1));
    const float mean = sum(values) / 16.0f;
    auto gxx = hn::Zero(df), gxy = gxx, gyy = gxx, vv = gxx, g1x = gxx, g1y = gxx, gvx = gxx, gvy = gxx;
    for (int y = 0; y < 4; ++y) {
      const float* w = window + (y + 1) * 8 + 1;
      const auto half = hn::Set(df, 0.5f);
      const auto gx = hn::Mul(half, hn::Sub(hn::LoadU(df, w + 1), hn::LoadU(df, w - 1)));
      const auto gy = hn::Mul(half, hn::Sub(hn::LoadU(df, w + 8), hn::LoadU(df, w - 8)));
      const auto v = hn::Sub(hn::LoadU(df, w), hn::Set(df, mean));
      hn::Store(v, df, patch.value.data() + 4 * y);
      hn::Store(gx, df, patch.gx.data() + 4 * y);
      hn::Store(gy, df, patch.gy.data() + 4 * y);
      gxx = hn::MulAdd(gx, gx, gxx);
      gxy = hn::MulAdd(gx, gy, gxy);
      gyy = hn::MulAdd(gy, gy, gyy);
      g1x = hn::Add(gx, g1x);
      g1y = hn::Add(gy, g1y);
      gvx = hn::MulAdd(gx, v, gvx);
      gvy = hn::MulAdd(gy, v, gvy);
      vv = hn::MulAdd(v, v, vv);
    }
    // The patch's own gain and offset are eliminated (Schur complement); its values have no mean, so that they do not
    // mix.
    patch.mean = mean;
    patch.vv = sum(vv);
    patch.per_value = 1.0f / (patch.vv + kGainPrior);
    patch.g1 = Vec2f(sum(g1x), sum(g1y));
    patch.gv = Vec2f(sum(gvx), sum(gvy));
    Eigen::Matrix2f G;
    const float mixed = sum(gxy);
    G << sum(gxx), mixed, mixed, sum(gyy);
    G -= patch.gv * patch.gv.transpose() * patch.per_value + patch.g1 * patch.g1.transpose() / 16.0f;
    patch.H.noalias() = patch.J.transpose() * (G * patch.J).eval();
  }
}

void SparseImageAlign::warp(const SE3& T_cur_ref) {
  const hn::CappedTag<float, CameraModel::kRowLanes> d;
  const auto at = [&](const Row& row, int i) { return hn::LoadU(d, row.data() + i); };
  const auto set = [&](double value) { return hn::Set(d, static_cast<float>(value)); };
  const int lanes = static_cast<int>(hn::Lanes(d));
  for (int i = 0; i < patch_count_; i += lanes) {
    for (int axis = 0; axis < 3; ++axis) {
      const auto p = set(T_cur_ref.R(axis, 0)) * at(p_ref_[0], i) + set(T_cur_ref.R(axis, 1)) * at(p_ref_[1], i) +
                     set(T_cur_ref.R(axis, 2)) * at(p_ref_[2], i) + set(T_cur_ref.t(axis));
      hn::StoreU(p, d, p_cur_[axis].data() + i);
    }
  }
  if (shutter_.readout > 0.0) {
    const Vec6 motion = T_cur_ref.log();
    for (int i = 0; i < patch_count_; ++i) {
      const Vec3f p(p_cur_[0][i], p_cur_[1][i], p_cur_[2][i]);
      const Vec3 moved = align_warp(p.cast<double>(), motion, row_time(static_cast<double>(row_[i])));
      for (int axis = 0; axis < 3; ++axis) p_cur_[axis][i] = static_cast<float>(moved(axis));
    }
  }
  camera_.project(patch_count_, CameraModel::Rows<float>{p_cur_[0].data(), p_cur_[1].data(), p_cur_[2].data(),
                                                         u_.data(), v_.data(), seen_.data()});
}

int SparseImageAlign::accumulate(const rt::ImageView& cur, int level, const SE3& T_cur_ref, Mat6f* H, Vec6f* b,
                                 float* cost) {
  const hn::FixedTag<float, 4> df;
  H->setZero();
  b->setZero();
  float total = 0.0f, weight_sum = 0.0f;
  int used = 0;
  warp(T_cur_ref);
  for (int i = 0; i < patch_count_; ++i) {
    const Patch& patch = patches_[i];
    if (!patch.visible || !(seen_[i] > 0.0f)) continue;
    row_[i] = std::clamp(v_[i], 0.0f, static_cast<float>(camera_.height()));
    const Vec2f px = to_level(Vec2f(u_[i], v_[i]), level);
    if (!window_inside(cur, px, kHalf, kHalf + 1)) continue;
    alignas(16) float now[16];
    sample_grid(cur, px.x() - kHalf, px.y() - kHalf, 1, 4, now);
    const auto mean = hn::Set(df, patch.mean);
    auto srr = hn::Zero(df), sgx = srr, sgy = srr, s1 = srr, sv = srr;
    for (int k = 0; k < 16; k += 4) {
      const auto value = hn::Load(df, patch.value.data() + k);
      const auto r = hn::Sub(hn::Sub(hn::Load(df, now + k), mean), value);
      srr = hn::MulAdd(r, r, srr);
      sgx = hn::MulAdd(r, hn::Load(df, patch.gx.data() + k), sgx);
      sgy = hn::MulAdd(r, hn::Load(df, patch.gy.data() + k), sgy);
      s1 = hn::Add(r, s1);
      sv = hn::MulAdd(r, value, sv);
    }
    const float sum_1 = hn::GetLane(hn::SumOfLanes(df, s1)), sum_v = hn::GetLane(hn::SumOfLanes(df, sv));
    const float offset = sum_1 / 16.0f, more_gain = sum_v * patch.per_value;
    const float sum_rr = hn::GetLane(hn::SumOfLanes(df, srr));
    const float squares = sum_rr - sum_1 * offset - sum_v * more_gain;
    const float mean_square = std::max(squares, 0.0f) / 16.0f;
    const float rms = std::sqrt(mean_square);
    const float w = rms <= options_.huber_px ? 1.0f : options_.huber_px / rms;
    total += w * mean_square;
    weight_sum += w;
    ++used;
    const Vec2f rg = Vec2f(hn::GetLane(hn::SumOfLanes(df, sgx)), hn::GetLane(hn::SumOfLanes(df, sgy))) -
                     patch.gv * more_gain - patch.g1 * offset;
    // The picture's gradients are the reference's times the gain: of the light, which the means tell wherever the patch
    // lies. Less contrast than that light would leave is glare or a white that took all: there is little to read there,
    // and unweighted it would hold the step back.
    const float gain = std::clamp((patch.mean + offset) / std::max(patch.mean, 1.0f), 1.0f / kMaxGain, kMaxGain);
    const float variance = patch.vv + 2.0f * sum_v + sum_rr - sum_1 * offset;
    const float information = w * std::clamp(variance / (gain * gain * patch.vv + kNoiseVariance), kLeastShare, 1.0f);
    *H += information * patch.H;
    b->noalias() += information / gain * (patch.J.transpose() * rg);
  }
  *cost = weight_sum > 0 ? total / weight_sum : 0.0f;
  return used;
}

SparseAlignResult SparseImageAlign::run(const rt::PyramidView& ref, const rt::PyramidView& cur,
                                        std::span<const AlignPoint> points, const SE3& T_init,
                                        const RotationPrior& prior, const AlignShutter& shutter) {
  SparseAlignResult result;
  shutter_ = shutter;
  SE3 T = T_init;
  look_at(points);
  const int top = std::min(options_.max_level, ref.levels - 1);
  for (int level = top; level >= options_.min_level; --level) {
    prepare(ref.level[level], level, points);
    SE3 T_old = T;
    float cost_old = 0.0f;
    int used_old = 0;
    for (int it = 0; it < options_.max_iterations; ++it) {
      Mat6f H;
      Vec6f b;
      float cost;
      const int used = accumulate(cur.level[level], level, T, &H, &b, &cost);
      // The prior's part of the cost, in the same unit: grey levels squared a pixel.
      Eigen::Vector3f e = Eigen::Vector3f::Zero();
      float prior_weight = 0.0f;
      if (prior.sigma_rad > 0.0) {
        e = so3_log(T.R.transpose() * prior.R_cur_ref).cast<float>();
        prior_weight = static_cast<float>(options_.huber_px * options_.huber_px / (prior.sigma_rad * prior.sigma_rad));
        cost += prior_weight * e.squaredNorm() / (16.0f * static_cast<float>(std::max(used, 1)));
      }
      // A step that made the agreement worse is taken back; what is left to gain here is below the noise.
      if (it > 0 && (cost > cost_old || used < used_old / 2)) {
        T = T_old;
        break;
      }
      result.patches = used;
      result.rms = std::sqrt(cost);
      if (used < 6) break;
      if (prior_weight > 0.0f) {
        H.block<3, 3>(3, 3) += prior_weight * Eigen::Matrix3f::Identity();
        b.segment<3>(3) -= prior_weight * e;
      }
      const Vec6f x = H.ldlt().solve(b);
      if (!x.allFinite()) break;
      T_old = T;
      cost_old = cost;
      used_old = used;
      T = T * SE3::exp(-x.cast<double>());
      // Converged when the step moves no pixel of this level by a noticeable part.
      const float step_px = x.cwiseAbs().maxCoeff() * static_cast<float>(camera_.fx()) / level_scale(level);
      if (step_px < 0.03f) break;
    }
  }
  result.T_cur_ref = T;
  result.T_cur_ref.normalize();
  return result;
}

}  // namespace godwit::vo
