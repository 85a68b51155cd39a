#include "vo_core/map/map.h"

#include <algorithm>
#include <cassert>
#include <hwy/cache_control.h>

namespace godwit::vo {

Map::Map()
    : storage_(std::make_unique<Storage>()), keyframes_(storage_->keyframes.data()), points_(storage_->points.data()) {}

void Map::clear() {
  for (int i = 0; i < kMaxKeyframes; ++i) {
    keyframes_[i].id = 0;
    keyframes_[i].feature_count = 0;
    keyframes_[i].slot = -1;
  }
  for (int i = 0; i < point_end_; ++i) {
    if (points_[i].active) ++points_[i].generation;
    points_[i].active = false;
    points_[i].observation_count = 0;
  }
  keyframe_count_ = point_count_ = point_end_ = next_free_point_ = 0;
}

void Map::prefetch(PointHandle h) const {
  hwy::Prefetch(&points_[h.index < kMaxPoints ? h.index : 0]);
}

int Map::free_keyframe_place() const {
  for (int i = 0; i < kMaxKeyframes; ++i)
    if (keyframes_[i].id == 0) return i;
  return -1;
}

int Map::find_keyframe(std::uint32_t id) const {
  for (int i = 0; i < kMaxKeyframes; ++i)
    if (keyframes_[i].id == id && id != 0) return i;
  return -1;
}

PointHandle Map::free_point() {
  for (int n = 0; n < kMaxPoints; ++n) {
    const int i = (next_free_point_ + n) % kMaxPoints;
    if (!points_[i].active) {
      next_free_point_ = i;
      return {static_cast<std::uint16_t>(i), points_[i].generation};
    }
  }
  return {};
}

Keyframe& Map::insert_keyframe(int place, std::uint32_t id, const KeyframeView& view) {
  assert(keyframes_[place].id == 0 && id != 0);
  Keyframe& kf = keyframes_[place];
  static_cast<KeyframeView&>(kf) = view;
  kf.id = id;
  kf.feature_count = 0;
  ++keyframe_count_;
  return kf;
}

void Map::erase_observation(MapPoint& p, int place, int index) {
  for (int i = 0; i < p.observation_count; ++i) {
    if (p.observations[i].keyframe == place && p.observations[i].feature == index) {
      for (int j = i + 1; j < p.observation_count; ++j) p.observations[j - 1] = p.observations[j];
      --p.observation_count;
      return;
    }
  }
}

void Map::remove_observation(int place, int index) {
  const PointHandle h = keyframes_[place].features[index].point;
  MapPoint* p = find(h);
  set_point(place, index, {});
  if (!p) return;
  erase_observation(*p, place, index);
  if (p->observation_count == 0) remove_point(h);
}

void Map::remove_keyframe(int place) {
  Keyframe& kf = keyframes_[place];
  if (kf.id == 0) return;
  for (int i = 0; i < kf.feature_count; ++i) remove_observation(place, i);
  kf.id = 0;
  kf.feature_count = 0;
  kf.slot = -1;
  --keyframe_count_;
}

void Map::activate_point(PointHandle h, const Vec3& p_world) {
  MapPoint& p = points_[h.index];
  assert(!p.active);
  p.generation = h.generation;
  p.active = true;
  p.p_world = p_world;
  p.observation_count = 0;
  p.found = p.missed = 0;
  p.last_mark = p.next_mark = 0;
  p.rest = 0;
  p.vouched = false;
  ++point_count_;
  point_end_ = std::max(point_end_, h.index + 1);
}

void Map::remove_point(PointHandle h) {
  MapPoint* p = find(h);
  if (!p) return;
  for (int i = 0; i < p->observation_count; ++i) {
    const Observation& o = p->observations[i];
    set_point(o.keyframe, o.feature, {});
  }
  p->observation_count = 0;
  p->active = false;
  ++p->generation;
  --point_count_;
}

int Map::append_feature(int place, const KeyframeFeature& feature) {
  Keyframe& kf = keyframes_[place];
  if (kf.feature_count >= kMaxKeyframeFeatures) return -1;
  const int index = kf.feature_count++;
  kf.features[index] = feature;
  kf.points[index] = feature.point;
  MapPoint* p = find(feature.point);
  if (p && p->observation_count < kMaxPointObservations) {
    p->observations[p->observation_count++] = {static_cast<std::uint8_t>(place), static_cast<std::uint16_t>(index)};
  } else {
    set_point(place, index, {});
  }
  return index;
}

}  // namespace godwit::vo
