#include "vo_core/geometry/two_view_geometry.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "vo_core/geometry/fundamental.h"
#include "vo_core/geometry/homography.h"

namespace godwit::vo {
namespace {

// Cuts of the symmetric transfer error at 95 %: two degrees of freedom for a point, one for a line. Both scores start
// from the point's cut, so that they can be compared (TRO 2015, equation 2).
constexpr double kCutHomography = 5.99;
constexpr double kCutFundamental = 3.84;
constexpr double kGamma = 5.99;
/// |t| / plane distance below which a homography counts as a rotation.
constexpr double kMinTranslation = 1e-4;
/// Fits to all inliers of a sample's model that leads.
constexpr int kRefits = 3;

/// SplitMix64 (Steele, Lea, Flood, OOPSLA 2014).
struct Random {
  std::uint64_t state = 20240724;
  std::uint32_t below(std::uint32_t n) {
    state += 0x9e3779b97f4a7c15ULL;
    std::uint64_t z = state;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebULL;
    z ^= z >> 31;
    return static_cast<std::uint32_t>(((z >> 32) * n) >> 32);
  }
};

}  // namespace

bool triangulate_inverse_depth(const SE3& T_b_a, const Vec2& a, const Vec2& b, double* inverse_depth) {
  // The point is (q + rho t) up to scale, q = R (a, 1). b's two equations are linear in rho.
  const Vec3 q = T_b_a.R * Vec3(a.x(), a.y(), 1.0);
  const Vec3& t = T_b_a.t;
  const Vec2 slope(t.x() - b.x() * t.z(), t.y() - b.y() * t.z());
  const Vec2 rest(b.x() * q.z() - q.x(), b.y() * q.z() - q.y());
  const double n = slope.squaredNorm();
  if (!(n > 1e-16)) return false;
  *inverse_depth = slope.dot(rest) / n;
  return true;
}

struct TwoViewGeometry::Impl {
  TwoViewOptions options;
  std::array<float, kMaxPoints> ax, ay, bx, by;
  std::array<float, kMaxPoints> gain;
  std::array<int, kMaxPoints> index, inliers_h, inliers_f;
  int n = 0;

  /// Symmetric transfer score of H; the contributions stay in gain (0: outlier).
  double score_homography(const Mat3& H) {
    const Mat3 Hi = H.inverse();
    if (!Hi.allFinite()) return 0;
    const Eigen::Matrix3f h = H.cast<float>(), g = (Hi / Hi.cwiseAbs().maxCoeff()).cast<float>();
    const float inv_var = static_cast<float>(1.0 / (options.sigma_px * options.sigma_px));
    const float cut = static_cast<float>(kCutHomography), gamma = static_cast<float>(kGamma);
    const auto error = [inv_var](const Eigen::Matrix3f& m, float x, float y, float u, float v) {
      const float w = 1.0f / (m(2, 0) * x + m(2, 1) * y + m(2, 2));
      const float dx = (m(0, 0) * x + m(0, 1) * y + m(0, 2)) * w - u;
      const float dy = (m(1, 0) * x + m(1, 1) * y + m(1, 2)) * w - v;
      return (dx * dx + dy * dy) * inv_var;
    };
    for (int i = 0; i < n; ++i) {
      const float e1 = error(h, ax[i], ay[i], bx[i], by[i]), e2 = error(g, bx[i], by[i], ax[i], ay[i]);
      gain[i] = e1 < cut && e2 < cut ? (gamma - e1) + (gamma - e2) : 0.0f;
    }
    return total();
  }

