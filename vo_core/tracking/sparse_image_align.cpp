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
  used_.fill(0.0f);
  for (int i = 0; i < patch_count_; ++i) {
    Patch& patch = patches_[i];
    for (int axis = 0; axis < 3; ++axis) p_ref_[axis][i] = static_cast<float>(points[i].p_ref(axis));
    Vec2 unused;
    Mat23 Jp;
    patch.in_view = camera_.project(points[i].p_ref, &unused, &Jp);
    if (!patch.in_view) continue;
    const Mat26 J = align_jacobian(Jp, points[i].p_ref, row_time(static_cast<double>(points[i].px.y())));
    patch.J_level_0.fill(0.0f);
    for (int k = 0; k < 12; ++k) patch.J_level_0[8 * (k / 6) + k % 6] = static_cast<float>(J(k / 6, k % 6));
  }
}

void SparseImageAlign::prepare(const rt::ImageView& ref, int level, std::span<const AlignPoint> points) {
  const hn::FixedTag<float, 4> df;
  const RowTag dr;
  constexpr int kLanes = static_cast<int>(hn::MaxLanes(RowTag()));
  const float scale = 1.0f / level_scale(level);
  for (int i = 0; i < patch_count_; ++i) {
    Patch& patch = patches_[i];
    const Vec2f px = to_level(points[i].px, level);
    patch.visible = patch.in_view && window_inside(ref, px, kHalf + 1, kHalf + 3);
    if (!patch.visible) continue;
    row_[i] = points[i].px.y();

    alignas(32) float window[6 * 8];  // rows of 8: the patch with a border of 1 pixel
    sample_grid(ref, px.x() - kHalf - 1, px.y() - kHalf - 1, 2, 6, window);
    auto values = hn::Zero(df);
    for (int y = 0; y < 4; ++y) values = hn::Add(values, hn::LoadU(df, window + (y + 1) * 8 + 1));
    const float mean = hn::GetLane(hn::SumOfLanes(df, values)) / 16.0f;
    for (int y = 0; y < 4; ++y) {
      const float* w = window + (y + 1) * 8 + 1;
      const auto half = hn::Set(df, 0.5f);
      hn::Store(hn::Sub(hn::LoadU(df, w), hn::Set(df, mean)), df, patch.value.data() + 4 * y);
      hn::Store(hn::Mul(half, hn::Sub(hn::LoadU(df, w + 1), hn::LoadU(df, w - 1))), df, patch.gx.data() + 4 * y);
      hn::Store(hn::Mul(half, hn::Sub(hn::LoadU(df, w + 8), hn::LoadU(df, w - 8))), df, patch.gy.data() + 4 * y);
    }
    auto gxx = hn::Zero(dr), gxy = gxx, gyy = gxx, vv = gxx, g1x = gxx, g1y = gxx, gvx = gxx, gvy = gxx;
    for (int k = 0; k < 16; k += kLanes) {
      const auto gx = hn::Load(dr, patch.gx.data() + k), gy = hn::Load(dr, patch.gy.data() + k),
                 v = hn::Load(dr, patch.value.data() + k);
      gxx = hn::MulAdd(gx, gx, gxx);
      gxy = hn::MulAdd(gx, gy, gxy);
      gyy = hn::MulAdd(gy, gy, gyy);
      g1x = hn::Add(gx, g1x);
      g1y = hn::Add(gy, g1y);
      gvx = hn::MulAdd(gx, v, gvx);
      gvy = hn::MulAdd(gy, v, gvy);
      vv = hn::MulAdd(v, v, vv);
    }
    alignas(16) float of_gradient[4], of_value[4];
    hn::Store(sums_of_lanes(gxx, gxy, gyy, vv), df, of_gradient);
    hn::Store(sums_of_lanes(g1x, g1y, gvx, gvy), df, of_value);
    mean_[i] = mean;
    vv_[i] = of_gradient[3];
    per_value_[i] = 1.0f / (vv_[i] + kGainPrior);
    g1x_[i] = of_value[0];
    g1y_[i] = of_value[1];
    gvx_[i] = of_value[2];
    gvy_[i] = of_value[3];
    // The patch's own gain and offset are eliminated (Schur complement); its values have no mean, so that they do not
    // mix.
    const float per = per_value_[i], sixteenth = 1.0f / 16.0f;
    const float G00 = of_gradient[0] - gvx_[i] * gvx_[i] * per - g1x_[i] * g1x_[i] * sixteenth;
    const float G01 = of_gradient[1] - gvx_[i] * gvy_[i] * per - g1x_[i] * g1y_[i] * sixteenth;
    const float G11 = of_gradient[2] - gvy_[i] * gvy_[i] * per - g1y_[i] * g1y_[i] * sixteenth;
    for (int k = 0; k < 16; k += kLanes)
      hn::Store(hn::Mul(hn::Load(dr, patch.J_level_0.data() + k), hn::Set(dr, scale)), dr, patch.J.data() + k);
    // H = J^T G J. Each row is stored with two zeros that the next one writes over.
    const float* const J = patch.J.data();
    for (int row = 0; row < 6; ++row) {
      const float a = J[row] * G00 + J[8 + row] * G01, b = J[row] * G01 + J[8 + row] * G11;
      for (int k = 0; k < 8; k += kLanes)
        hn::StoreU(hn::MulAdd(hn::Set(dr, a), hn::Load(dr, J + k), hn::Mul(hn::Set(dr, b), hn::Load(dr, J + 8 + k))),
                   dr, patch.H.data() + 6 * row + k);
    }
    patch.H[38] = patch.H[39] = 0.0f;
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
      Vec3 moved = align_warp(p.cast<double>(), motion, row_time(static_cast<double>(row_[i])));
      if (shutter_.shake != nullptr)
        moved += shutter_.shake->turn(static_cast<double>(row_[i]) / camera_.height()).cross(p.cast<double>());
      for (int axis = 0; axis < 3; ++axis) p_cur_[axis][i] = static_cast<float>(moved(axis));
    }
  }
  camera_.project(patch_count_, CameraModel::Rows<float>{p_cur_[0].data(), p_cur_[1].data(), p_cur_[2].data(),
                                                         u_.data(), v_.data(), seen_.data()});
}

