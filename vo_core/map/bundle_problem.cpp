#include "vo_core/map/bundle_problem.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "vo_core/geometry/dense_cholesky.h"

namespace godwit::vo {

void BundleProblem::select(const Map& map, int centre) {
  shared.fill(0);
  const Keyframe& kf = map.keyframe(centre);
  for (int f = 0; f < kf.feature_count; ++f) {
    const MapPoint* p = map.find(kf.features[f].point);
    if (!p) continue;
    for (int i = 0; i < p->observation_count; ++i) ++shared[p->observations[i].keyframe];
  }
  std::array<std::pair<int, int>, kMaxKeyframes> order;
  int n = 0;
  for (int k = 0; k < kMaxKeyframes; ++k)
    if (k != centre && map.keyframe(k).id > 1 && shared[k] >= 10) order[n++] = {-shared[k], k};
  std::sort(order.begin(), order.begin() + n);
  place_pose.fill(-1);
  pose_count = 0;
  const auto add_pose = [&](int place) {
    place_pose[place] = pose_count;
    pose_place[pose_count] = place;
    pose[pose_count++] = map.keyframe(place).T_kf_world;
  };
  const int max_free = std::min(options.max_free_keyframes, kMaxFree);
  if (kf.id > 1) add_pose(centre);
  for (int i = 0; i < n && pose_count < max_free; ++i) add_pose(order[i].second);
  free_count = pose_count;

  point_mark.fill(0);
  point_count = obs_count = 0;
  for (int f = 0; f < free_count; ++f) {
    const Keyframe& k = map.keyframe(pose_place[f]);
    for (int i = 0; i < k.feature_count; ++i) {
      const PointHandle h = k.features[i].point;
      const MapPoint* p = map.find(h);
      if (!p || point_mark[h.index] || p->observation_count < 2) continue;
      if (point_count >= BundleAdjuster::kMaxBundlePoints ||
          obs_count + p->observation_count > BundleAdjuster::kMaxObservations)
        continue;
      point_mark[h.index] = 1;
      Point& q = points[point_count++];
      q.index = h.index;
      q.first = obs_count;
      q.count = p->observation_count;
      q.p = p->p_world;
      for (int j = 0; j < p->observation_count; ++j) {
        const Observation& o = p->observations[j];
        if (place_pose[o.keyframe] < 0) add_pose(o.keyframe);
        const KeyframeFeature& feature = map.keyframe(o.keyframe).features[o.feature];
        Obs& out = obs[obs_count++];
        out.seen = {feature.px_global.cast<double>(), feature.gradient.cast<double>(), 1.0 / (1 << feature.level),
                    feature.type == FeatureType::kEdgelet};
        out.pose = static_cast<std::int16_t>(place_pose[o.keyframe]);
        out.place = o.keyframe;
        out.feature = o.feature;
      }
    }
  }
}

double BundleProblem::cost(const std::array<SE3, kMaxKeyframes>& poses, bool fresh) const {
  const double h = options.huber_px;
  double sum = 0.0;
  for (int i = 0; i < point_count; ++i) {
    const Point& q = points[i];
    const Vec3& p = fresh ? q.p_new : q.p;
    for (int j = q.first; j < q.first + q.count; ++j) {
      Vec2 r;
      if (!reprojection_residual(camera, obs[j].seen, poses[obs[j].pose], p, &r)) {
        sum += 2.0 * h * 20.0;
        continue;
      }
      const double e = r.norm();
      sum += e <= h ? e * e : 2.0 * h * e - h * h;
    }
  }
  return sum;
}

double BundleProblem::linearize() {
  const double h = options.huber_px;
  double sum = 0.0;
  for (int f = 0; f < free_count; ++f) {
    Hpp[f].setZero();
    bp[f].setZero();
  }
  for (int i = 0; i < point_count; ++i) {
    Point& q = points[i];
    q.H.setZero();
    q.b.setZero();
    for (int j = q.first; j < q.first + q.count; ++j) {
      Obs& o = obs[j];
      Vec2 r;
      Mat23 Jl;  // of the prediction: by the point, and by the left twist of the pose
      Mat26 Jx;
      const bool free = o.pose < free_count;
      o.used = reprojection_residual(camera, o.seen, pose[o.pose], q.p, &r, &Jl, free ? &Jx : nullptr);
      if (!o.used) {
        sum += 2.0 * h * 20.0;
        continue;
      }
      o.error = r.cast<float>();
      const double e = r.norm();
      const double w = e <= h ? 1.0 : h / e;
      sum += e <= h ? e * e : 2.0 * h * e - h * h;
      q.H.noalias() += w * (Jl.transpose() * Jl);
      q.b.noalias() += w * (Jl.transpose() * r);
      if (free) {
        Hpp[o.pose].noalias() += w * (Jx.transpose() * Jx);
        o.b.noalias() = w * (Jx.transpose() * r);
        bp[o.pose] += o.b;
        o.Hpl.noalias() = w * (Jx.transpose() * Jl);
      }
    }
  }
  return sum;
}

void BundleProblem::eliminate_points(double lambda) {
  const int n = 6 * free_count;
  for (int i = 0; i < n; ++i) std::fill_n(&S[i * kDim], n, 0.0);
  for (int f = 0; f < free_count; ++f) {
    Mat6 H = Hpp[f];
    H.diagonal() += lambda * H.diagonal() + Vec6::Constant(1e-6);
    for (int r = 0; r < 6; ++r)
      for (int c = 0; c < 6; ++c) S[(6 * f + r) * kDim + 6 * f + c] = H(r, c);
    for (int r = 0; r < 6; ++r) rhs[6 * f + r] = bp[f](r);
  }
  for (int i = 0; i < point_count; ++i) {
    Point& q = points[i];
    Mat3 H = q.H;
    H.diagonal() += lambda * H.diagonal() + Vec3::Constant(1e-9);
    bool ok = false;
    H.computeInverseWithCheck(q.H_inv, ok, 1e-30);
    if (!ok) q.H_inv.setZero();
    const Vec3 hb = q.H_inv * q.b;
    for (int j = q.first; j < q.first + q.count; ++j) {
      const Obs& a = obs[j];
      if (!a.used || a.pose >= free_count) continue;
      const Mat63 Ya = a.Hpl * q.H_inv;
      const int ra = 6 * a.pose;
      const Vec6 rb = a.Hpl * hb;
      for (int r = 0; r < 6; ++r) rhs[ra + r] -= rb(r);
      for (int k = q.first; k < q.first + q.count; ++k) {
        const Obs& b = obs[k];
        if (!b.used || b.pose > a.pose) continue;  // lower triangle (free poses have the smaller numbers)
        const Mat6 B = Ya * b.Hpl.transpose();
        double* out = &S[ra * kDim + 6 * b.pose];
        for (int r = 0; r < 6; ++r, out += kDim)
          for (int c = 0; c < 6; ++c) out[c] -= B(r, c);
      }
    }
  }
}

bool BundleProblem::solve(double lambda) {
  const int n = 6 * free_count;
  eliminate_points(lambda);
  if (!cholesky_factor(S.data(), n, kDim)) return false;
  cholesky_substitute(S.data(), n, kDim, rhs.data());
  for (int f = 0; f < pose_count; ++f) {
    if (f < free_count) {
      const Vec6 dx = Eigen::Map<const Vec6>(&rhs[6 * f]);
      if (!dx.allFinite()) return false;
      pose_new[f] = SE3::exp(dx) * pose[f];
      pose_new[f].normalize();
    } else {
      pose_new[f] = pose[f];
    }
  }
  for (int i = 0; i < point_count; ++i) {
    Point& q = points[i];
    Vec3 b = q.b;
    for (int j = q.first; j < q.first + q.count; ++j) {
      const Obs& o = obs[j];
      if (!o.used || o.pose >= free_count) continue;
      b.noalias() -= o.Hpl.transpose() * Eigen::Map<const Vec6>(&rhs[6 * o.pose]);
    }
    q.p_new = q.p + q.H_inv * b;
  }
  return true;
}

}  // namespace godwit::vo
