#include "vo_core/map/mapper.h"

#include <algorithm>
#include <cassert>

namespace godwit::vo {

Mapper::Mapper(const CameraModel& camera, const MapperOptions& options, MapChannel* channel)
    : camera_(camera),
      options_(options),
      channel_(channel),
      mask_storage_(std::make_unique_for_overwrite<std::uint8_t[]>(2 * camera.width() * camera.height())),
      detector_(camera.width(), camera.height(), options.detector),
      bundle_(camera, options.bundle),
      seeds_(std::make_unique<std::array<Seed, kMaxSeeds>>()) {}
Mapper::~Mapper() = default;

bool Mapper::take_release(SlotRelease* out) {
  return releases_.take(out);
}

void Mapper::remove_point(PointHandle h) {
  if (!map_.find(h) || delta_->removed_point_count >= MapDelta::kMaxRemoved) return;
  map_.remove_point(h);
  delta_->removed_points[delta_->removed_point_count++] = h;
}

void Mapper::remove_observation(int place, int feature) {
  if (delta_->removed_observation_count >= MapDelta::kMaxRemoved) return;
  delta_->removed_observations[delta_->removed_observation_count++] = {map_.keyframe(place).id,
                                                                       static_cast<std::uint16_t>(feature)};
  map_.remove_observation(place, feature);
}

bool Mapper::step() {
  MapperMessage* m = channel_->messages.front();
  if (!m) return false;
  delta_ = channel_->deltas.claim();
  if (!delta_) return false;
  delta_->clear();
  // Points of uncertain depth are better than none: with little motion the depth matters little for the pose, and the
  // bundle adjustment makes it certain later.
  hunger_ = std::clamp(1.0 - static_cast<double>(m->tracked_features) / options_.starving_features, 0.0, 1.0);
  // Where movers cover much of the picture, they are about to cover what carries the pose now.
  const double covered = m->mask.covered();
  crowded_ = covered > options_.crowded;
  if (crowded_) hunger_ = std::max(hunger_, covered);
  sigma_limit_ = options_.converged_sigma + hunger_ * (options_.starving_sigma - options_.converged_sigma);
  report_ = {};
  report_.kind = m->kind;
  report_.sequence = m->sequence;
  if (m->kind == MessageKind::kReset) {
    handle_reset(*m);
  } else if (m->epoch != epoch_) {
    releases_.add(m->slot, 1);
  } else if (m->kind == MessageKind::kLateMask) {
    handle_late_mask(*m);
  } else if (SE3 T_cam_world; !place_in_map(*m, &T_cam_world)) {
    releases_.add(m->slot, 1);
  } else if (m->kind == MessageKind::kFrame) {
    update_seeds(*m, T_cam_world);
    releases_.add(m->slot, 1);
  } else {
    update_seeds(*m, T_cam_world);
    handle_keyframe(*m, T_cam_world);
  }
  report_.keyframes = map_.keyframe_count();
  report_.points = map_.point_count();
  delta_->epoch = epoch_;
  delta_->sequence = m->sequence;
  delta_->newest_keyframe_id = newest_keyframe_id_;
  if (!delta_->empty()) channel_->deltas.commit();
  delta_ = nullptr;
  channel_->messages.pop();
  return true;
}

void Mapper::handle_reset(const MapperMessage& m) {
  releases_.add_all(map_);
  map_.clear();
  for (Seed& s : *seeds_) s.active = false;
  epoch_ = m.epoch;
  newest_keyframe_id_ = 0;
}

bool Mapper::place_in_map(const MapperMessage& m, SE3* T_cam_world) const {
  *T_cam_world = m.T_cam_anchor;
  if (m.anchor_id == 0) return true;
  const int anchor = map_.find_keyframe(m.anchor_id);
  assert(anchor >= 0 && "the newest keyframes are never forgotten");
  if (anchor < 0) return false;
  *T_cam_world = m.T_cam_anchor * map_.keyframe(anchor).T_kf_world;
  return true;
}

void Mapper::handle_keyframe(const MapperMessage& m, const SE3& T_cam_world) {
  const Keyframe& kf =
      map_.insert_keyframe(m.keyframe_place, m.keyframe_id,
                           {m.sequence, m.slot, m.t_capture_ns, m.pyramid, T_cam_world, m.motion, m.median_depth});
  newest_keyframe_id_ = m.keyframe_id;
  masks_[m.keyframe_place].assign(m.mask);
  for (int i = 0; i < m.feature_count; ++i) {
    const FrameFeature& f = m.features[i];
    if (m.initial && m.keyframe_id == 1) map_.activate_point(f.point, m.initial_points[i].cast<double>());
    // A point that this side deleted while the keyframe was on its way must go on the other side too.
    if (!map_.find(f.point) && delta_->removed_point_count < MapDelta::kMaxRemoved)
      delta_->removed_points[delta_->removed_point_count++] = f.point;
    map_.append_feature(m.keyframe_place, keyframe_feature(camera_, f));
  }
  for (int i = 0; i < m.weak_count; ++i) remove_point(m.weak[i]);
  if (m.keyframe_id > 1) adjust(m.keyframe_place);
  // It may have moved with its anchor: the tracker is told where it lies even if the adjustment left it there.
  if (m.keyframe_id > 1 && bundle_.moved_keyframe_count() == 0)
    delta_->moved_keyframes[delta_->moved_keyframe_count++] = {kf.id, kf.T_kf_world};
  create_seeds(m.keyframe_place, m);
  forget_keyframes(m.keyframe_place);
}

void Mapper::handle_late_mask(const MapperMessage& m) {
  const int place = m.keyframe_place;
  const Keyframe& kf = map_.keyframe(place);
  if (kf.id != m.keyframe_id) return;  // forgotten meanwhile
  // In addition to the earlier mask: a detection misses things, too.
  masks_[place].add(m.mask);
  for (Seed& s : *seeds_)
    if (s.active && s.place == place && m.mask.masked(s.feature.px)) s.active = false;
  // A box holds much that does not move: what two other keyframes have seen beside their masks stays. To take all that
  // lies inside cost the severest walkers a tenth of the frames.
  for (int i = 0; i < kf.feature_count; ++i) {
    const PointHandle h = kf.features[i].point;
    const MapPoint* const p = map_.find(h);
    if (!p || !m.mask.masked(kf.features[i].px)) continue;
    int beside = 0;
    for (int k = 0; k < p->observation_count; ++k) {
      const Observation& o = p->observations[k];
      beside += !masks_[o.keyframe].masked(map_.keyframe(o.keyframe).features[o.feature].px);
    }
    if (beside < 2) remove_point(h);
  }
}

Vec2 Mapper::displacement(const Vec3& p_cam, const ReadoutMotion& motion) const {
  Vec2 px;
  Mat23 J;
  if (options_.shutter.readout_s <= 0.0 || !camera_.project(p_cam, &px, &J)) return Vec2::Zero();
  return rolling_displacement(options_.shutter, camera_.height(), p_cam, J, px.y(), motion);
}

void Mapper::place_feature(KeyframeFeature* f, const Keyframe& kf, const Vec3& p_cam) const {
  f->px_global = global_pixel(options_.shutter, camera_, f->px, p_cam, kf.motion);
  f->bearing = camera_.unproject(f->px_global.cast<double>());
}

void Mapper::adjust(int place) {
  report_.bundle = bundle_.run(&map_, place);
  bundle_.shares(map_, &delta_->shares);
  for (int i = 0; i < bundle_.outlier_count(); ++i) {
    const Observation o = bundle_.outlier(i);
    const PointHandle h = map_.keyframe(o.keyframe).features[o.feature].point;
    const MapPoint* p = map_.find(h);
    if (!p) continue;
    if (p->observation_count <= 2)
      remove_point(h);
    else
      remove_observation(o.keyframe, o.feature);
  }
  for (int i = 0; i < bundle_.moved_keyframe_count(); ++i) {
    const Keyframe& kf = map_.keyframe(bundle_.moved_keyframe(i));
    delta_->moved_keyframes[delta_->moved_keyframe_count++] = {kf.id, kf.T_kf_world};
  }
  for (int i = 0; i < bundle_.moved_point_count() && delta_->moved_point_count < MapDelta::kMaxMovedPoints; ++i) {
    const int index = bundle_.moved_point(i);
    const MapPoint& p = map_.point(index);
    if (!p.active) continue;
    delta_->moved_points[delta_->moved_point_count++] = {{static_cast<std::uint16_t>(index), p.generation}, p.p_world};
  }
}

int Mapper::least_useful_keyframe(int newest, bool points) const {
  // Most of its points are seen by at least three others; if none stands out, the farthest. Where it is the points that
  // need room, what others see, too, frees none: then the farthest goes.
  const Vec3 here = map_.keyframe(newest).position();
  int worst = -1;
  double worst_score = -1.0;
  for (int k = 0; k < kMaxKeyframes; ++k) {
    const Keyframe& kf = map_.keyframe(k);
    if (kf.id <= 2 || k == newest) continue;
    if (kf.id + 5 > map_.keyframe(newest).id) continue;
    int seen = 0, redundant = 0;
    for (int i = 0; i < kf.feature_count; ++i) {
      const MapPoint* p = map_.find(kf.features[i].point);
      if (!p) continue;
      ++seen;
      if (p->observation_count >= 5) ++redundant;
    }
    const double distance = (kf.position() - here).norm() / map_.keyframe(newest).median_depth;
    const double score = points ? distance : static_cast<double>(redundant) / (seen + 1) + 0.2 * distance;
    if (score > worst_score) {
      worst_score = score;
      worst = k;
    }
  }
  return worst;
}

void Mapper::forget_keyframes(int newest) {
  while (delta_->removed_keyframe_count < MapDelta::kMaxRemovedKeyframes) {
    const bool points = kMaxPoints - map_.point_count() < options_.spare_points;
    if (!points && map_.keyframe_count() <= options_.max_keyframes) return;
    const int place = least_useful_keyframe(newest, points);
    if (place < 0) return;
    for (Seed& s : *seeds_)
      if (s.active && s.place == place) s.active = false;
    const Keyframe& kf = map_.keyframe(place);
    delta_->removed_keyframes[delta_->removed_keyframe_count++] = kf.id;
    releases_.add(kf.slot, 1);
    map_.remove_keyframe(place);
  }
}

}  // namespace godwit::vo
