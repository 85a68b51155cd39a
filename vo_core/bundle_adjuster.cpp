#include "vo_core/bundle_adjuster.h"

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "vo_core/dense_cholesky.h"
#include "vo_core/residual_spread.h"

namespace godwit::vo {
namespace {

using Mat63 = Eigen::Matrix<double, 6, 3>;

}  // namespace

struct BundleAdjuster::Impl {
  struct Obs {
    Vec2 px;
    Vec2 gradient;
    double inv_sigma;
    std::int16_t pose;  // < free_count: free; else fixed
    std::uint8_t place;
    bool edgelet;
    bool used;
    std::uint16_t feature;
    Vec2f error;  // at the last linearisation, in stated sigmas
    Mat63 Hpl;
  };
  struct Point {
    int index;
    int first, count;  // observations
    Vec3 p, p_new;
    Mat3 H, H_inv;
    Vec3 b;
  };

  Impl(const CameraModel& c, const BundleAdjusterOptions& o) : camera(c), options(o) {}

  const CameraModel& camera;
  BundleAdjusterOptions options;
  int pose_count = 0, free_count = 0, point_count = 0, obs_count = 0, outlier_count = 0;
  std::array<int, kMaxKeyframes> pose_place;
  std::array<SE3, kMaxKeyframes> pose, pose_new;
  std::array<int, kMaxKeyframes> place_pose;
  std::array<int, kMaxKeyframes> shared;
  std::array<Point, kMaxPoints_> points;
  std::array<Obs, kMaxObservations> obs;
  std::array<Observation, kMaxOutliers> outliers;
  std::array<std::uint16_t, kMaxPoints> point_mark;
  std::array<ResidualSpread, kMaxKeyframes> band;  // by pose
  std::array<Mat6, kMaxFree> Hpp;
  std::array<Vec6, kMaxFree> bp;
  static constexpr int kDim = 6 * kMaxFree;
  alignas(32) std::array<double, kDim * kDim> S;
  alignas(32) std::array<double, kDim> rhs;

  void select(Map* map, int centre) {
    shared.fill(0);
    const Keyframe& kf = map->keyframe(centre);
    for (int f = 0; f < kf.feature_count; ++f) {
      const MapPoint* p = map->find(kf.features[f].point);
      if (!p) continue;
      for (int i = 0; i < p->observation_count; ++i) ++shared[p->observations[i].keyframe];
    }
    std::array<std::pair<int, int>, kMaxKeyframes> order;
    int n = 0;
    for (int k = 0; k < kMaxKeyframes; ++k)
      if (k != centre && map->keyframe(k).id > 1 && shared[k] >= 10) order[n++] = {-shared[k], k};
    std::sort(order.begin(), order.begin() + n);
    place_pose.fill(-1);
    pose_count = 0;
    const auto add_pose = [&](int place) {
      place_pose[place] = pose_count;
      pose_place[pose_count] = place;
      pose[pose_count++] = map->keyframe(place).T_kf_world;
    };
    const int max_free = std::min(options.max_free_keyframes, kMaxFree);
    if (kf.id > 1) add_pose(centre);
    for (int i = 0; i < n && pose_count < max_free; ++i) add_pose(order[i].second);
    free_count = pose_count;

    point_mark.fill(0);
    point_count = obs_count = 0;
    for (int f = 0; f < free_count; ++f) {
      const Keyframe& k = map->keyframe(pose_place[f]);
      for (int i = 0; i < k.feature_count; ++i) {
        const PointHandle h = k.features[i].point;
        const MapPoint* p = map->find(h);
        if (!p || point_mark[h.index] || p->observation_count < 2) continue;
        if (point_count >= kMaxPoints_ || obs_count + p->observation_count > kMaxObservations) continue;
        point_mark[h.index] = 1;
        Point& q = points[point_count++];
        q.index = h.index;
        q.first = obs_count;
        q.count = p->observation_count;
        q.p = p->p_world;
        for (int j = 0; j < p->observation_count; ++j) {
          const Observation& o = p->observations[j];
          if (place_pose[o.keyframe] < 0) add_pose(o.keyframe);
          const KeyframeFeature& feature = map->keyframe(o.keyframe).features[o.feature];
          Obs& out = obs[obs_count++];
          out.px = feature.px_global.cast<double>();
          out.gradient = feature.gradient.cast<double>();
          out.inv_sigma = 1.0 / (1 << feature.level);
          out.pose = static_cast<std::int16_t>(place_pose[o.keyframe]);
          out.place = o.keyframe;
          out.feature = o.feature;
          out.edgelet = feature.type == FeatureType::kEdgelet;
        }
      }
    }
  }

