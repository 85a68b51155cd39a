// What tracker and mapper tell each other (docs/architecture.md). Plain bounded data, passed by ring.
//
// The tracker alone writes its map. It sends every tracked frame and every keyframe; the mapper keeps a replica, runs
// seeds and bundle adjustment on it and answers with deltas. Both sides append features to a keyframe in the same
// order, so a feature is named by {keyframe id, index} on both. Messages of another epoch are dropped.
#pragma once

#include <array>
#include <cstdint>

#include "hal/rt/image.h"
#include "hal/rt/time.h"
#include "vo_core/geometry/camera_model.h"
#include "vo_core/image/coarse_mask.h"
#include "vo_core/map/map.h"
#include "vo_core/map/pose_certainty.h"

namespace godwit::vo {

/// Features that one tracked frame may carry.
constexpr int kMaxFrameFeatures = 240;

/// One image measurement of a map point in a tracked frame.
struct FrameFeature {
  Vec2f px = Vec2f::Zero();         ///< where the patch lies in the picture
  Vec2f px_global = Vec2f::Zero();  ///< freed of the rolling shutter (rolling_shutter.h)
  Vec2f gradient = Vec2f::UnitX();
  PointHandle point;
  std::int8_t level = 0;
  FeatureType type = FeatureType::kCorner;
  bool shaded = false;  ///< inside the mask, but plainly seen: for the pose only
};

/// What a keyframe keeps of a frame's measurement. Tracker and mapper both make their keyframes of this, so that the
/// two maps stay equal.
inline KeyframeFeature keyframe_feature(const CameraModel& camera, const FrameFeature& f) {
  KeyframeFeature out;
  out.px = f.px;
  out.px_global = f.px_global;
  out.gradient = f.gradient;
  out.bearing = camera.unproject(f.px_global.cast<double>());
  out.point = f.point;
  out.level = f.level;
  out.type = f.type;
  return out;
}

enum class MessageKind : std::uint8_t {
  kReset,     ///< forget everything; the next messages belong to `epoch`
  kFrame,     ///< a tracked frame: update seeds with it
  kKeyframe,  ///< a keyframe: observations, new seeds, bundle adjustment
  kLateMask   ///< what is known by now to have moved in a keyframe: what it took from there goes
};

/// Tracker -> mapper. Carries one reference to the frame slot; the mapper gives it back.
struct MapperMessage {
  MessageKind kind = MessageKind::kFrame;
  std::uint32_t epoch = 0;
  std::uint32_t sequence = 0;  ///< tracker's frame counter
  int slot = -1;
  rt::PyramidView pyramid;
  rt::TimeNs t_capture_ns = 0;
  /// Pose relative to a keyframe that the receiver has: where that has moved meanwhile, the frame has with it. Id 0:
  /// the world, for the first keyframe.
  std::uint32_t anchor_id = 0;
  SE3 T_cam_anchor;
  ReadoutMotion motion;
  int tracked_features = 0;  ///< measurements of this frame
  double median_depth = 1.0;
  double min_depth = 0.5;
  CoarseMask mask;  ///< dynamic pixels: no seed begins or matches there

  // Keyframes and late masks:
  std::uint32_t keyframe_id = 0;
  int keyframe_place = -1;

  // Keyframes only:
  bool initial = false;  ///< one of the two first keyframes: initial_points gives the positions of the points it names
  int feature_count = 0;
  std::array<FrameFeature, kMaxFrameFeatures> features;
  std::array<Vec3f, kMaxFrameFeatures> initial_points;

  // Points that should have been seen and were not often enough: the mapper decides about them.
  int weak_count = 0;
  std::array<PointHandle, 64> weak;
};

struct DeltaNewFeature {
  std::uint32_t keyframe_id = 0;
  KeyframeFeature feature;  ///< feature.point names an active point, or one of this delta's new points
};
struct DeltaNewPoint {
  PointHandle point;
  Vec3 p_world;
};
struct DeltaMovedKeyframe {
  std::uint32_t keyframe_id = 0;
  SE3 T_kf_world;
};
struct DeltaObservation {
  std::uint32_t keyframe_id = 0;
  std::uint16_t feature = 0;
};

/// Mapper -> tracker: applied between two frames, in the order of the members. Bounded by its arrays; the mapper never
/// puts in more (what does not fit waits for the next delta).
struct MapDelta {
  static constexpr int kMaxNewPoints = 256;
  static constexpr int kMaxNewFeatures = 1024;
  static constexpr int kMaxMovedPoints = 4000;
  static constexpr int kMaxRemoved = 512;
  static constexpr int kMaxRemovedKeyframes = 8;

  std::uint32_t epoch = 0;
  std::uint32_t sequence = 0;            ///< frame counter of the message that caused it
  std::uint32_t newest_keyframe_id = 0;  ///< that the mapper had: the tracker moves those after it with their anchors
  int removed_observation_count = 0;
  int removed_point_count = 0;
  int removed_keyframe_count = 0;
  int moved_keyframe_count = 0;
  int moved_point_count = 0;
  int new_point_count = 0;
  int new_feature_count = 0;
  std::array<DeltaObservation, kMaxRemoved> removed_observations;
  std::array<PointHandle, kMaxRemoved> removed_points;
  std::array<std::uint32_t, kMaxRemovedKeyframes> removed_keyframes;
  std::array<DeltaMovedKeyframe, kMaxKeyframes> moved_keyframes;
  std::array<DeltaNewPoint, kMaxMovedPoints> moved_points;
  std::array<DeltaNewPoint, kMaxNewPoints> new_points;
  std::array<DeltaNewFeature, kMaxNewFeatures> new_features;
  MapShares shares;  ///< how certain the moved keyframes are

  void clear() {
    removed_observation_count = removed_point_count = removed_keyframe_count = moved_keyframe_count = 0;
    moved_point_count = new_point_count = new_feature_count = 0;
    shares.centre = 0;
    shares.count = 0;
  }
  bool empty() const {
    return removed_observation_count + removed_point_count + removed_keyframe_count + moved_keyframe_count +
               moved_point_count + new_point_count + new_feature_count + shares.count ==
           0;
  }
};

/// References that are no longer needed: `count` references to frame slot `slot`.
struct SlotRelease {
  int slot = -1;
  int count = 0;
};

}  // namespace godwit::vo
