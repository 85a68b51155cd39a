// Which keyframe shows what the camera sees now, and about which way the camera is turned against it: first guesses for
// finding back into the map. What is guessed here is proved or refused by alignment and a full pose check (tracker.h).
#pragma once

#include <array>
#include <cstdint>

#include "hal/rt/image.h"
#include "vo_core/geometry/camera_model.h"
#include "vo_core/image/thumbnail.h"
#include "vo_core/map/map.h"

namespace godwit::vo {

struct RelocaliserOptions {
  float min_correlation = 0.45f;  ///< thumbnails that resemble less are not tried
  int ranks = 8;                  ///< so many of the best keyframes are tried in turns; at least 2
  double roll_step_rad = 0.35;    ///< every fourth attempt is compared turned about its axis by so much more
};

/// A guess: what cur shows is what the keyframe saw, turned.
struct RelocalisationGuess {
  int place = -1;  ///< of the keyframe, -1: nothing resembles
  float correlation = 0.0f;
  SE3 T_cur_kf;  ///< by likeness: rotation only
};

/// Fixed storage. One thread, the tracker's.
class Relocaliser {
 public:
  Relocaliser(const CameraModel& camera, const RelocaliserOptions& options) : camera_(camera), options_(options) {}

  /// Keeps the tiny picture of a new keyframe.
  void add_keyframe(int place, std::uint32_t id, const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask);

  /// The guess number `attempt`, counted over the frames of one search: best and others, upright and turned, in
  /// turns. Compares with
  /// every keyframe of the map that has points: at most kMaxKeyframes thumbnail matches. No allocation.
  RelocalisationGuess guess(const Map& map, const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask,
                            int attempt) const;
  /// From where the camera should be: the keyframe with most of its points in that view, turned and moved against it
  /// so. At most all points of all keyframes are projected. No allocation.
  RelocalisationGuess expect(const Map& map, const SE3& T_cam_world) const;

 private:
  struct Entry {
    std::uint32_t keyframe_id = 0;
    Thumbnail thumbnail;
  };

  const CameraModel& camera_;
  RelocaliserOptions options_;
  std::array<Entry, kMaxKeyframes> entries_;
};

}  // namespace godwit::vo
