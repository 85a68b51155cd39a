#include "vo_core/mapper.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "vo_core/matcher.h"
#include "vo_core/patch.h"
#include "vo_core/structure_optimizer.h"

namespace godwit::vo {
namespace {
constexpr int kMaxSeedMisses = 20;
constexpr double kMinInlierRatio = 0.35;
constexpr double kMaxObservationErrorPx = 2.0;
constexpr int kMaxLevel = 3;
}  // namespace

Mapper::Mapper(const CameraModel& camera, const MapperOptions& options, MapChannel* channel)
    : camera_(camera),
      options_(options),
      channel_(channel),
      mask_storage_(std::make_unique_for_overwrite<std::uint8_t[]>(
          2 * static_cast<std::size_t>(camera.width() * camera.height()))),
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
  for (int k = 0; k < kMaxKeyframes; ++k)
    if (map_.keyframe(k).id != 0) releases_.add(map_.keyframe(k).slot, 1);
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
  Keyframe& kf = map_.insert_keyframe(m.keyframe_place, m.keyframe_id);
  newest_keyframe_id_ = m.keyframe_id;
  kf.sequence = m.sequence;
  kf.slot = m.slot;
  kf.t_capture_ns = m.t_capture_ns;
  kf.pyramid = m.pyramid;
  kf.T_kf_world = T_cam_world;
  kf.velocity = m.velocity;
  kf.median_depth = m.median_depth;
  masks_[static_cast<std::size_t>(m.keyframe_place)].assign(m.mask);
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
  masks_[static_cast<std::size_t>(place)].add(m.mask);
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

Vec2f Mapper::to_global(const Keyframe& kf, const Vec2f& px, const Vec3& p_cam) const {
  if (options_.shutter.readout_s <= 0.0) return px;
  Vec2 unused;
  Mat23 J;
  if (!camera_.project(p_cam, &unused, &J)) return px;
  const Vec2 moved =
      rolling_displacement(options_.shutter, camera_.height(), p_cam, J, static_cast<double>(px.y()), kf.velocity);
  return px - moved.cast<float>();
}

rt::MaskPyramidView Mapper::spread(const CoarseMask& mask, const rt::PyramidView& pyramid) {
  rt::MaskPyramidView out;
  if (mask.empty()) return out;
  out.levels = pyramid.levels;
  std::uint8_t* storage = mask_storage_.get();
  for (int l = 0; l < pyramid.levels; ++l) {
    const int width = pyramid.level[static_cast<std::size_t>(l)].width;
    const int height = pyramid.level[static_cast<std::size_t>(l)].height;
    rt::MutableImageView level{storage, width, height, width};
    storage += static_cast<std::ptrdiff_t>(width) * height;
    for (int y = 0; y < height; ++y) {
      // What lies beyond the last whole cell belongs to it.
      const int row = std::min((y << l) >> CoarseMask::kLevel, mask.rows - 1);
      for (int x = 0; x < width; ++x) {
        const int column = std::min((x << l) >> CoarseMask::kLevel, mask.columns - 1);
        level.row(y)[x] = mask.cell[static_cast<std::size_t>(row * mask.columns + column)];
      }
    }
    out.level[static_cast<std::size_t>(l)] = level;
  }
  return out;
}

void Mapper::create_seeds(int place, const MapperMessage& m) {
  const Keyframe& kf = map_.keyframe(place);
  // Taken already: the keyframe's features, and where older seeds appear in it. Those go on converging; new ones in
  // their place would start from nothing.
  std::array<Vec2f, kMaxKeyframeFeatures + kMaxSeeds> occupied;
  int occupied_count = 0;
  for (; occupied_count < kf.feature_count; ++occupied_count) occupied[occupied_count] = kf.features[occupied_count].px;
  for (const Seed& s : *seeds_) {
    if (!s.active) continue;
    const SE3 T_kf_host = kf.T_kf_world * map_.keyframe(s.place).T_kf_world.inverse();
    Vec2 px;
    if (camera_.project(T_kf_host * (s.feature.bearing / s.estimate.inv_depth), &px) && camera_.in_image(px, 8.0))
      occupied[occupied_count++] = px.cast<float>();
  }
  std::array<Feature, kMaxKeyframeFeatures> found;
  const int wanted = std::min(options_.features_per_keyframe, kMaxKeyframeFeatures);
  const int n = detector_.detect(kf.pyramid, spread(m.mask, kf.pyramid), std::span(occupied.data(), occupied_count),
                                 wanted, std::span(found.data(), static_cast<std::size_t>(wanted)));
  // Older keyframes to search the new seeds in at once: the nearest ones with a baseline worth the work.
  std::array<std::pair<double, int>, kMaxKeyframes> near;
  int near_count = 0;
  for (int k = 0; k < kMaxKeyframes; ++k) {
    const Keyframe& other = map_.keyframe(k);
    if (other.id == 0 || k == place) continue;
    const double base = (other.position() - kf.position()).norm() / kf.median_depth;
    const double cos_axis = kf.T_kf_world.R.row(2).dot(other.T_kf_world.R.row(2));
    if (base < 0.04 || base > 0.6 || cos_axis < 0.85) continue;
    near[near_count++] = {std::abs(base - 0.12), k};
  }
  std::sort(near.begin(), near.begin() + near_count);
  near_count = std::min(near_count, options_.seed_keyframes);

  for (int i = 0; i < n; ++i) {
    // The oldest seed gives way when all places are taken.
    Seed* seed = &(*seeds_)[static_cast<std::size_t>(next_seed_)];
    next_seed_ = (next_seed_ + 1) % kMaxSeeds;
    seed->active = true;
    seed->place = place;
    seed->keyframe_id = kf.id;
    seed->feature = {};
    seed->feature.px = seed->feature.px_global = found[i].px;
    seed->feature.gradient = found[i].gradient;
    seed->feature.level = found[i].level;
    seed->feature.type = found[i].type;
    seed->feature.bearing = camera_.unproject(found[i].px.cast<double>());
    seed->misses = seed->matches = 0;
    seed->agreed = {};
    seed->estimate = DepthEstimate::prior(m.median_depth, m.min_depth);
    for (int k = 0; k < near_count && seed->active; ++k) {
      const Keyframe& other = map_.keyframe(near[k].second);
      update_seed(seed, other.pyramid, masks_[static_cast<std::size_t>(near[k].second)], other.T_kf_world);
    }
  }
}

void Mapper::update_seed(Seed* seed, const rt::PyramidView& pyramid, const CoarseMask& mask, const SE3& T_cam_world) {
  const Keyframe& host = map_.keyframe(seed->place);
  const SE3 T_cur_host = T_cam_world * host.T_kf_world.inverse();
  DepthEstimate& e = seed->estimate;
  // In view at its mean depth?
  Vec2 px;
  if (!camera_.project(T_cur_host * (seed->feature.bearing / e.inv_depth), &px) || !camera_.in_image(px, 8.0)) return;
  // Behind something that moves: neither hit nor miss.
  if (mask.masked(px.cast<float>())) return;
  const double sigma = std::sqrt(e.variance);
  const double inv_max = e.inv_depth + 2.0 * sigma;
  const double inv_min = std::max(e.inv_depth - 2.0 * sigma, 1e-4);
  const PatchSource source{&host.pyramid, &seed->feature, 1.0 / e.inv_depth};
  ++report_.seeds_updated;
  const EpipolarResult r =
      match_epipolar(camera_, source, T_cur_host, pyramid, 1.0 / inv_max, 1.0 / inv_min, kMaxLevel);
  if (!r.match.found) {
    if (r.visible) {
      e.miss();
      if (++seed->misses > kMaxSeedMisses || e.inlier_ratio() < kMinInlierRatio) seed->active = false;
    }
    return;
  }
  if (mask.masked(r.match.px)) return;
  // Found, as it should be, but its ray does not meet the seed's: there is too little motion between the two to tell.
  if (!r.depth_known) return;
  const double angle = options_.match_sigma_px * (1 << r.match.level) * camera_.rad_per_px();
  const Vec3 t_host_cur = -(T_cur_host.R.transpose() * T_cur_host.t);
  const double tau2 = inverse_depth_variance(t_host_cur, seed->feature.bearing, r.depth, angle);
  e.update(1.0 / r.depth, tau2);
  if (!(e.inv_depth > 0.0) || e.inlier_ratio() < kMinInlierRatio) {
    seed->active = false;
    return;
  }
  ++seed->matches;
  // While the tracker starves, a seed will do whose uncertain depth moves it by less than the match noise in the
  // picture at hand: little motion needs little depth.
  const double shift_px = camera_.fx() * t_host_cur.norm() * e.inv_depth * e.relative_sigma();
  const bool hungry = hunger_ > options_.hungry;
  const bool good_enough = hungry && seed->matches >= 3 && shift_px < options_.hungry_shift_px;
  // The filter takes long to rule out that matches are chance. Where several, one after the other, are of one depth,
  // they are not; between movers there is no time to wait.
  seed->agreed.add(1.0 / r.depth, tau2);
  const bool agreed = crowded_ && hungry && !good_enough && seed->agreed.matches() >= options_.agreeing_matches &&
                      seed->agreed.relative_sigma() < options_.starving_sigma;
  if (good_enough || agreed || e.relative_sigma() < sigma_limit_) {
    // No room in this delta: the seed waits for the next one.
    if (delta_->new_point_count >= MapDelta::kMaxNewPoints || delta_->new_feature_count >= MapDelta::kMaxNewFeatures)
      return;
    if (agreed) {
      e.inv_depth = seed->agreed.inv_depth();
      e.variance = seed->agreed.variance();
    }
    seed_to_point(seed);
    seed->active = false;
  }
}

void Mapper::update_seeds(const MapperMessage& m, const SE3& T_cam_world) {
  int done = 0;
  for (int i = 0; i < kMaxSeeds; ++i) {
    // Newest first.
    Seed& s = (*seeds_)[static_cast<std::size_t>((next_seed_ - 1 - i + 2 * kMaxSeeds) % kMaxSeeds)];
    if (!s.active) continue;
    ++report_.seeds;
    if (done >= options_.max_seed_updates) continue;
    const int before = report_.seeds_updated;
    update_seed(&s, m.pyramid, m.mask, T_cam_world);
    done += report_.seeds_updated - before;
  }
}

bool Mapper::seed_to_point(Seed* seed) {
  const Keyframe& host = map_.keyframe(seed->place);
  if (host.feature_count >= kMaxKeyframeFeatures) return false;
  const PointHandle h = map_.free_point();
  if (!h.valid()) return false;
  // Only now is its depth known, and with it what the rolling shutter did to it.
  KeyframeFeature& f = seed->feature;
  f.px_global = to_global(host, f.px, f.bearing / seed->estimate.inv_depth);
  f.bearing = camera_.unproject(f.px_global.cast<double>());
  const Vec3 p = host.T_kf_world.inverse() * (f.bearing / seed->estimate.inv_depth);
  map_.activate_point(h, p);
  seed->feature.point = h;
  map_.append_feature(seed->place, seed->feature);
  const int place_in_delta = delta_->new_point_count++;
  delta_->new_points[place_in_delta] = {h, p};
  delta_->new_features[delta_->new_feature_count++] = {host.id, seed->feature};
  find_observations(h, seed->place);
  MapPoint& point = map_.point(h.index);
  if (point.observation_count >= 2) {
    Vec3 refined = point.p_world;
    const double error = optimize_structure(camera_, map_, point, 4, &refined);
    if (error > kMaxObservationErrorPx) {
      remove_point(h);
      return false;
    }
    point.p_world = refined;
    delta_->new_points[place_in_delta].p_world = refined;
  }
  ++report_.points_new;
  return true;
}

void Mapper::find_observations(PointHandle h, int host) {
  const MapPoint& point = map_.point(h.index);
  const Keyframe& host_kf = map_.keyframe(host);
  const KeyframeFeature source_feature = host_kf.features[host_kf.feature_count - 1];
  const Vec3 d_host = host_kf.position() - point.p_world;
  std::array<std::pair<double, int>, kMaxKeyframes> near;
  int n = 0;
  for (int k = 0; k < kMaxKeyframes; ++k) {
    const Keyframe& kf = map_.keyframe(k);
    if (kf.id == 0 || k == host || kf.feature_count >= kMaxKeyframeFeatures) continue;
    const Vec3 d = kf.position() - point.p_world;
    const double cos_angle = d.dot(d_host) / (d.norm() * d_host.norm());
    if (cos_angle < 0.8) continue;
    near[n++] = {-cos_angle, k};
  }
  std::sort(near.begin(), near.begin() + n);
  int added = 0;
  for (int i = 0; i < n && added < options_.observation_keyframes; ++i) {
    if (delta_->new_feature_count >= MapDelta::kMaxNewFeatures) return;
    const int k = near[i].second;
    const Keyframe& kf = map_.keyframe(k);
    Vec2 px;
    if (!camera_.project(kf.T_kf_world * point.p_world, &px) || !camera_.in_image(px, 8.0)) continue;
    if (masks_[static_cast<std::size_t>(k)].masked(px.cast<float>())) continue;
    const SE3 T_k_host = kf.T_kf_world * host_kf.T_kf_world.inverse();
    const PatchSource source{&host_kf.pyramid, &source_feature, d_host.norm()};
    const MatchResult m = match_direct(camera_, source, T_k_host, kf.pyramid, px.cast<float>(), kMaxLevel);
    if (!m.found || (m.px - px.cast<float>()).norm() > 3.0f * static_cast<float>(1 << m.level)) continue;
    KeyframeFeature f;
    f.px = m.px;
    f.px_global = to_global(kf, m.px, kf.T_kf_world * point.p_world);
    f.gradient = m.gradient;
    f.bearing = camera_.unproject(f.px_global.cast<double>());
    f.level = static_cast<std::int8_t>(m.level);
    f.type = source_feature.type;
    f.point = h;
    if (map_.append_feature(k, f) < 0) continue;
    delta_->new_features[delta_->new_feature_count++] = {kf.id, f};
    ++added;
  }
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

void Mapper::forget_keyframes(int newest) {
  if (map_.keyframe_count() <= options_.max_keyframes || delta_->removed_keyframe_count >= 8) return;
  // The least useful: most of its points are seen by at least three others; if none stands out, the farthest.
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
    const double score = static_cast<double>(redundant) / (seen + 1) + 0.2 * distance;
    if (score > worst_score) {
      worst_score = score;
      worst = k;
    }
  }
  if (worst < 0) return;
  for (Seed& s : *seeds_)
    if (s.active && s.place == worst) s.active = false;
  const Keyframe& kf = map_.keyframe(worst);
  delta_->removed_keyframes[delta_->removed_keyframe_count++] = kf.id;
  releases_.add(kf.slot, 1);
  map_.remove_keyframe(worst);
}

}  // namespace godwit::vo