  // Weighted residual and Jacobian factors of one observation. rho' is returned as the weight.
  double residual(const Obs& o, const SE3& T, const Vec3& p, Vec2* r, Mat23* J, Vec3* p_cam) const {
    *p_cam = T * p;
    Vec2 px;
    if (!camera.project(*p_cam, &px, J)) return -1.0;
    *r = (o.px - px) * o.inv_sigma;
    if (J) *J *= o.inv_sigma;
    if (o.edgelet) {
      *r = Vec2(o.gradient.dot(*r), 0.0);
      if (J) {
        J->row(0) = o.gradient.transpose() * *J;
        J->row(1).setZero();
      }
    }
    return r->norm();
  }

  double cost(const std::array<SE3, kMaxKeyframes>& poses, bool fresh) const {
    const double h = options.huber_px;
    double sum = 0.0;
    for (int i = 0; i < point_count; ++i) {
      const Point& q = points[i];
      const Vec3& p = fresh ? q.p_new : q.p;
      for (int j = q.first; j < q.first + q.count; ++j) {
        Vec2 r;
        Vec3 pc;
        const double e = residual(obs[j], poses[obs[j].pose], p, &r, nullptr, &pc);
        if (e < 0.0)
          sum += 2.0 * h * 20.0;
        else
          sum += e <= h ? e * e : 2.0 * h * e - h * h;
      }
    }
    return sum;
  }

