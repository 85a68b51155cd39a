// Projects the map into a frame, cell by cell, and aligns the chosen points (Forster et al. 2014, section IV-B; the
// paper, 2.5).
#pragma once

#include <array>
#include <cstdint>

#include "hal/rt/image.h"
#include "vo_core/geometry/camera_model.h"
#include "vo_core/geometry/rolling_shutter.h"
#include "vo_core/map/map.h"
#include "vo_core/map/map_exchange.h"
#include "vo_core/tracking/patch_store.h"

namespace godwit::vo {

struct ReprojectorOptions {
  int cell_px = 28;
  int max_features = 170;
  int max_trials = 360;  ///< points; at most 512
  int max_keyframes = 12;
  int max_level = 3;
  /// Levels above a point's own on which it is looked for again: motion blur takes the fine levels first.
  int coarser_levels = 1;
  /// Fewer matches outside the mask than this: points inside it are looked for as well, if older frames have proved
  /// them. A box holds much that does not move, and the picture itself shows whether the point is hidden.
  int scarce_matches = 100;
  int proven_observations = 3;
  /// Most frames for which a point rests that was not found, one more with each miss in a row: of those missed five
  /// times in a row 85 in 100 were missed again (fr1_xyz), and half of all trials that failed were theirs. With fewer
  /// matches than plenty_matches they are tried all the same.
  int longest_rest = 8;
  int plenty_matches = 140;
  float shaded_residual = 0.5f;  ///< greatest residual over contrast of a match inside the mask
  RollingShutter shutter;
};

struct ReprojectionResult {
  int keyframes = 0;   ///< overlapping keyframes whose points were projected
  int candidates = 0;  ///< points that fall into the picture
  int trials = 0;      ///< of points outside the mask
  int matches = 0;
  int shaded = 0;  ///< of them inside the mask
};

/// Fixed buffers; run() does not allocate and tries at most max_trials alignments.
class Reprojector {
 public:
  Reprojector(const CameraModel& camera, const ReprojectorOptions& options);

  /// Finds map points in the frame, up to `wanted` and at most max_features. Writes the matches to out
  /// (kMaxFrameFeatures long). `mark` differs from call to call (marks points already projected). `coarser`: what is
  /// not found is looked for on coarser_levels, too: motion blur hides what is fine. Costs trials, so only where the
  /// pose continues that of the last picture: elsewhere chance alikeness on them let false poses pass after blurred
  /// pictures.
  ReprojectionResult run(Map* map, const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask,
                         const SE3& T_cam_world, const ReadoutMotion& motion, bool coarser, std::uint32_t mark,
                         int wanted, FrameFeature* out);

  /// Writes found and missed of the last run into the points. Only for a run whose pose stood: a black picture or a
  /// wrong guess says nothing about the points.
  void keep_score(Map* map) const;

 private:
  struct Candidate {
    PointHandle point;
    Vec2f px;
    std::uint16_t next;     ///< list of the cell
    std::uint16_t weight;   ///< better candidates first
    std::int8_t keyframe;   ///< that its patch is taken from; kUnchosen, or kNone: none looks at it from about here
    std::uint16_t feature;  ///< there
  };
  static constexpr std::int8_t kUnchosen = -2, kNone = -1;
  static_assert(kMaxKeyframes <= 127);
  static constexpr int kMaxCandidates = 2400;
  static constexpr int kMaxCells = 4096;
  static constexpr int kMaxTrials = 512;
  static constexpr std::uint16_t kEnd = 0xffff;

  void collect(Map* map, const rt::MaskPyramidView& mask, const SE3& T_cam_world, const ReadoutMotion& motion,
               std::uint32_t mark, ReprojectionResult* result);
  /// Where the first `points` of p_world_ appear: u_, v_ and seen_.
  void project(int points, const SE3& T_cam_world, const ReadoutMotion& motion);
  void add_candidate(const Map& map, PointHandle point, const Vec2& px, const rt::MaskPyramidView& mask);
  using CellLists = std::array<std::uint16_t, kMaxCells>;
  void run_free(const Map& map, const rt::PyramidView& pyramid, int limit, CellLists* lists, ReprojectionResult* result,
                FrameFeature* out);
  void run_shaded(const Map& map, const rt::PyramidView& pyramid, int limit, ReprojectionResult* result,
                  FrameFeature* out);
  /// Chooses the candidate's patch and asks for its pixels: keyframes' pictures lie in no cache, and a trial that waits
  /// for ten of their rows costs twice what it computes. Nothing where that is done already; `index` may be kEnd.
  void make_ready(const Map& map, std::uint16_t index);
  bool try_match(const Map& map, std::uint16_t index, const rt::PyramidView& pyramid, float max_residual,
                 FrameFeature* out);

  const CameraModel& camera_;
  ReprojectorOptions options_;
  /// Row or column of the cell at this place in the picture: a division, rounded down. Exact below 2^20 / cell_px.
  int cell_of(double at_px) const { return static_cast<int>((static_cast<unsigned>(at_px) * per_cell_) >> kCellShift); }
  static constexpr int kCellShift = 20;
  static_assert(rt::kMaxImageWidth <= 1 << 11 && rt::kMaxImageHeight <= 1 << 11);
  unsigned per_cell_ = 0;
  int columns_, rows_;
  // The points of one keyframe, coordinate by coordinate.
  using Row = std::array<double, CameraModel::row_room(kMaxKeyframeFeatures)>;
  std::array<Row, 3> p_world_{}, p_cam_{};
  Row u_{}, v_{}, seen_{};
  std::array<Row, 6> J_{};
  std::array<PointHandle, kMaxKeyframeFeatures> seen_point_;
  int candidate_count_ = 0;
  int coarser_ = 0;               ///< of the run at hand
  std::uint32_t mark_ = 0;        ///< of the run at hand
  Vec3 position_ = Vec3::Zero();  ///< the camera's, of the run at hand
  struct Trial {
    std::uint16_t point;
    bool found;
  };
  int trial_count_ = 0;
  std::array<Trial, kMaxTrials> trials_;
  std::array<Candidate, kMaxCandidates> candidates_;
  CellLists cell_head_, resting_head_, shaded_head_;  ///< candidates outside the mask, resting there, and inside
  std::array<std::uint16_t, kMaxCells> cell_order_;
  std::array<Vec3, kMaxKeyframes> keyframe_position_;
  std::array<SE3, kMaxKeyframes> T_cur_kf_;
  PatchStore patches_;
};

}  // namespace godwit::vo
