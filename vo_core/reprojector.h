// Projects the map into a frame, cell by cell, and aligns the chosen points (Forster et al. 2014, section IV-B; the
// paper, 2.5).
#pragma once

#include <array>
#include <cstdint>

#include "hal/rt/image.h"
#include "vo_core/camera_model.h"
#include "vo_core/map.h"
#include "vo_core/map_exchange.h"
#include "vo_core/rolling_shutter.h"

namespace godwit::vo {

struct ReprojectorOptions {
  int cell_px = 28;
  int max_features = 170;
  int max_trials = 360;
  int max_keyframes = 12;
  int max_level = 3;
  RollingShutter shutter;
};

struct ReprojectionResult {
  int keyframes = 0;   ///< overlapping keyframes whose points were projected
  int candidates = 0;  ///< points that fall into the picture
  int trials = 0;
  int matches = 0;
};

/// Fixed buffers; run() does not allocate and tries at most max_trials alignments.
class Reprojector {
 public:
  Reprojector(const CameraModel& camera, const ReprojectorOptions& options);

  /// Finds map points in the frame, up to `wanted` and at most max_features. Writes the matches to out
  /// (kMaxFrameFeatures long). Updates found/missed of the points. `frame` is the tracker's frame counter (marks points
  /// already projected).
  ReprojectionResult run(Map* map, const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask,
                         const SE3& T_cam_world, const Vec6& velocity, std::uint32_t frame, int wanted,
                         FrameFeature* out);

 private:
  struct Candidate {
    PointHandle point;
    Vec2f px;
    std::uint16_t next;    ///< list of the cell
    std::uint16_t weight;  ///< better candidates first
  };
  static constexpr int kMaxCandidates = 2400;
  static constexpr int kMaxCells = 4096;
  static constexpr std::uint16_t kEnd = 0xffff;

  void collect(Map* map, const rt::MaskPyramidView& mask, const SE3& T_cam_world, const Vec6& velocity,
               std::uint32_t frame, ReprojectionResult* result);
  bool try_match(Map* map, const Candidate& c, const rt::PyramidView& pyramid, const SE3& T_cam_world,
                 FrameFeature* out);

  const CameraModel& camera_;
  ReprojectorOptions options_;
  int columns_, rows_;
  int candidate_count_ = 0;
  std::array<Candidate, kMaxCandidates> candidates_;
  std::array<std::uint16_t, kMaxCells> cell_head_;
  std::array<std::uint16_t, kMaxCells> cell_order_;
  std::array<Vec3, kMaxKeyframes> keyframe_position_;
};

}  // namespace godwit::vo