int SparseImageAlign::compare(const rt::ImageView& cur, int level) {
  const hn::FixedTag<float, 4> df;
  const RowTag dr;
  constexpr int kLanes = static_cast<int>(hn::MaxLanes(RowTag()));
  int used = 0;
  for (int i = 0; i < patch_count_; ++i) {
    const Patch& patch = patches_[i];
    used_[i] = 0.0f;
    if (!patch.visible || !(seen_[i] > 0.0f)) continue;
    row_[i] = std::clamp(v_[i], 0.0f, static_cast<float>(camera_.height()));
    const Vec2f px = to_level(Vec2f(u_[i], v_[i]), level);
    if (!window_inside(cur, px, kHalf, kHalf + 1)) continue;
    const auto now = sample_4x4(cur, px.x() - kHalf, px.y() - kHalf);
    const auto mean = hn::Set(dr, mean_[i]);
    auto srr = hn::Zero(dr), sgx = srr, sgy = srr, s1 = srr, sv = srr;
    for (int k = 0; k < 16 / kLanes; ++k) {
      const auto value = hn::Load(dr, patch.value.data() + k * kLanes);
      const auto r = hn::Sub(hn::Sub(now[k], mean), value);
      srr = hn::MulAdd(r, r, srr);
      sgx = hn::MulAdd(r, hn::Load(dr, patch.gx.data() + k * kLanes), sgx);
      sgy = hn::MulAdd(r, hn::Load(dr, patch.gy.data() + k * kLanes), sgy);
      s1 = hn::Add(r, s1);
      sv = hn::MulAdd(r, value, sv);
    }
    hn::StoreU(sums_of_lanes(srr, sgx, sgy, s1), df, sums_.data() + 4 * i);
    sum_v_[i] = hn::GetLane(hn::SumOfLanes(dr, sv));
    used_[i] = 1.0f;
    ++used;
  }
  return used;
}