  /// The same for F, by the distance to the epipolar lines.
  double score_fundamental(const Mat3& F) {
    const Eigen::Matrix3f f = F.cast<float>(), g = F.transpose().cast<float>();
    const float inv_var = static_cast<float>(1.0 / (options.sigma_px * options.sigma_px));
    const float cut = static_cast<float>(kCutFundamental), gamma = static_cast<float>(kGamma);
    const auto error = [inv_var](const Eigen::Matrix3f& m, float x, float y, float u, float v) {
      const float lx = m(0, 0) * x + m(0, 1) * y + m(0, 2);
      const float ly = m(1, 0) * x + m(1, 1) * y + m(1, 2);
      const float lz = m(2, 0) * x + m(2, 1) * y + m(2, 2);
      const float d = lx * u + ly * v + lz;
      return d * d / (lx * lx + ly * ly + 1e-30f) * inv_var;
    };
    for (int i = 0; i < n; ++i) {
      const float e1 = error(f, ax[i], ay[i], bx[i], by[i]), e2 = error(g, bx[i], by[i], ax[i], ay[i]);
      gain[i] = e1 < cut && e2 < cut ? (gamma - e1) + (gamma - e2) : 0.0f;
    }
    return total();
  }

  /// Fits to all inliers, and again to the inliers of that, while it helps: a minimal sample's model carries the noise
  /// of few points (locally optimised RANSAC; Chum, Matas, Kittler, DAGM 2003).
  void refit_homography(std::span<const Vec2> a, std::span<const Vec2> b, Mat3* H, double* score) {
    Mat3 model;
    for (int round = 0; round < kRefits; ++round) {
      score_homography(*H);
      if (!homography_from_points(a, b, collect(&inliers_h), &model)) return;
      const double s = score_homography(model);
      if (!(s > *score)) return;
      *score = s;
      *H = model;
    }
  }

  void refit_fundamental(std::span<const Vec2> a, std::span<const Vec2> b, Mat3* F, double* score) {
    Mat3 model;
    for (int round = 0; round < kRefits; ++round) {
      score_fundamental(*F);
      if (!fundamental_from_points(a, b, collect(&inliers_f), &model)) return;
      const double s = score_fundamental(model);
      if (!(s > *score)) return;
      *score = s;
      *F = model;
    }
  }

  double total() const {
    double s = 0;
    for (int i = 0; i < n; ++i) s += static_cast<double>(gain[i]);
    return s;
  }

  std::span<const int> collect(std::array<int, kMaxPoints>* out) const {
    std::size_t count = 0;
    for (int i = 0; i < n; ++i)
      if (gain[i] > 0.0f) (*out)[count++] = i;
    return {out->data(), count};
  }

