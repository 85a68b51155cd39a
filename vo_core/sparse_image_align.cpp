#include "vo_core/sparse_image_align.h"

#include <Eigen/Cholesky>
#include <algorithm>

#include "vo_core/align_warp.h"
#include "vo_core/patch.h"

namespace godwit::vo {
namespace {
constexpr int kHalf = 2;                 // 4x4 patch: pixels -2..+1 around the point
constexpr float kIntensityUnit = 64.0f;  // keeps gain and motion columns of the normal equations of one magnitude
constexpr float kIntensityCentre = 128.0f;
constexpr float kMinGain = 0.2f;  // as in feature_align: a picture darker than that shows no patch
}  // namespace

void SparseImageAlign::prepare(const rt::ImageView& ref, int level, std::span<const AlignPoint> points) {
  patch_count_ = static_cast<int>(std::min<std::size_t>(points.size(), patches_.size()));
  const float scale = 1.0f / static_cast<float>(1 << level);
  for (int i = 0; i < patch_count_; ++i) {
    Patch& patch = patches_[i];
    patch.visible = false;
    const Vec2f px = to_level(points[i].px, level);
    if (px.x() < kHalf + 1 || px.y() < kHalf + 1 || px.x() >= static_cast<float>(ref.width - kHalf - 3) ||
        px.y() >= static_cast<float>(ref.height - kHalf - 3))
      continue;
    Vec2 unused;
    Mat23 Jp;
    if (!camera_.project(points[i].p_ref, &unused, &Jp)) continue;
    patch.visible = true;
    patch.p_ref = points[i].p_ref;
    patch.row = static_cast<double>(points[i].px.y());
    patch.J = align_jacobian(Jp, points[i].p_ref, row_time(patch.row)).cast<float>() * scale;

    alignas(16) float window[6 * 8];  // rows of 8: the patch with a border of 1 pixel
    sample_grid(ref, px.x() - kHalf - 1, px.y() - kHalf - 1, 2, 6, window);
    float gxx = 0, gxy = 0, gyy = 0, gx1 = 0, gy1 = 0, gxi = 0, gyi = 0, si = 0, sii = 0;
    for (int y = 0; y < 4; ++y) {
      for (int x = 0; x < 4; ++x) {
        const float* w = window + (y + 1) * 8 + x + 1;
        const float gx = 0.5f * (w[1] - w[-1]), gy = 0.5f * (w[8] - w[-8]);
        const float v = (w[0] - kIntensityCentre) / kIntensityUnit;
        const int k = y * 4 + x;
        patch.value[k] = w[0];
        patch.gx[k] = gx;
        patch.gy[k] = gy;
        gxx += gx * gx;
        gxy += gx * gy;
        gyy += gy * gy;
        gx1 += gx;
        gy1 += gy;
        gxi += gx * v;
        gyi += gy * v;
        si += v;
        sii += v * v;
      }
    }
    Eigen::Matrix2f G;
    G << gxx, gxy, gxy, gyy;
    patch.H.noalias() = patch.J.transpose() * (G * patch.J).eval();
    patch.ones.noalias() = patch.J.transpose() * Vec2f(gx1, gy1);
    patch.values.noalias() = patch.J.transpose() * Vec2f(gxi, gyi);
    patch.sum_i = si;
    patch.sum_ii = sii;
  }
}

int SparseImageAlign::accumulate(const rt::ImageView& cur, int level, const SE3& T_cur_ref, float gain, float offset,
                                 MatP* H, VecP* b, float* cost) {
  const hn::FixedTag<float, 4> df;
  const auto v_gain = hn::Set(df, gain);
  const auto v_offset = hn::Set(df, offset);
  const auto v_centre = hn::Set(df, kIntensityCentre);
  H->setZero();
  b->setZero();
  float total = 0.0f, weight_sum = 0.0f;
  int used = 0;
  const Vec6 motion = shutter_.readout > 0.0 ? T_cur_ref.log() : Vec6::Zero();
  for (int i = 0; i < patch_count_; ++i) {
    Patch& patch = patches_[i];
    if (!patch.visible) continue;
    Vec2 px0;
    if (!camera_.project(align_warp(T_cur_ref, motion, patch.p_ref, row_time(patch.row)), &px0)) continue;
    patch.row = std::clamp(px0.y(), 0.0, static_cast<double>(camera_.height()));
    const Vec2f px = to_level(px0.cast<float>(), level);
    if (!(px.x() >= kHalf && px.y() >= kHalf && px.x() < static_cast<float>(cur.width - kHalf - 1) &&
          px.y() < static_cast<float>(cur.height - kHalf - 1)))
      continue;
    alignas(16) float now[16];
    sample_grid(cur, px.x() - kHalf, px.y() - kHalf, 1, 4, now);
    auto srr = hn::Zero(df), sgx = srr, sgy = srr, s1 = srr, si = srr;
    for (int k = 0; k < 16; k += 4) {
      const auto value = hn::Load(df, patch.value.data() + k);
      const auto r = hn::Sub(hn::Load(df, now + k), hn::MulAdd(v_gain, value, v_offset));
      srr = hn::MulAdd(r, r, srr);
      sgx = hn::MulAdd(r, hn::Load(df, patch.gx.data() + k), sgx);
      sgy = hn::MulAdd(r, hn::Load(df, patch.gy.data() + k), sgy);
      s1 = hn::Add(r, s1);
      si = hn::MulAdd(r, hn::Sub(value, v_centre), si);
    }
    const float mean_square = hn::GetLane(hn::SumOfLanes(df, srr)) / 16.0f;
    const float rms = std::sqrt(mean_square);
    const float w = rms <= options_.huber_px ? 1.0f : options_.huber_px / rms;
    total += w * mean_square;
    weight_sum += w;
    ++used;
    const Vec2f rg(hn::GetLane(hn::SumOfLanes(df, sgx)), hn::GetLane(hn::SumOfLanes(df, sgy)));
    H->topLeftCorner<6, 6>() += w * patch.H;
    H->block<6, 1>(0, 6) += w * patch.values;
    H->block<6, 1>(0, 7) += w * patch.ones;
    (*H)(6, 6) += w * patch.sum_ii;
    (*H)(6, 7) += w * patch.sum_i;
    (*H)(7, 7) += w * 16.0f;
    b->head<6>().noalias() += w * (patch.J.transpose() * rg);
    (*b)(6) += w * hn::GetLane(hn::SumOfLanes(df, si)) / kIntensityUnit;
    (*b)(7) += w * hn::GetLane(hn::SumOfLanes(df, s1));
  }
  H->block<1, 6>(6, 0) = H->block<6, 1>(0, 6).transpose();
  H->block<1, 6>(7, 0) = H->block<6, 1>(0, 7).transpose();
  (*H)(7, 6) = (*H)(6, 7);
  *cost = weight_sum > 0 ? total / weight_sum : 0.0f;
  return used;
}

SparseAlignResult SparseImageAlign::run(const rt::PyramidView& ref, const rt::PyramidView& cur,
                                        std::span<const AlignPoint> points, const SE3& T_init,
                                        const RotationPrior& prior, const AlignShutter& shutter) {
  SparseAlignResult result;
  shutter_ = shutter;
  SE3 T = T_init;
  float gain = 1.0f, offset = 0.0f;
  const int top = std::min(options_.max_level, ref.levels - 1);
  for (int level = top; level >= options_.min_level; --level) {
    prepare(ref.level[level], level, points);
    SE3 T_old = T;
    float gain_old = gain, offset_old = offset, cost_old = 0.0f;
    int used_old = 0;
    for (int it = 0; it < options_.max_iterations; ++it) {
      MatP H;
      VecP b;
      float cost;
      const int used = accumulate(cur.level[level], level, T, gain, offset, &H, &b, &cost);
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
        gain = gain_old;
        offset = offset_old;
        break;
      }
      result.patches = used;
      result.rms = std::sqrt(cost);
      if (used < 6) break;
      // The picture's gradients are the reference's times the gain: with the columns of the motion left as they are,
      // what is solved for is the motion times the gain.
      const float g = std::max(gain, kMinGain);
      // Gain and offset are weakly held to what they were, so that a flat picture cannot send them anywhere.
      H(6, 6) += 1.0f;
      H(7, 7) += 1.0f;
      if (prior_weight > 0.0f) {
        H.block<3, 3>(3, 3) += prior_weight / (g * g) * Eigen::Matrix3f::Identity();
        b.segment<3>(3) -= prior_weight / g * e;
      }
      VecP x = H.ldlt().solve(b);
      x.head<6>() /= g;
      if (!x.allFinite()) break;
      T_old = T;
      gain_old = gain;
      offset_old = offset;
      cost_old = cost;
      used_old = used;
      T = T * SE3::exp(-x.head<6>().cast<double>());
      const float dgain = x(6) / kIntensityUnit;
      gain += dgain;
      offset += x(7) - dgain * kIntensityCentre;
      // Converged when the step moves no pixel of this level by a noticeable part.
      const float step_px =
          x.head<6>().cwiseAbs().maxCoeff() * static_cast<float>(camera_.fx()) / static_cast<float>(1 << level);
      if (step_px < 0.03f) break;
    }
  }
  result.T_cur_ref = T;
  result.T_cur_ref.normalize();
  result.gain = gain;
  result.offset = offset;
  return result;
}

}  // namespace godwit::vo
