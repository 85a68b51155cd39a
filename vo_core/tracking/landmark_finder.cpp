#include "vo_core/tracking/landmark_finder.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numbers>

namespace godwit::vo {

LandmarkFinder::LandmarkFinder(const CameraModel& camera, const LandmarkFinderOptions& options)
    : camera_(camera),
      options_(options),
      detector_(camera.width(), camera.height(), FeatureDetectorOptions{.edgelets = false}),
      looks_(std::make_unique<std::array<Look, kMaxPoints>>()) {
  options_.corners = std::min(options_.corners, kMaxCorners);
}
LandmarkFinder::~LandmarkFinder() = default;

void LandmarkFinder::forget() {
  for (Look& look : *looks_) look = {};
}

double LandmarkFinder::median_depth(const Map& map) {
  std::array<double, kMaxKeyframes> depth;
  int n = 0;
  for (int k = 0; k < kMaxKeyframes; ++k)
    if (map.keyframe(k).id != 0) depth[n++] = map.keyframe(k).median_depth;
  if (n == 0) return 0.0;
  std::nth_element(depth.begin(), depth.begin() + n / 2, depth.begin() + n);
  return depth[n / 2];
}

void LandmarkFinder::learn(const Map& map, int points) {
  int described = 0;
  const int end = map.point_end();
  for (int i = 0; i < end && described < points; ++i) {
    if (next_to_learn_ >= end) next_to_learn_ = 0;
    const int index = next_to_learn_++;
    const MapPoint& p = map.point(index);
    Look& look = (*looks_)[index];
    if (!p.active) continue;
    if (look.generation == p.generation && (look.known || look.observations == p.observation_count)) continue;
    look.generation = p.generation;
    look.observations = p.observation_count;
    look.known = false;
    // Of its views any that is not too near the edge.
    for (int k = 0; k < p.observation_count && !look.known; ++k) {
      const Observation& o = p.observations[k];
      const Keyframe& kf = map.keyframe(o.keyframe);
      look.known = upright_.describe(kf.pyramid, kf.features[o.feature].px, &look.descriptor);
    }
    ++described;
  }
}

int LandmarkFinder::match(const Map& map, const rt::PyramidView& pyramid, double roll, int attempt,
                          const LastSeen* last) {
  const BriefPattern pattern = roll == 0.0 ? upright_ : BriefPattern(roll);
  constexpr std::uint16_t kFree = 0xffff;
  std::array<std::uint16_t, kMaxPoints> match_of_point;
  const int end = map.point_end();
  std::fill_n(match_of_point.begin(), end, kFree);
  const double near = options_.elsewhere * median_depth(map);
  // Neighbours in the array are mostly neighbours in time and place.
  int known = 0;
  std::array<std::uint16_t, kMaxPoints> compared;
  const int first = last != nullptr ? 0 : attempt * options_.max_points / 2;
  std::array<Vec2f, kMaxPoints> expected;  // where they lie in the picture, when last is known
  const double reach = last != nullptr ? reach_px(*last) : 0.0;
  for (int k = 0; k < end && known < options_.max_points; ++k) {
    const int i = (first + k) % end;
    const Look& look = (*looks_)[i];
    const MapPoint& p = map.point(i);
    if (!look.known || !p.active || p.generation != look.generation) continue;
    if (last != nullptr) {
      Vec2 px;
      if (!camera_.project(last->T_cam_world * p.p_world, &px) || !camera_.in_image(px, -reach)) continue;
      expected[known] = px.cast<float>();
    }
    compared[known++] = static_cast<std::uint16_t>(i);
  }
  int n = 0;
  for (int c = 0; c < corner_count_; ++c) {
    BriefDescriptor d;
    if (!pattern.describe(pyramid, corners_[c].px, &d)) continue;
    int best = 257, second = 257, best_point = -1;
    for (int k = 0; k < known; ++k) {
      if (last != nullptr && (expected[k] - corners_[c].px).squaredNorm() > reach * reach) continue;
      const int i = compared[k];
      const int distance = d.distance((*looks_)[i].descriptor);
      if (distance >= second) continue;
      // One place may have been made a point several times.
      const bool same_place =
          best_point >= 0 && (map.point(i).p_world - map.point(best_point).p_world).squaredNorm() < near * near;
      if (distance < best) {
        if (!same_place) second = best;
        best = distance;
        best_point = i;
      } else if (!same_place) {
        second = distance;
      }
    }
    if (best > options_.max_distance || best > options_.max_ratio * second) continue;
    // A point belongs to the corner that resembles it most.
    std::uint16_t& taken = match_of_point[best_point];
    if (taken == kFree) {
      taken = static_cast<std::uint16_t>(n);
      matches_[n++] = {static_cast<std::uint16_t>(best_point), static_cast<std::uint16_t>(c), best};
    } else if (best < matches_[taken].distance) {
      matches_[taken].corner = static_cast<std::uint16_t>(c);
      matches_[taken].distance = best;
    }
  }
  return n;
}

double LandmarkFinder::reach_px(const LastSeen& last) const {
  return options_.near_px + options_.turn_rad_s * last.ago_s / camera_.rad_per_px();
}

int LandmarkFinder::start_keyframe(const Map& map, int matches) const {
  // The one that saw most of the matched points.
  std::array<int, kMaxKeyframes> seen{};
  for (int i = 0; i < matches; ++i) {
    const MapPoint& p = map.point(matches_[i].point);
    for (int k = 0; k < p.observation_count; ++k) ++seen[p.observations[k].keyframe];
  }
  return static_cast<int>(std::max_element(seen.begin(), seen.end()) - seen.begin());
}

bool LandmarkFinder::pose_of_three(int a, int b, int c, SE3* T_cam_world) const {
  SE3 T = *T_cam_world;
  double error = 1e9;
  for (int it = 0; it < 8; ++it) {
    Mat6 H = Mat6::Identity() * 1e-9;
    Vec6 g = Vec6::Zero();
    error = 0.0;
    for (const int i : {a, b, c}) {
      Vec2 r;
      Mat26 J;
      if (!pose_residual(camera_, T, measurements_[i], &r, &J)) return false;
      H.noalias() += J.transpose() * J;
      g.noalias() -= J.transpose() * r;
      error = std::max(error, r.squaredNorm());
    }
    if (error < 1.0) break;
    const Vec6 dx = Eigen::LDLT<Mat6>(H).solve(g);
    if (!dx.allFinite()) return false;
    T = SE3::exp(dx) * T;
  }
  if (error > 1.0) return false;
  *T_cam_world = T;
  return true;
}

int LandmarkFinder::agreeing(int matches, const SE3& T_cam_world) const {
  const double limit = options_.agreement_px * options_.agreement_px;
  int n = 0;
  for (int i = 0; i < matches; ++i) {
    Vec2 r;
    n += pose_residual(camera_, T_cam_world, measurements_[i], &r, nullptr) && r.squaredNorm() < limit;
  }
  return n;
}

LandmarkReport LandmarkFinder::find(const Map& map, const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask,
                                    int attempt, const LastSeen* last) {
  LandmarkReport report;
  if (last != nullptr && reach_px(*last) > camera_.width()) last = nullptr;
  const int least = last != nullptr ? options_.min_agreeing_near : options_.min_agreeing;
  learn(map, options_.described_a_frame);
  // Of three attempts two are upright, the third is turned by +1, -1, +2, -2, .. steps, until the circle is full.
  double roll = 0.0;
  if (last == nullptr && attempt % 3 == 2) {
    const int k = attempt / 3 % std::max(1, static_cast<int>(2.0 * std::numbers::pi / options_.roll_step_rad));
    roll = (k % 2 == 0 ? 1.0 : -1.0) * (k / 2 + 1) * options_.roll_step_rad;
  }
  corner_count_ = report.corners =
      detector_.detect(pyramid, mask, {}, options_.corners, std::span(corners_.data(), options_.corners));
  // Where the mask leaves few, inside it, too: what moves resembles no point of the map.
  if (mask.levels > 0 && corner_count_ < options_.corners) {
    std::array<Vec2f, kMaxCorners> taken;
    for (int i = 0; i < corner_count_; ++i) taken[i] = corners_[i].px;
    corner_count_ +=
        detector_.detect(pyramid, {}, std::span(taken.data(), corner_count_), options_.corners - corner_count_,
                         std::span(corners_.data() + corner_count_, options_.corners - corner_count_));
    report.corners = corner_count_;
  }
  report.matches = match(map, pyramid, roll, attempt, last);
  if (report.matches < least) return report;
  for (int i = 0; i < report.matches; ++i) {
    const Match& m = matches_[i];
    PoseMeasurement& out = measurements_[i];
    out = {};
    out.px = corners_[m.corner].px.cast<double>();
    out.p_world = map.point(m.point).p_world;
    out.sigma_px = 2.0;
  }
  SE3 start = last != nullptr ? last->T_cam_world : map.keyframe(start_keyframe(map, report.matches)).T_kf_world;
  start.R = Eigen::AngleAxisd(roll, Vec3::UnitZ()).toRotationMatrix() * start.R;
  start.t = Eigen::AngleAxisd(roll, Vec3::UnitZ()).toRotationMatrix() * start.t;
  std::uint32_t state = 4797;
  const auto draw = [&] {
    state = state * 1664525u + 1013904223u;
    return static_cast<int>((state >> 8) % static_cast<std::uint32_t>(report.matches));
  };
  SE3 best;
  for (int round = 0; round < options_.rounds; ++round) {
    const int a = draw(), b = draw(), c = draw();
    if (a == b || b == c || a == c) continue;
    SE3 T = start;
    if (!pose_of_three(a, b, c, &T)) continue;
    const int n = agreeing(report.matches, T);
    if (n <= report.agreeing) continue;
    report.agreeing = n;
    best = T;
  }
  if (report.agreeing < least) return report;
  // Of those that agree, the best pose of all.
  int kept = 0;
  for (int i = 0; i < report.matches; ++i) {
    Vec2 r;
    if (pose_residual(camera_, best, measurements_[i], &r, nullptr) && r.norm() < 2.0 * options_.agreement_px)
      std::swap(measurements_[kept++], measurements_[i]);
  }
  const PoseOptimizerResult p = optimize_pose(camera_, {}, std::span(measurements_.data(), kept), &best);
  report.found = p.ok && p.inliers >= least;
  report.T_cam_world = best;
  return report;
}

}  // namespace godwit::vo
