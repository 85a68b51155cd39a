#include "vo_core/map/matcher.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <hwy/cache_control.h>

#include "vo_core/image/patch.h"

namespace godwit::vo {
namespace {

constexpr int kAlignIterations = 8;
constexpr float kMaxShiftPx = 4.0f;    // on the search level
constexpr float kMaxResidual = 0.85f;  // residual over contrast: zero-mean correlation of about 0.6
constexpr float kMaxResidualSeed = 0.60f;

// The pixels of a reference patch, from its point.
constexpr int kBorderPixels = kPatchBorderSize * kPatchBorderSize;
struct PatchPlaces {
  std::array<float, kBorderPixels> x{}, y{};
};
constexpr PatchPlaces patch_places() {
  PatchPlaces places;
  for (int k = 0; k < kBorderPixels; ++k) {
    places.x[k] = static_cast<float>(k % kPatchBorderSize - kPatchHalf - 1);
    places.y[k] = static_cast<float>(k / kPatchBorderSize - kPatchHalf - 1);
  }
  return places;
}
constexpr PatchPlaces kPatchPlaces = patch_places();

// Zero-mean sum of squared differences between 8-bit patches; `ref` row-major 8x8.
struct ZeroMeanPatch {
  alignas(16) std::array<std::uint8_t, 64> pixel;
  int sum = 0, sum_sq = 0;

  explicit ZeroMeanPatch(const ReferencePatch& ref) {
    for (int y = 0; y < kPatchSize; ++y)
      for (int x = 0; x < kPatchSize; ++x) {
        const float v = std::clamp(ref.value[(y + 1) * kPatchBorderSize + x + 1], 0.0f, 255.0f);
        const int i = static_cast<int>(v + 0.5f);
        pixel[y * 8 + x] = static_cast<std::uint8_t>(i);
        sum += i;
        sum_sq += i * i;
      }
  }

  int score(const std::uint8_t* p, int stride) const {
    // Two rows a vector where it holds them.
    const hn::CappedTag<std::int16_t, 16> di16;
    const hn::Rebind<std::uint8_t, decltype(di16)> du8;
    const hn::RepartitionToWide<decltype(di16)> di32;
    constexpr int kRows = static_cast<int>(hn::MaxLanes(di16)) / 8;
    auto ab = hn::Zero(di32), bb = ab, b1 = ab, ab_odd = ab, bb_odd = ab, b1_odd = ab;
    const auto one = hn::Set(di16, std::int16_t{1});
    for (int y = 0; y < 8; y += kRows, p += kRows * static_cast<std::ptrdiff_t>(stride)) {
      const auto a = hn::PromoteTo(di16, hn::Load(du8, pixel.data() + 8 * y));
      const auto b = hn::PromoteTo(di16, load_rows(du8, p, stride));
      ab = hn::ReorderWidenMulAccumulate(di32, a, b, ab, ab_odd);
      bb = hn::ReorderWidenMulAccumulate(di32, b, b, bb, bb_odd);
      b1 = hn::ReorderWidenMulAccumulate(di32, b, one, b1, b1_odd);
    }
    const auto sum_of = [&](auto even, auto odd) { return hn::GetLane(hn::SumOfLanes(di32, hn::Add(even, odd))); };
    const int sab = sum_of(ab, ab_odd), sbb = sum_of(bb, bb_odd), sb = sum_of(b1, b1_odd);
    return sum_sq - 2 * sab + sbb - (sum * sum - 2 * sum * sb + sb * sb) / 64;
  }

  /// As many rows of eight pixels as D has room for.
  template <typename D>
  static hn::Vec<D> load_rows(D d, const std::uint8_t* p, int stride) {
    if constexpr (hn::MaxLanes(D()) == 16) {
      const hn::Half<D> half;
      return hn::Combine(d, hn::LoadU(half, p + stride), hn::LoadU(half, p));
    } else {
      return hn::LoadU(d, p);
    }
  }
};

constexpr int kMaxZmssd = 64 * 900;  // mean squared difference of 30 grey levels squared

/// Where the steps of an epipolar search fall in the picture, several at a time. They are even on the unit sphere's
/// chord between the first ray and the last, which is near enough to even in the picture.
struct EpipolarPlaces {
  using Row = std::array<double, CameraModel::row_room(kMaxEpipolarSteps + 1)>;
  Row x, y, z, u, v, seen;