float SparseImageAlign::weigh() {
  const RowTag d;
  const auto at = [&](const Row& row, int i) { return hn::LoadU(d, row.data() + i); };
  const auto set = [&](float value) { return hn::Set(d, value); };
  const auto zero = hn::Zero(d), one = set(1.0f), sixteenth = set(1.0f / 16.0f), huber = set(options_.huber_px);
  auto total = zero, weight_sum = zero;
  for (int i = 0; i < patch_count_; i += static_cast<int>(hn::Lanes(d))) {
    hn::Vec<RowTag> rr, rgx, rgy, r1;
    hn::LoadInterleaved4(d, sums_.data() + 4 * i, rr, rgx, rgy, r1);
    const auto used = hn::Gt(at(used_, i), zero);
    const auto rv = at(sum_v_, i), mean = at(mean_, i), vv = at(vv_, i);
    const auto offset = r1 * sixteenth, more_gain = rv * at(per_value_, i);
    const auto spread = rr - r1 * offset;
    const auto mean_square = hn::Max(spread - rv * more_gain, zero) * sixteenth;
    const auto w = hn::Min(one, huber / hn::Max(hn::Sqrt(mean_square), set(1e-6f)));
    total = total + hn::IfThenElseZero(used, w * mean_square);
    weight_sum = weight_sum + hn::IfThenElseZero(used, w);
    // The picture's gradients are the reference's times the gain: of the light, which the means tell wherever the patch
    // lies. Less contrast than that light would leave is glare or a white that took all: there is little to read there,
    // and unweighted it would hold the step back.
    const auto gain = hn::Clamp((mean + offset) / hn::Max(mean, one), set(1.0f / kMaxGain), set(kMaxGain));
    const auto variance = vv + rv + rv + spread;
    const auto information = w * hn::Clamp(variance / (gain * gain * vv + set(kNoiseVariance)), set(kLeastShare), one);
    const auto pull = information / gain;
    hn::StoreU(information, d, information_.data() + i);
    hn::StoreU(pull * (rgx - at(gvx_, i) * more_gain - at(g1x_, i) * offset), d, pull_x_.data() + i);
    hn::StoreU(pull * (rgy - at(gvy_, i) * more_gain - at(g1y_, i) * offset), d, pull_y_.data() + i);
  }
  const float weights = hn::GetLane(hn::SumOfLanes(d, weight_sum));
  return weights > 0.0f ? hn::GetLane(hn::SumOfLanes(d, total)) / weights : 0.0f;
}

int SparseImageAlign::accumulate(const rt::ImageView& cur, int level, const SE3& T_cur_ref, Mat6f* H, Vec6f* b,
                                 float* cost) {
  const RowTag d;
  constexpr int kLanes = static_cast<int>(hn::MaxLanes(RowTag()));
  warp(T_cur_ref);
  const int used = compare(cur, level);
  *cost = weigh();
  std::array<hn::Vec<RowTag>, 40 / kLanes> sum_H;
  std::array<hn::Vec<RowTag>, 8 / kLanes> sum_b;
  sum_H.fill(hn::Zero(d));
  sum_b.fill(hn::Zero(d));
  for (int i = 0; i < patch_count_; ++i) {
    if (!(used_[i] > 0.0f)) continue;
    const Patch& patch = patches_[i];
    const auto information = hn::Set(d, information_[i]);
    const auto x = hn::Set(d, pull_x_[i]), y = hn::Set(d, pull_y_[i]);
    for (int k = 0; k < 40 / kLanes; ++k)
      sum_H[k] = hn::MulAdd(information, hn::Load(d, patch.H.data() + k * kLanes), sum_H[k]);
    for (int k = 0; k < 8 / kLanes; ++k) {
      sum_b[k] = hn::MulAdd(x, hn::Load(d, patch.J.data() + k * kLanes), sum_b[k]);
      sum_b[k] = hn::MulAdd(y, hn::Load(d, patch.J.data() + 8 + k * kLanes), sum_b[k]);
    }
  }
  alignas(32) float sums[40], pulls[8];
  for (int k = 0; k < 40 / kLanes; ++k) hn::Store(sum_H[k], d, sums + k * kLanes);
  for (int k = 0; k < 8 / kLanes; ++k) hn::Store(sum_b[k], d, pulls + k * kLanes);
  *H = Eigen::Map<const Eigen::Matrix<float, 6, 6, Eigen::RowMajor>>(sums);
  *b = Eigen::Map<const Vec6f>(pulls);
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