  double linearize() {
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
        Mat23 Jp;
        Vec3 pc;
        const double e = residual(o, pose[o.pose], q.p, &r, &Jp, &pc);
        o.used = e >= 0.0;
        if (!o.used) {
          sum += 2.0 * h * 20.0;
          continue;
        }
        o.error = r.cast<float>();
        const double w = e <= h ? 1.0 : h / e;
        sum += e <= h ? e * e : 2.0 * h * e - h * h;
        // Prediction's Jacobians: for the point, and for the left twist of the pose.
        const Mat23 Jl = Jp * pose[o.pose].R;
        q.H.noalias() += w * (Jl.transpose() * Jl);
        q.b.noalias() += w * (Jl.transpose() * r);
        if (o.pose < free_count) {
          Mat26 Jx;
          Jx.leftCols<3>() = Jp;
          Jx.rightCols<3>() = -Jp * skew(pc);
          Hpp[o.pose].noalias() += w * (Jx.transpose() * Jx);
          bp[o.pose].noalias() += w * (Jx.transpose() * r);
          o.Hpl.noalias() = w * (Jx.transpose() * Jl);
        }
      }
    }
    return sum;
  }

  // Variance of an observation in units of its stated one, as the residuals show it (residual_spread.h), with what
  // neighbours have in common.
  double noise_variance() {
    ResidualSpread all;
    band.fill(ResidualSpread{});
    for (int i = 0; i < obs_count; ++i) {
      const Obs& o = obs[i];
      if (!o.used) continue;
      const Vec2 r = o.error.cast<double>();
      const double e = r.norm(), w = e <= options.huber_px ? 1.0 : options.huber_px / e;
      // Beyond the limit psi has one length: it changes with the direction only.
      const double slope = e <= options.huber_px ? 1.0 : o.edgelet ? 0.0 : 0.5 * w;
      all.add(w * r, slope, o.edgelet ? 1 : 2, 0.0);
      if (!o.edgelet) band[o.pose].add(w * r, slope, 2, o.px.y() / camera.height());
    }
    double sums = 0.0, squares = 0.0;
    for (int f = 0; f < pose_count; ++f) {
      band[f].close_picture();
      sums += band[f].band_sum_square();
      squares += band[f].band_square();
    }
    const double variance = all.variance(3 * point_count + 6 * free_count);
    return (variance > 0.0 ? variance : 1.0) * ResidualSpread::design_effect(sums, squares);
  }

  // One camera does not know how large the world is. What is said here is said in the map's own units, so the mode that
  // scales everything about the centre gets the information of a known scale.
  void hold_scale() {
    constexpr double kSigma = 1e-3;
    const Vec3 centre = -(pose[0].R.transpose() * pose[0].t);
    Eigen::Map<Eigen::VectorXd> mode(rhs.data(), 6 * free_count);
    for (int f = 0; f < free_count; ++f) {
      mode.segment<3>(6 * f) = pose[f] * centre;
      mode.segment<3>(6 * f + 3).setZero();
    }
    const double norm2 = mode.squaredNorm();
    if (!(norm2 > 1e-12)) return;
    const double information = 1.0 / (kSigma * kSigma * norm2 * norm2);
    for (int r = 0; r < 6 * free_count; ++r)
      for (int c = 0; c <= r; ++c) S[static_cast<std::size_t>(r * kDim + c)] += information * mode(r) * mode(c);
  }

  // Schur complement over the points, damped by lambda, into S and rhs.
  void eliminate_points(double lambda) {
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

  bool solve(double lambda) {
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
};

BundleAdjuster::BundleAdjuster(const CameraModel& camera, const BundleAdjusterOptions& options)
    : impl_(std::make_unique<Impl>(camera, options)) {}
BundleAdjuster::~BundleAdjuster() = default;

BundleReport BundleAdjuster::run(Map* map, int centre) {
  Impl& s = *impl_;
  BundleReport report;
  s.outlier_count = 0;
  s.select(map, centre);
  report.free_keyframes = s.free_count;
  report.fixed_keyframes = s.pose_count - s.free_count;
  report.points = s.point_count;
  report.observations = s.obs_count;
  if (s.free_count == 0 || s.obs_count < 30) {
    s.free_count = s.point_count = 0;
    return report;
  }
  double lambda = 1e-4;
  double current = s.linearize();
  report.rms_before_px = std::sqrt(current / s.obs_count);
  for (int it = 0; it < s.options.max_iterations; ++it) {
    ++report.iterations;
    const bool solved = s.solve(lambda);
    const double next = solved ? s.cost(s.pose_new, true) : current;
    if (solved && next < current) {
      const double gain = (current - next) / current;
      s.pose = s.pose_new;
      for (int i = 0; i < s.point_count; ++i) s.points[i].p = s.points[i].p_new;
      current = next;
      lambda = std::max(lambda * 0.1, 1e-9);
      if (gain < 1e-3 || it + 1 == s.options.max_iterations) break;
      s.linearize();
    } else {
      lambda = std::min(lambda * 10.0, 1e3);
    }
  }
  report.rms_after_px = std::sqrt(current / s.obs_count);

  for (int f = 0; f < s.free_count; ++f) map->keyframe(s.pose_place[f]).T_kf_world = s.pose[f];
  for (int i = 0; i < s.point_count; ++i) {
    const Impl::Point& q = s.points[i];
    map->point(q.index).p_world = q.p;
    for (int j = q.first; j < q.first + q.count; ++j) {
      const Impl::Obs& o = s.obs[j];
      Vec2 r;
      Vec3 pc;
      const double e = s.residual(o, s.pose[o.pose], q.p, &r, nullptr, &pc);
      if ((e < 0.0 || e > s.options.outlier_px) && s.outlier_count < kMaxOutliers)
        s.outliers[s.outlier_count++] = {o.place, o.feature};
    }
  }
  report.outliers = s.outlier_count;
  return report;
}

void BundleAdjuster::shares(const Map& map, MapShares* out) {
  Impl& s = *impl_;
  out->centre = 0;
  out->count = 0;
  const int n = 6 * s.free_count;
  if (n == 0) return;
  s.linearize();
  const double variance = s.noise_variance();
  const Mat6 H_centre = s.Hpp[0];
  s.eliminate_points(0.0);
  // Where no keyframe was held, one must be: only what is relative counts.
  if (s.pose_count == s.free_count && s.free_count > 1)
    for (int i = n - 6; i < n; ++i) s.S[i * Impl::kDim + i] += 1e8;
  s.hold_scale();
  if (!cholesky_factor(s.S.data(), n, Impl::kDim)) return;
  cholesky_invert_factor(s.S.data(), n, Impl::kDim);
  const auto block = [&](int a, int b) { return cholesky_inverse_block<6>(s.S.data(), n, Impl::kDim, 6 * a, 6 * b); };
  const Mat6 own = Eigen::LDLT<Mat6>(H_centre).solve(Mat6::Identity());
  const Mat6 C_centre = block(0, 0);
  const auto add = [&](int place, const Mat6& share) {
    if (out->count < MapShares::kMax && share.allFinite())
      out->share[static_cast<std::size_t>(out->count++)] = {map.keyframe(place).id, variance * share};
  };
  add(s.pose_place[0], own);
  for (int f = 1; f < s.pose_count; ++f) {
    if (f >= s.free_count) {
      if (map.keyframe(s.pose_place[f]).id == 1) add(s.pose_place[f], C_centre - own);
      continue;
    }
    // exp(x_0) T_0 (exp(x_f) T_f)^-1 = exp(x_0 - Ad x_f) T_0f.
    const Mat6 ad = adjoint(s.pose[0] * s.pose[f].inverse());
    const Mat6 cross = block(0, f) * ad.transpose();
    add(s.pose_place[f], C_centre - cross - cross.transpose() + ad * block(f, f) * ad.transpose() - own);
  }
  out->centre = map.keyframe(s.pose_place[0]).id;
}

int BundleAdjuster::moved_keyframe_count() const {
  return impl_->free_count;
}
int BundleAdjuster::moved_keyframe(int i) const {
  return impl_->pose_place[i];
}
int BundleAdjuster::moved_point_count() const {
  return impl_->point_count;
}
int BundleAdjuster::moved_point(int i) const {
  return impl_->points[i].index;
}
int BundleAdjuster::outlier_count() const {
  return impl_->outlier_count;
}
Observation BundleAdjuster::outlier(int i) const {
  return impl_->outliers[i];
}

}  // namespace godwit::vo
