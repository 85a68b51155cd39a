#include "vo_core/tracking/reprojector.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "vo_core/map/matcher.h"

namespace godwit::vo {
namespace {
constexpr int kAhead = 16;  // points that are asked for before they are projected
}

Reprojector::Reprojector(const CameraModel& camera, const ReprojectorOptions& options)
    : camera_(camera), options_(options) {
  options_.max_trials = std::min(options_.max_trials, kMaxTrials);
  // Larger cells where the picture would have more cells than there is room for.
  do {
    columns_ = (camera.width() + options_.cell_px - 1) / options_.cell_px;
    rows_ = (camera.height() + options_.cell_px - 1) / options_.cell_px;
    if (columns_ * rows_ <= kMaxCells) break;
    ++options_.cell_px;
  } while (true);
  per_cell_ = (1u << kCellShift) / static_cast<unsigned>(options_.cell_px) + 1u;
  // A fixed shuffle, so that a stop at max_features leaves no corner of the picture out.
  const int cells = columns_ * rows_;
  for (int i = 0; i < cells; ++i) cell_order_[i] = static_cast<std::uint16_t>(i);
  std::uint32_t state = 12345;
  for (int i = cells - 1; i > 0; --i) {
    state = state * 1664525u + 1013904223u;
    std::swap(cell_order_[i], cell_order_[(state >> 8) % static_cast<std::uint32_t>(i + 1)]);
  }
}

void Reprojector::collect(Map* map, const rt::MaskPyramidView& mask, const SE3& T_cam_world,
                          const ReadoutMotion& motion, std::uint32_t mark, ReprojectionResult* result) {
  position_ = -(T_cam_world.R.transpose() * T_cam_world.t);
  const Vec3 axis = T_cam_world.R.row(2);
  // Keyframes that look the same way, nearest first.
  std::array<std::pair<double, int>, kMaxKeyframes> near;
  int n = 0;
  for (int k = 0; k < kMaxKeyframes; ++k) {
    const Keyframe& kf = map->keyframe(k);
    if (kf.id == 0) continue;
    keyframe_position_[k] = kf.position();
    T_cur_kf_[k] = T_cam_world * kf.T_kf_world.inverse();
    const double cos_axis = axis.dot(kf.T_kf_world.R.row(2).transpose());
    if (cos_axis < 0.5) continue;
    const double d = (keyframe_position_[k] - position_).norm() / kf.median_depth + 1.0 * (1.0 - cos_axis);
    near[n++] = {d, k};
  }
  std::sort(near.begin(), near.begin() + n);
  n = std::min(n, options_.max_keyframes);
  result->keyframes = n;

  std::fill_n(cell_head_.begin(), columns_ * rows_, kEnd);
  std::fill_n(resting_head_.begin(), columns_ * rows_, kEnd);
  std::fill_n(shaded_head_.begin(), columns_ * rows_, kEnd);
  candidate_count_ = 0;
  for (int i = 0; i < n && candidate_count_ < kMaxCandidates; ++i) {
    const Keyframe& kf = map->keyframe(near[i].second);
    int points = 0;
    for (int f = 0; f < kf.feature_count; ++f) {
      if (f + kAhead < kf.feature_count) map->prefetch(kf.points[f + kAhead]);
      MapPoint* p = map->find(kf.points[f]);
      if (!p || p->last_mark == mark) continue;
      p->last_mark = mark;
      for (int k = 0; k < 3; ++k) p_world_[k][points] = p->p_world(k);
      seen_point_[points++] = kf.points[f];
    }
    project(points, T_cam_world, motion);
    for (int k = 0; k < points && candidate_count_ < kMaxCandidates; ++k)
      if (seen_[k] > 0.0) add_candidate(*map, seen_point_[k], Vec2(u_[k], v_[k]), mask);
  }
  result->candidates = candidate_count_;
}

void Reprojector::project(int points, const SE3& T_cam_world, const ReadoutMotion& motion) {
  const Mat3& R = T_cam_world.R;
  for (int axis = 0; axis < 3; ++axis) {
    const double a = R(axis, 0), b = R(axis, 1), c = R(axis, 2), t = T_cam_world.t(axis);
    for (int k = 0; k < points; ++k) p_cam_[axis][k] = a * p_world_[0][k] + b * p_world_[1][k] + c * p_world_[2][k] + t;
  }
  const bool rolling = options_.shutter.readout_s > 0.0;
  double* const J[6] = {J_[0].data(), J_[1].data(), J_[2].data(), J_[3].data(), J_[4].data(), J_[5].data()};
  camera_.project(points, CameraModel::Rows<double>{p_cam_[0].data(), p_cam_[1].data(), p_cam_[2].data(), u_.data(),
                                                    v_.data(), seen_.data(), rolling ? J : nullptr});
  if (!rolling) return;
  for (int k = 0; k < points; ++k) {
    Mat23 J_point;
    J_point << J_[0][k], J_[1][k], J_[2][k], J_[3][k], J_[4][k], J_[5][k];
    const Vec2 moved = rolling_displacement(options_.shutter, camera_.height(),
                                            Vec3(p_cam_[0][k], p_cam_[1][k], p_cam_[2][k]), J_point, v_[k], motion);
    u_[k] += moved.x();
    v_[k] += moved.y();
  }
}

void Reprojector::add_candidate(const Map& map, PointHandle point, const Vec2& px, const rt::MaskPyramidView& mask) {
  if (!camera_.in_image(px, 8.0)) return;
  const MapPoint& p = *map.find(point);
  const bool shaded =
      mask.levels > 0 && mask.level[0].at(static_cast<int>(px.x() + 0.5), static_cast<int>(px.y() + 0.5));
  if (shaded && p.observation_count < options_.proven_observations) return;
  const int cell = cell_of(px.y()) * columns_ + cell_of(px.x());
  Candidate& c = candidates_[candidate_count_];
  c.point = point;
  c.px = px.cast<float>();
  c.keyframe = kUnchosen;
  // Points seen by many keyframes first: their position is known best. Among equals, those that are found again.
  const int reliability = p.found * 8 / (p.found + 2 * p.missed + 8);
  c.weight = static_cast<std::uint16_t>(p.observation_count * 8 + reliability);
  CellLists& lists = shaded ? shaded_head_ : p.next_mark > mark_ ? resting_head_ : cell_head_;
  std::uint16_t* link = &lists[cell];
  while (*link != kEnd && candidates_[*link].weight >= c.weight) link = &candidates_[*link].next;
  c.next = *link;
  *link = static_cast<std::uint16_t>(candidate_count_++);
}

void Reprojector::make_ready(const Map& map, std::uint16_t index) {
  if (index == kEnd || candidates_[index].keyframe != kUnchosen) return;
  Candidate& c = candidates_[index];
  const MapPoint& p = *map.find(c.point);
  // The observation whose direction is nearest to the present one.
  const Vec3 direction = (position_ - p.p_world).normalized();
  double best_cos = 0.5;
  int best = -1;
  for (int i = 0; i < p.observation_count; ++i) {
    const Vec3 d = keyframe_position_[p.observations[i].keyframe] - p.p_world;
    const double cos_angle = d.dot(direction) / d.norm();
    // No branch: which is the better one no processor foresees.
    const bool better = cos_angle > best_cos;
    best_cos = better ? cos_angle : best_cos;
    best = better ? i : best;
  }
  c.keyframe = kNone;
  if (best < 0) return;
  c.keyframe = static_cast<std::int8_t>(p.observations[best].keyframe);
  c.feature = p.observations[best].feature;
  patches_.prefetch(map.keyframe(c.keyframe), c.feature, c.point);
}

bool Reprojector::try_match(const Map& map, std::uint16_t index, const rt::PyramidView& pyramid, float max_residual,
                            FrameFeature* out) {
  make_ready(map, index);
  const Candidate& c = candidates_[index];
  if (c.keyframe == kNone) return false;
  const Keyframe& kf = map.keyframe(c.keyframe);
  const KeyframeFeature& feature = kf.features[c.feature];
  const double depth = (keyframe_position_[c.keyframe] - map.find(c.point)->p_world).norm();
  const SE3& T_cur_kf = T_cur_kf_[c.keyframe];
  MatchResult m;
  if (const PreparedPatch* const patch =
          patches_.prepared(camera_, kf, c.feature, c.point, depth, T_cur_kf, options_.max_level))
    m = match_prepared(*patch, pyramid, c.px);
  for (int coarser = 1; coarser <= coarser_ && !(m.found && m.residual <= max_residual); ++coarser)
    m = match_direct(camera_, {&kf.pyramid, &feature, depth}, T_cur_kf, pyramid, c.px, options_.max_level, coarser);
  if (!m.found || m.residual > max_residual || !camera_.in_image(m.px.cast<double>(), 4.0)) return false;
  out->px = m.px;
  out->gradient = m.gradient;
  out->level = static_cast<std::int8_t>(m.level);
  out->type = feature.type;
  out->point = c.point;
  out->shaded = false;
  return true;
}

ReprojectionResult Reprojector::run(Map* map, const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask,
                                    const SE3& T_cam_world, const ReadoutMotion& motion, bool coarser,
                                    std::uint32_t mark, int wanted, FrameFeature* out) {
  ReprojectionResult result;
  coarser_ = coarser ? options_.coarser_levels : 0;
  mark_ = mark;
  const int limit = std::min(wanted, options_.max_features);
  collect(map, mask, T_cam_world, motion, mark, &result);
  trial_count_ = 0;
  run_free(*map, pyramid, limit, &cell_head_, &result, out);
  if (result.matches < options_.plenty_matches) run_free(*map, pyramid, limit, &resting_head_, &result, out);
  if (result.matches < options_.scarce_matches) run_shaded(*map, pyramid, limit, &result, out);
  return result;
}

void Reprojector::run_free(const Map& map, const rt::PyramidView& pyramid, int limit, CellLists* lists,
                           ReprojectionResult* result, FrameFeature* out) {
  // One point a cell; where points are few, a second and third round through the cells.
  for (int round = 0; round < 3; ++round) {
    for (int i = 0; i < columns_ * rows_; ++i) {
      std::uint16_t& head = (*lists)[cell_order_[i]];
      if (i + 1 < columns_ * rows_) make_ready(map, (*lists)[cell_order_[i + 1]]);
      while (head != kEnd) {
        if (result->matches >= limit || result->trials >= options_.max_trials) return;
        const std::uint16_t tried = head;
        head = candidates_[tried].next;
        // Which of them is tried next hangs on how this one ends.
        make_ready(map, head);
        ++result->trials;
        Trial& trial = trials_[trial_count_++];
        trial = {candidates_[tried].point.index, try_match(map, tried, pyramid, 1.0f, out + result->matches)};
        if (trial.found) {
          ++result->matches;
          break;
        }
      }
    }
  }
}

void Reprojector::run_shaded(const Map& map, const rt::PyramidView& pyramid, int limit, ReprojectionResult* result,
                             FrameFeature* out) {
  // Not found means hidden here: such a trial says nothing about the point, nor about the pose.
  int trials = result->trials;
  for (int round = 0; round < 2; ++round) {
    for (int i = 0; i < columns_ * rows_; ++i) {
      std::uint16_t& head = shaded_head_[cell_order_[i]];
      while (head != kEnd) {
        if (result->matches >= limit || trials >= options_.max_trials) return;
        const std::uint16_t tried = head;
        head = candidates_[tried].next;
        ++trials;
        if (try_match(map, tried, pyramid, options_.shaded_residual, out + result->matches)) {
          out[result->matches++].shaded = true;
          ++result->shaded;
          break;
        }
      }
    }
  }
}

void Reprojector::keep_score(Map* map) const {
  for (int i = 0; i < trial_count_; ++i) {
    MapPoint& p = map->point(trials_[i].point);
    if (trials_[i].found) {
      p.rest = 0;
      if (p.found < 0xffff) ++p.found;
    } else {
      // While it rested it would have been missed as well.
      const int rested = mark_ >= p.next_mark ? p.rest : 0;
      p.missed = static_cast<std::uint16_t>(std::min(p.missed + 1 + rested, 0xffff));
      p.next_mark = mark_ + 1 + p.rest;
      if (p.rest < options_.longest_rest) ++p.rest;
    }
  }
}

}  // namespace godwit::vo
