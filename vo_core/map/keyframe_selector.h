// When a tracked frame becomes a keyframe: figures of the frame against the map, and pure logic over them.
#pragma once

#include <cstddef>
#include <cstdint>

#include "vo_core/geometry/geometry.h"
#include "vo_core/map/map.h"

namespace godwit::vo {

struct KeyframeSelectorOptions {
  double min_distance = 0.10;           ///< distance to the nearest keyframe over the scene's median depth
  int young_keyframes = 6;              ///< a map with fewer keyframes is still bent: it asks for the next one
  double young_distance = 0.05;         ///< after this distance already
  double min_angle_rad = 0.26;          ///< or turned by this against the nearest keyframe
  int min_frames = 2;                   ///< frames between two keyframes
  int min_frames_on_drop = 4;           ///< more of them when the reason is a lack of features: seeds need time
  double feature_drop = 0.7;            ///< tracked features below this share of the last keyframe's call for one
  int low_features = 90;                ///< and so do fewer than this
  double min_distance_on_drop = 0.01;   ///< but not without any motion,
  double min_angle_on_drop_rad = 0.03;  ///< nor without any turn
  double uncovered_share = 0.08;        ///< of the picture that movers have laid bare since the last keyframe
};

struct KeyframeFigures {
  static constexpr double kNone = 1e9;  ///< there is no such keyframe
  int keyframes = 0;                    ///< in the map
  int frames_since_last = 0;
  int features = 0;                ///< inliers of this frame
  int last_keyframe_features = 0;  ///< inliers of the last keyframe when it was made
  double nearest_distance = 0.0;   ///< to the nearest keyframe that looks the same way, over median depth
  double nearest_angle_rad = 0.0;  ///< turned, or rolled, against the keyframe at this place that is so least
  double last_distance = 0.0;      ///< to the last keyframe, over median depth
  double last_angle_rad = 0.0;     ///< turned against the last keyframe
  double uncovered = 0.0;          ///< share of the picture masked in the last keyframe and free now
};

enum class KeyframeReason : std::uint8_t { kNone, kMoved, kTurned, kFeaturesDropped, kUncovered };

inline const char* keyframe_reason_name(KeyframeReason reason) {
  constexpr const char* kNames[] = {"", "moved", "turned", "features dropped", "uncovered"};
  return kNames[static_cast<std::size_t>(reason)];
}

/// Fills keyframes, nearest_* and last_* (that against keyframe `last_id`; left alone where there is none such).
/// median_depth: of the scene, map units. No allocation.
void compare_with_keyframes(const KeyframeSelectorOptions& o, const Map& map, const SE3& T_cam_world,
                            double median_depth, std::uint32_t last_id, KeyframeFigures* f);

inline KeyframeReason select_keyframe(const KeyframeSelectorOptions& o, const KeyframeFigures& f) {
  if (f.frames_since_last < o.min_frames) return KeyframeReason::kNone;
  if (f.nearest_distance > (f.keyframes < o.young_keyframes ? o.young_distance : o.min_distance)) {
    const bool only_turned = f.nearest_distance == KeyframeFigures::kNone && f.nearest_angle_rad > o.min_angle_rad &&
                             f.nearest_angle_rad < KeyframeFigures::kNone;
    return only_turned ? KeyframeReason::kTurned : KeyframeReason::kMoved;
  }
  const bool dropped = f.features < o.low_features || f.features < o.feature_drop * f.last_keyframe_features;
  if (dropped && f.frames_since_last >= o.min_frames_on_drop &&
      (f.last_distance > o.min_distance_on_drop || f.last_angle_rad > o.min_angle_on_drop_rad))
    return KeyframeReason::kFeaturesDropped;
  // What comes into view there soon has to carry the pose, before the movers have covered the rest.
  if (f.uncovered > o.uncovered_share) return KeyframeReason::kUncovered;
  return KeyframeReason::kNone;
}

}  // namespace godwit::vo