  /// Steps 0 .. steps, at most kMaxEpipolarSteps.
  void project(const CameraModel& camera, const Vec3& first, const Vec3& last, int steps) {
    const Vec3 chord = last - first;
    const int n = CameraModel::row_room(steps + 1);  // what is beyond is never read
    for (int s = 0; s < n; ++s) {
      const double w = static_cast<double>(s) / steps;
      x[s] = first.x() + w * chord.x();
      y[s] = first.y() + w * chord.y();
      z[s] = first.z() + w * chord.z();
    }
    camera.project(steps + 1, CameraModel::Rows<double>{x.data(), y.data(), z.data(), u.data(), v.data(), seen.data()});
  }
};

float residual_limit(bool seed) {
  return seed ? kMaxResidualSeed : kMaxResidual;
}

// Direction across the source's edge as the other view sees it. An edge's direction is carried by A; its normal by the
// inverse transposed, or it would not stay normal where A shears or stretches.
Vec2f warped_normal(const Eigen::Matrix2f& A, const Vec2f& normal) {
  Eigen::Matrix2f cofactors;  // of A: its inverse transposed, times its determinant
  cofactors << A(1, 1), -A(1, 0), -A(0, 1), A(0, 0);
  const Vec2f n = cofactors * normal;
  return (A.determinant() < 0.0f ? Vec2f(-n) : n).normalized();
}

bool prepare(const ReferencePatch& patch, const PatchSource& source, const Eigen::Matrix2f& A,
             AlignTemplate* prepared) {
  return source.feature->type == FeatureType::kEdgelet
             ? prepare_align_1d(patch, warped_normal(A, source.feature->gradient), prepared)
             : prepare_align_2d(patch, prepared);
}

MatchResult align_match(const rt::PyramidView& cur, const AlignTemplate& reference, int level, const Vec2f& px_guess,
                        bool seed) {
  MatchResult m;
  m.level = level;
  Vec2f px = to_level(px_guess, level);
  if (!reference.direction.isZero(0.0f)) m.gradient = reference.direction;
  const FeatureAlignResult r = align(cur.level[level], reference, kAlignIterations, kMaxShiftPx, &px);
  m.residual = r.residual;
  m.found = r.converged && r.residual < residual_limit(seed);
  m.px = from_level(px, level);
  return m;
}

}  // namespace

bool bearing_by_pixel(const CameraModel& camera, const KeyframeFeature& feature, Mat32* turned) {
  // The Jacobian chain: pixel -> ray (tangent plane of the bearing).
  const Vec3& f = feature.bearing;
  Vec2 px;
  Mat23 J;
  if (!camera.project(f, &px, &J)) return false;
  // Plane facing the reference camera at the point: two unit vectors across the bearing.
  Vec3 u = std::abs(f.z()) < 0.9 ? f.cross(Vec3::UnitZ()) : f.cross(Vec3::UnitX());
  u.normalize();
  Mat32 B;
  B << u, f.cross(u);
  const Eigen::Matrix2d D = J * B;
  if (std::abs(D.determinant()) < 1e-12) return false;
  *turned = B * D.inverse();
  return true;
}

bool warp_matrix(const CameraModel& camera, const PatchSource& source, const Mat32& turned, const SE3& T_cur_ref,
                 Eigen::Matrix2f* A_cur_ref) {
  // A pixel further a point at this depth lies so much further across the bearing, and so much in the other view.
  Vec2 px;
  Mat23 J;
  if (!camera.project(T_cur_ref * (source.feature->bearing * source.depth), &px, &J)) return false;
  *A_cur_ref = (J * (T_cur_ref.R * turned) * source.depth).cast<float>();
  return A_cur_ref->allFinite();
}

bool warp_matrix(const CameraModel& camera, const PatchSource& source, const SE3& T_cur_ref,
                 Eigen::Matrix2f* A_cur_ref) {
  Mat32 turned;
  return bearing_by_pixel(camera, *source.feature, &turned) &&
         warp_matrix(camera, source, turned, T_cur_ref, A_cur_ref);
}

int search_level(const Eigen::Matrix2f& A_cur_ref, int level_ref, int max_level) {
  // Area of one source-level pixel in the other view; each level up quarters it.
  float area = std::abs(A_cur_ref.determinant()) * level_scale(2 * level_ref);
  int level = 0;
  while (area > 3.0f && level < max_level) {
    ++level;
    area *= 0.25f;
  }
  return level;
}

bool warp_patch(const PatchSource& source, const Eigen::Matrix2f& A_cur_ref, int level_cur, ReferencePatch* patch) {
  const int level_ref = source.feature->level;
  const rt::ImageView& image = source.pyramid->level[level_ref];
  const float scale = level_scale(level_cur) / level_scale(level_ref);
  const Eigen::Matrix2f A = A_cur_ref.inverse() * scale;  // level_cur pixels -> level_ref pixels
  if (!A.allFinite()) return false;
  const Vec2f centre = to_level(source.feature->px, level_ref);
  const float e = static_cast<float>(kPatchHalf + 1);
  const float reach_x = (std::abs(A(0, 0)) + std::abs(A(0, 1))) * e;
  const float reach_y = (std::abs(A(1, 0)) + std::abs(A(1, 1))) * e;
  // What is not finite fails each comparison; the pixels are gathered without a further look.
  if (!(centre.x() - reach_x >= 0.0f && centre.y() - reach_y >= 0.0f &&
        centre.x() + reach_x < static_cast<float>(image.width - 1) &&
        centre.y() + reach_y < static_cast<float>(image.height - 1)))
    return false;
  const RowTag df;
  constexpr int kLanes = static_cast<int>(hn::MaxLanes(RowTag()));
  const auto xx = hn::Set(df, A(0, 0)), xy = hn::Set(df, A(0, 1)), yx = hn::Set(df, A(1, 0)), yy = hn::Set(df, A(1, 1));
  const auto cx = hn::Set(df, centre.x()), cy = hn::Set(df, centre.y());
  for (int k = 0;;) {
    const auto u = hn::LoadU(df, kPatchPlaces.x.data() + k), v = hn::LoadU(df, kPatchPlaces.y.data() + k);
    const auto px = hn::MulAdd(xx, u, hn::MulAdd(xy, v, cx)), py = hn::MulAdd(yx, u, hn::MulAdd(yy, v, cy));
    hn::StoreU(interpolate_lanes(image, px, py), df, patch->value.data() + k);
    if (k + kLanes == kBorderPixels) break;
    // The last vector overlaps the one before it rather than reaching over the end.
    k = std::min(k + kLanes, kBorderPixels - kLanes);
  }
  return true;
}

void prefetch_patch(const rt::PyramidView& pyramid, const KeyframeFeature& feature) {
  constexpr int kReach = kPatchHalf + 2;
  const rt::ImageView& image = pyramid.level[feature.level];
  const Vec2f centre = to_level(feature.px, feature.level);
  const int x = static_cast<int>(centre.x()) - kReach, y = static_cast<int>(centre.y()) - kReach;
  const int rows = std::min(y + 2 * kReach, image.height);
  // Rows begin on the boundary of a line of the cache, so that all of them lie in it as the first does.
  const bool two_lines = std::max(x, 0) % rt::kRowAlignment + 2 * kReach > rt::kRowAlignment;
  for (int row = std::max(y, 0); row < rows; ++row) {
    const std::uint8_t* const p = image.row(row) + std::max(x, 0);
    hwy::Prefetch(p);
    if (two_lines) hwy::Prefetch(p + 2 * kReach);
  }
}

bool prepare_patch(const PatchSource& source, const Eigen::Matrix2f& A_cur_ref, int level, PreparedPatch* patch) {
  ReferencePatch cut;
  patch->A_cur_ref = A_cur_ref;
  patch->level = level;
  return warp_patch(source, A_cur_ref, level, &cut) && prepare(cut, source, A_cur_ref, &patch->reference);
}

MatchResult match_prepared(const PreparedPatch& patch, const rt::PyramidView& cur, const Vec2f& px_guess) {
  return align_match(cur, patch.reference, patch.level, px_guess, false);
}

MatchResult match_direct(const CameraModel& camera, const PatchSource& source, const SE3& T_cur_ref,
                         const rt::PyramidView& cur, const Vec2f& px_guess, int max_level, int coarser) {
  Eigen::Matrix2f A;
  if (!warp_matrix(camera, source, T_cur_ref, &A)) return {};
  const int level = search_level(A, source.feature->level, max_level) + coarser;
  PreparedPatch patch;
  if (level > max_level || !prepare_patch(source, A, level, &patch)) return {};
  return match_prepared(patch, cur, px_guess);
}

bool depth_from_triangulation(const SE3& T_cur_ref, const Vec3& f_ref, const Vec3& f_cur, double* depth) {
  // Least squares of depth_ref * R f_ref + t = depth_cur * f_cur.
  const Vec3 a = T_cur_ref.R * f_ref;
  const double aa = a.dot(a), ab = -a.dot(f_cur), bb = f_cur.dot(f_cur);
  const double det = aa * bb - ab * ab;
  if (det < 1e-8) return false;
  const double r0 = -a.dot(T_cur_ref.t), r1 = f_cur.dot(T_cur_ref.t);
  *depth = (bb * r0 - ab * r1) / det;
  return *depth > 0.0;
}

EpipolarResult match_epipolar(const CameraModel& camera, const PatchSource& source, const SE3& T_cur_ref,
                              const rt::PyramidView& cur, double depth_min, double depth_max, int max_level,
                              const Vec2& displaced) {
  EpipolarResult result;
  Eigen::Matrix2f A;
  if (!warp_matrix(camera, source, T_cur_ref, &A)) return result;
  const int level = search_level(A, source.feature->level, max_level);
  const Vec3& f = source.feature->bearing;
  const Vec3 p_near = T_cur_ref * (f * depth_min), p_far = T_cur_ref * (f * depth_max);
  Vec2 a, b;
  if (!camera.project(p_near, &a) || !camera.project(p_far, &b)) return result;
  const double scale = 1.0 / (1 << level);
  const double length = (a - b).norm() * scale;

  // An edge along the epipolar line says nothing about depth.
  if (source.feature->type == FeatureType::kEdgelet && length > 1.0) {
    const Vec2f direction = (a - b).cast<float>().normalized();
    if (std::abs(warped_normal(A, source.feature->gradient).dot(direction)) < 0.7f) return result;
  }
  ReferencePatch patch;
  if (!warp_patch(source, A, level, &patch)) return result;

  const rt::ImageView& image = cur.level[level];
  const auto inside = [&](const Vec2f& p) { return window_inside(image, p, kPatchHalf + 1, kPatchHalf + 2); };
  Vec2f best_px = from_level(to_level(((a + b) * 0.5 + displaced).cast<float>(), level), level);
  if (length < 2.0) {
    result.visible = inside(to_level(best_px, level));
    if (!result.visible) return result;
  } else {
    const ZeroMeanPatch zm(patch);
    const int steps = std::clamp(static_cast<int>(length / 0.7), 2, kMaxEpipolarSteps);
    EpipolarPlaces places;
    places.project(camera, p_near.normalized(), p_far.normalized(), steps);
    int best = kMaxZmssd, second = kMaxZmssd, best_step = -10;
    int last_x = -1, last_y = -1;
    for (int s = 0; s <= steps; ++s) {
      if (!(places.seen[s] > 0.0)) continue;
      const Vec2 px = Vec2(places.u[s], places.v[s]) + displaced;
      const Vec2f pl = to_level(px.cast<float>(), level);
      if (!inside(pl)) continue;
      result.visible = true;
      const int x = static_cast<int>(pl.x() + 0.5f), y = static_cast<int>(pl.y() + 0.5f);
      if (x == last_x && y == last_y) continue;
      last_x = x;
      last_y = y;
      const int score = zm.score(image.row(y - kPatchHalf) + x - kPatchHalf, image.stride);
      if (score < best) {
        if (s - best_step > 3) second = best;
        best = score;
        best_step = s;
        best_px = from_level(x, y, level);
      } else if (score < second && s - best_step > 3) {
        second = score;
      }
    }
    if (best >= kMaxZmssd) return result;
    // Repeated texture: two places on the line look nearly alike.
    if (second<kMaxZmssd&& static_cast<float>(best)> 0.8f * static_cast<float>(second)) return result;
  }
  AlignTemplate reference;
  if (!prepare(patch, source, A, &reference)) return result;
  result.match = align_match(cur, reference, level, best_px, true);
  if (!result.match.found) return result;
  const Vec3 f_cur = camera.unproject(result.match.px.cast<double>() - displaced);
  result.depth_known = depth_from_triangulation(T_cur_ref, f, f_cur, &result.depth);
  return result;
}

}  // namespace godwit::vo
