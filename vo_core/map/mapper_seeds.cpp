// The mapper's seeds: where they begin, how frames tell their depth, and how they become points that keyframes observe.
#include <algorithm>
#include <cmath>

#include "vo_core/image/levels.h"
#include "vo_core/map/mapper.h"
#include "vo_core/map/matcher.h"
#include "vo_core/map/structure_optimizer.h"

namespace godwit::vo {
namespace {
constexpr int kMaxSeedMisses = 20;
constexpr double kMinInlierRatio = 0.35;
constexpr double kMaxObservationErrorPx = 2.0;
constexpr int kMaxLevel = 3;
}  // namespace

rt::MaskPyramidView Mapper::spread(const CoarseMask& mask, const rt::PyramidView& pyramid) {
  rt::MaskPyramidView out;
  if (mask.empty()) return out;
  out.levels = pyramid.levels;
  std::uint8_t* storage = mask_storage_.get();
  for (int l = 0; l < pyramid.levels; ++l) {
    const int width = pyramid.level[l].width;
    const int height = pyramid.level[l].height;
    rt::MutableImageView level{storage, width, height, width};
    storage += static_cast<std::ptrdiff_t>(width) * height;
    for (int y = 0; y < height; ++y) {
      // What lies beyond the last whole cell belongs to it.
      const int row = std::min((y << l) >> CoarseMask::kLevel, mask.rows - 1);
      for (int x = 0; x < width; ++x) {
        const int column = std::min((x << l) >> CoarseMask::kLevel, mask.columns - 1);
        level.row(y)[x] = mask.cell[row * mask.columns + column];
      }
    }
    out.level[l] = level;
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
                                 wanted, std::span(found.data(), wanted));
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
  std::array<SE3, kMaxKeyframes> T_near_kf;
  const SE3 T_world_kf = kf.T_kf_world.inverse();
  for (int k = 0; k < near_count; ++k) T_near_kf[k] = map_.keyframe(near[k].second).T_kf_world * T_world_kf;

  for (int i = 0; i < n; ++i) {
    // The oldest seed gives way when all places are taken.
    Seed* seed = &(*seeds_)[next_seed_];
    next_seed_ = (next_seed_ + 1) % kMaxSeeds;
    seed->active = true;
    seed->place = place;
    seed->keyframe_id = kf.id;
    seed->feature = {};
    seed->feature.px = found[i].px;
    seed->feature.gradient = found[i].gradient;
    seed->feature.level = found[i].level;
    seed->feature.type = found[i].type;
    // What the rolling shutter did to it is mostly a turn's doing, and that is the same at any depth.
    place_feature(&seed->feature, kf, m.median_depth * camera_.unproject(found[i].px.cast<double>()));
    seed->misses = seed->matches = 0;
    seed->agreed = {};
    seed->estimate = DepthEstimate::prior(m.median_depth, m.min_depth);
    for (int k = 0; k < near_count && seed->active; ++k) {
      const Keyframe& other = map_.keyframe(near[k].second);
      const CoarseMask& mask = masks_[near[k].second];
      if (in_view(*seed, mask, T_near_kf[k])) update_seed(seed, other.pyramid, mask, T_near_kf[k], other.motion);
    }
  }
}

bool Mapper::in_view(const Seed& seed, const CoarseMask& mask, const SE3& T_cur_host) const {
  Vec2 px;
  if (!camera_.project(T_cur_host * (seed.feature.bearing / seed.estimate.inv_depth), &px)) return false;
  // Behind something that moves: neither hit nor miss.
  return camera_.in_image(px, 8.0) && !mask.masked(px.cast<float>());
}

void Mapper::update_seed(Seed* seed, const rt::PyramidView& pyramid, const CoarseMask& mask, const SE3& T_cur_host,
                         const ReadoutMotion& motion) {
  const Keyframe& host = map_.keyframe(seed->place);
  DepthEstimate& e = seed->estimate;
  const double sigma = std::sqrt(e.variance);
  const double inv_max = e.inv_depth + 2.0 * sigma;
  const double inv_min = std::max(e.inv_depth - 2.0 * sigma, 1e-4);
  const PatchSource source{&host.pyramid, &seed->feature, 1.0 / e.inv_depth};
  ++report_.seeds_updated;
  const Vec2 displaced = displacement(T_cur_host * (seed->feature.bearing / e.inv_depth), motion);
  const EpipolarResult r =
      match_epipolar(camera_, source, T_cur_host, pyramid, 1.0 / inv_max, 1.0 / inv_min, kMaxLevel, displaced);
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
  std::array<SE3, kMaxKeyframes> T_cur_kf;
  for (int k = 0; k < kMaxKeyframes; ++k)
    if (map_.keyframe(k).id != 0) T_cur_kf[k] = T_cam_world * map_.keyframe(k).T_kf_world.inverse();
  std::array<std::int16_t, kMaxSeeds> chosen;
  int count = 0;
  for (int i = 0; i < kMaxSeeds; ++i) {
    // Newest first.
    const int place = (next_seed_ - 1 - i + 2 * kMaxSeeds) % kMaxSeeds;
    const Seed& s = (*seeds_)[place];
    if (!s.active) continue;
    ++report_.seeds;
    if (count < options_.max_seed_updates && in_view(s, m.mask, T_cur_kf[s.place]))
      chosen[count++] = static_cast<std::int16_t>(place);
  }
  for (int i = 0; i < count; ++i) {
    // A keyframe's picture lies in no cache: its pixels are asked for while the seed before is searched.
    if (i + 1 < count) {
      const Seed& next = (*seeds_)[chosen[i + 1]];
      prefetch_patch(map_.keyframe(next.place).pyramid, next.feature);
    }
    Seed& s = (*seeds_)[chosen[i]];
    update_seed(&s, m.pyramid, m.mask, T_cur_kf[s.place], m.motion);
  }
}

bool Mapper::seed_to_point(Seed* seed) {
  const Keyframe& host = map_.keyframe(seed->place);
  if (host.feature_count >= kMaxKeyframeFeatures) return false;
  const PointHandle h = map_.free_point();
  if (!h.valid()) return false;
  // Only now is its depth known, and with it all that the rolling shutter did to it.
  KeyframeFeature& f = seed->feature;
  place_feature(&f, host, f.bearing / seed->estimate.inv_depth);
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
    if (masks_[k].masked(px.cast<float>())) continue;
    const SE3 T_k_host = kf.T_kf_world * host_kf.T_kf_world.inverse();
    const PatchSource source{&host_kf.pyramid, &source_feature, d_host.norm()};
    const MatchResult m = match_direct(camera_, source, T_k_host, kf.pyramid, px.cast<float>(), kMaxLevel);
    if (!m.found || (m.px - px.cast<float>()).norm() > 3.0f * level_scale(m.level)) continue;
    KeyframeFeature f;
    f.px = m.px;
    place_feature(&f, kf, kf.T_kf_world * point.p_world);
    f.gradient = m.gradient;
    f.level = static_cast<std::int8_t>(m.level);
    f.type = source_feature.type;
    f.point = h;
    if (map_.append_feature(k, f) < 0) continue;
    delta_->new_features[delta_->new_feature_count++] = {kf.id, f};
    ++added;
  }
}

}  // namespace godwit::vo
