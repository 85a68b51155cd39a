// The map: keyframes, points and who saw what, in fixed storage. The tracker writes one instance, the mapper another
// (its replica); they are kept equal by messages and deltas (map_exchange.h), never by sharing.
#pragma once

#include <array>
#include <cstdint>
#include <memory>

#include "hal/rt/image.h"
#include "hal/rt/time.h"
#include "vo_core/features/feature_detector.h"
#include "vo_core/geometry/geometry.h"
#include "vo_core/geometry/rolling_shutter.h"

namespace godwit::vo {

constexpr int kMaxKeyframes = 64;
constexpr int kMaxPoints = 6000;
constexpr int kMaxKeyframeFeatures = 400;
constexpr int kMaxPointObservations = 32;

/// Names a point for as long as it lives: the slot's generation changes when the point is deleted.
struct PointHandle {
  static constexpr std::uint16_t kNone = 0xffff;
  std::uint16_t index = kNone;
  std::uint16_t generation = 0;

  bool valid() const { return index != kNone; }
  bool operator==(const PointHandle&) const = default;
};

/// A feature of a keyframe. Its place in the keyframe's array never changes, so both replicas name it by index.
struct KeyframeFeature {
  Vec2f px = Vec2f::Zero();  ///< level-0 pixels: where the patch lies in the picture
  Vec2f px_global =
      Vec2f::Zero();  ///< the same as a global shutter would have seen it at capture time: what geometry uses
  Vec2f gradient = Vec2f::UnitX();  ///< unit direction across the edge (edgelets)
  Vec3 bearing = Vec3::UnitZ();     ///< unit vector of px_global, keyframe's camera frame
  PointHandle point;                ///< the map point it observes, if any
  std::int8_t level = 0;            ///< pyramid level on which it was found or aligned
  FeatureType type = FeatureType::kCorner;
};

/// What a keyframe is filled with, on the tracker's side and on the mapper's: its picture, when and from where it was
/// taken.
struct KeyframeView {
  std::uint32_t sequence = 0;
  int slot = -1;  ///< frame slot whose picture it holds
  rt::TimeNs t_capture_ns = 0;
  rt::PyramidView pyramid;
  SE3 T_kf_world;
  ReadoutMotion motion;
  double median_depth = 1.0;
};

struct Keyframe : KeyframeView {
  std::uint32_t id = 0;  ///< counts from 1 within an epoch; 0: this place is free
  int feature_count = 0;
  std::array<KeyframeFeature, kMaxKeyframeFeatures> features;
  /// The features' points once more, side by side: each frame asks for these of all of them.
  std::array<PointHandle, kMaxKeyframeFeatures> points;

  Vec3 position() const { return T_kf_world.centre(); }
};

struct Observation {
  std::uint8_t keyframe = 0;  ///< place in Map::keyframes
  std::uint16_t feature = 0;  ///< place in Keyframe::features
};

/// What each frame looks at, and the first five observations, lie in one line of the cache.
struct alignas(64) MapPoint {
  Vec3 p_world = Vec3::Zero();
  std::uint16_t generation = 0;
  bool active = false;
  std::uint8_t observation_count = 0;
  std::uint16_t found = 0;      ///< frames in which the tracker aligned it
  std::uint16_t missed = 0;     ///< frames in which it should have been seen and was not
  std::uint32_t last_mark = 0;  ///< tracker: the last projection that looked at it (a visited mark)
  std::uint32_t next_mark = 0;  ///< tracker: the first projection that tries it again, before those of the rest it has
  bool vouched = false;         ///< tracker: a pose agreed with it that others vouched for
  std::uint8_t rest = 0;        ///< tracker: projections that it is left out of, one more with each miss in a row
  std::array<Observation, kMaxPointObservations> observations;
};

/// Fixed-capacity map. One writer thread. Only the constructor allocates.
class Map {
 public:
  Map();

  void clear();

  MapPoint* find(PointHandle h) {
    MapPoint& p = points_[h.index < kMaxPoints ? h.index : 0];
    return h.valid() && p.active && p.generation == h.generation ? &p : nullptr;
  }
  const MapPoint* find(PointHandle h) const { return const_cast<Map*>(this)->find(h); }

  /// Asks for what find() looks at, and the point's place: points lie in no order that a processor would foresee.
  void prefetch(PointHandle h) const;

  MapPoint& point(int index) { return points_[index]; }
  const MapPoint& point(int index) const { return points_[index]; }
  Keyframe& keyframe(int place) { return keyframes_[place]; }
  const Keyframe& keyframe(int place) const { return keyframes_[place]; }
  int keyframe_count() const { return keyframe_count_; }
  int point_count() const { return point_count_; }
  /// One more than the largest point index in use.
  int point_end() const { return point_end_; }

  /// A free place for a keyframe, or -1.
  int free_keyframe_place() const;
  /// A handle for a new point, or an invalid one when the map is full. Does not activate it.
  PointHandle free_point();

  /// Takes the place for a keyframe and returns it, without features. Precondition: the place is free.
  Keyframe& insert_keyframe(int place, std::uint32_t id, const KeyframeView& view = {});
  /// Frees the place; observations from it are removed, points left without any are deleted.
  void remove_keyframe(int place);

  void activate_point(PointHandle h, const Vec3& p_world);
  /// Deletes the point and detaches it from every keyframe feature that observes it. Stale handles are ignored.
  void remove_point(PointHandle h);

  /// Appends a feature; returns its index or -1 when the keyframe is full. A valid point handle that is alive gets the
  /// observation (if its list has room; if not, the feature keeps no point).
  int append_feature(int place, const KeyframeFeature& feature);
  /// Detaches feature `index` of the keyframe from its point; the point is deleted when nothing else observes it.
  void remove_observation(int place, int index);

  /// Place of the keyframe with this id, or -1.
  int find_keyframe(std::uint32_t id) const;

 private:
  struct Storage {
    std::array<Keyframe, kMaxKeyframes> keyframes;
    std::array<MapPoint, kMaxPoints> points;
  };
  void erase_observation(MapPoint& p, int place, int index);
  void set_point(int place, int feature, PointHandle h) {
    keyframes_[place].features[feature].point = keyframes_[place].points[feature] = h;
  }

  std::unique_ptr<Storage> storage_;
  Keyframe* keyframes_;
  MapPoint* points_;
  int keyframe_count_ = 0;
  int point_count_ = 0;
  int point_end_ = 0;
  int next_free_point_ = 0;
};

}  // namespace godwit::vo