  /// Sorts the motions by how many of the points lie in front of both cameras and appends the best two.
  void append(std::span<TwoViewCandidate> motions, std::span<const int> inliers, std::span<const Vec2> a,
              std::span<const Vec2> b, double focal_px, TwoViewResult* result) const {
    for (TwoViewCandidate& c : motions) {
      for (int i : inliers) {
        const Vec2 p = a[i] / focal_px, q = b[i] / focal_px;
        double inverse_depth = 0;
        if (!triangulate_inverse_depth(c.T_b_a, p, q, &inverse_depth) || inverse_depth <= 0) continue;
        const Vec3 in_b = c.T_b_a.R * Vec3(p.x(), p.y(), 1.0) + inverse_depth * c.T_b_a.t;
        if (in_b.z() > 0) ++c.in_front;
      }
    }
    // std::stable_sort may allocate; four elements do not need it.
    for (std::size_t i = 1; i < motions.size(); ++i)
      for (std::size_t j = i; j > 0 && motions[j].in_front > motions[j - 1].in_front; --j)
        std::swap(motions[j], motions[j - 1]);
    for (std::size_t i = 0; i < std::min<std::size_t>(2, motions.size()); ++i) {
      if (motions[i].in_front > 0) result->candidates[result->candidate_count++] = motions[i];
    }
  }
};

TwoViewGeometry::TwoViewGeometry(const TwoViewOptions& options) : impl_(std::make_unique<Impl>()) {
  impl_->options = options;
}
TwoViewGeometry::~TwoViewGeometry() = default;

TwoViewResult TwoViewGeometry::estimate(std::span<const Vec2> a, std::span<const Vec2> b, double focal_px) {
  Impl& m = *impl_;
  TwoViewResult result;
  m.n = static_cast<int>(std::min<std::size_t>({a.size(), b.size(), kMaxPoints}));
  if (m.n < 8) return result;
  for (int i = 0; i < m.n; ++i) {
    m.ax[i] = static_cast<float>(a[i].x());
    m.ay[i] = static_cast<float>(a[i].y());
    m.bx[i] = static_cast<float>(b[i].x());
    m.by[i] = static_cast<float>(b[i].y());
    m.index[i] = i;
  }

  Random random;
  Mat3 best_h = Mat3::Identity(), best_f = Mat3::Zero();
  for (int iteration = 0; iteration < m.options.iterations; ++iteration) {
    for (int k = 0; k < 8; ++k) {  // the first eight places of a partial Fisher-Yates shuffle
      const std::size_t other = k + random.below(static_cast<std::uint32_t>(m.n - k));
      std::swap(m.index[k], m.index[other]);
    }
    Mat3 model;
    if (homography_from_points(a, b, {m.index.data(), 4}, &model)) {
      if (const double score = m.score_homography(model); score > result.score_homography) {
        result.score_homography = score;
        best_h = model;
        m.refit_homography(a, b, &best_h, &result.score_homography);
      }
    }
    if (fundamental_from_points(a, b, {m.index.data(), 8}, &model)) {
      if (const double score = m.score_fundamental(model); score > result.score_fundamental) {
        result.score_fundamental = score;
        best_f = model;
        m.refit_fundamental(a, b, &best_f, &result.score_fundamental);
      }
    }
  }
  const double sum = result.score_homography + result.score_fundamental;
  if (!(sum > 0)) return result;
  result.ratio_homography = result.score_homography / sum;
  result.model =
      result.ratio_homography > m.options.homography_ratio ? InitModel::kHomography : InitModel::kFundamental;

  m.score_homography(best_h);
  const auto inliers_h = m.collect(&m.inliers_h);
  m.score_fundamental(best_f);
  const auto inliers_f = m.collect(&m.inliers_f);
  result.inliers = static_cast<int>(result.model == InitModel::kHomography ? inliers_h.size() : inliers_f.size());

  std::array<TwoViewCandidate, 4> from_h, from_f;
  std::size_t count_h = 0;
  if (!inliers_h.empty()) {
    // Into normalised image planes, and the sign that keeps the plane in front of both cameras.
    Mat3 H = best_h;
    H.topRightCorner<2, 1>() /= focal_px;
    H.bottomLeftCorner<1, 2>() *= focal_px;
    double side = 0;
    for (int i : inliers_h) {
      const Vec2 p = a[i] / focal_px, q = b[i] / focal_px;
      side += Vec3(q.x(), q.y(), 1.0).dot(H * Vec3(p.x(), p.y(), 1.0)) > 0 ? 1.0 : -1.0;
    }
    std::array<PlaneMotion, 4> motions;
    const int count = decompose_homography(side < 0 ? Mat3(-H) : H, kMinTranslation, &motions);
    for (int k = 0; k < count; ++k) {
      const PlaneMotion& motion = motions[k];
      from_h[count_h++] = {SE3(motion.T_b_a.R, motion.T_b_a.t.normalized()), InitModel::kHomography, 0};
    }
  }
  if (!inliers_f.empty()) {
    Mat3 E = best_f;
    E.topLeftCorner<2, 2>() *= focal_px * focal_px;
    E.topRightCorner<2, 1>() *= focal_px;
    E.bottomLeftCorner<1, 2>() *= focal_px;
    const auto motions = decompose_essential(E);
    for (std::size_t k = 0; k < 4; ++k) from_f[k] = {motions[k], InitModel::kFundamental, 0};
  }
  const std::span<TwoViewCandidate> span_h(from_h.data(), count_h);
  const std::span<TwoViewCandidate> span_f(from_f.data(), inliers_f.empty() ? 0 : 4);
  if (result.model == InitModel::kHomography) {
    m.append(span_h, inliers_h, a, b, focal_px, &result);
    m.append(span_f, inliers_f, a, b, focal_px, &result);
  } else {
    m.append(span_f, inliers_f, a, b, focal_px, &result);
    m.append(span_h, inliers_h, a, b, focal_px, &result);
  }
  return result;
}

}  // namespace godwit::vo
