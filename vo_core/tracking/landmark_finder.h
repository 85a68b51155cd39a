// The pose of a frame from the map alone: corners are matched with map points by what they look like, and a pose is
// sought on which most of the matches agree. Does not mind what hides half of the picture, which spoils the thumbnails
// (relocaliser.h); costs more, and is surer of a pose than it should be where the map is small. So it is asked between
// movers only, in turns with the thumbnails.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>

#include "vo_core/features/brief.h"
#include "vo_core/features/feature_detector.h"
#include "vo_core/geometry/camera_model.h"
#include "vo_core/map/map.h"
#include "vo_core/tracking/pose_optimizer.h"

namespace godwit::vo {

struct LandmarkFinderOptions {
  int corners = 240;                   ///< of the frame; at most kMaxFrameFeatures
  int described_a_tracked_frame = 60;  ///< of the points that learn() is given while all is well
  int described_a_frame = 700;         ///< points whose look is not known yet, taken up in one call
  int max_points = 2500;               ///< compared with in one call; of a larger map parts in turns
  int max_distance = 64;               ///< of descriptors that may match
  double max_ratio = 0.85;             ///< best distance over that of the best point elsewhere
  double elsewhere = 0.03;             ///< points nearer together than this, over depth, are one place
  int rounds = 200;                    ///< hypotheses of three matches each (Fischler and Bolles 1981)
  double agreement_px = 8.0;  ///< a match agrees with a pose to so much; the shutter's part in it is not known yet
  int min_agreeing = 12;
  int min_agreeing_near = 8;   ///< where only points near their expected places were compared
  double near_px = 40.0;       ///< so near, when no time has passed,
  double turn_rad_s = 0.6;     ///< and further by what so fast a turn moves the picture
  double roll_step_rad = 0.5;  ///< every third attempt is turned about the optical axis by so much more
};

/// Where the camera was not long ago.
struct LastSeen {
  SE3 T_cam_world;
  double ago_s = 0.0;
};

struct LandmarkReport {
  int corners = 0;
  int matches = 0;
  int agreeing = 0;
  bool found = false;
  SE3 T_cam_world;  ///< when found
};

/// Fixed storage, the tracker's thread. find() is bounded and does not allocate.
class LandmarkFinder {
 public:
  LandmarkFinder(const CameraModel& camera, const LandmarkFinderOptions& options);
  ~LandmarkFinder();

  /// Attempt number `attempt` of one search, counted over its frames. `last`: may be null; while the camera can hardly
  /// have turned by the picture's width since then, a corner is compared only with points that may be there: fewer that
  /// resemble it by chance, so fewer that must agree.
  LandmarkReport find(const Map& map, const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask, int attempt,
                      const LastSeen* last = nullptr);

  /// Takes up what at most `points` of the map look like that are not known yet; find() does it too, for more of them.
  void learn(const Map& map, int points);

  /// Another map begins: nothing that is known of points holds any more.
  void forget();

 private:
  struct Look {
    std::uint16_t generation = 0;
    bool known = false;
    std::uint8_t observations = 0;  ///< of the point when it was tried last; another try only when they have changed
    BriefDescriptor descriptor;
  };
  struct Match {
    std::uint16_t point;
    std::uint16_t corner;
    int distance;
  };
  static constexpr int kMaxCorners = 240;

  static double median_depth(const Map& map);
  int match(const Map& map, const rt::PyramidView& pyramid, double roll, int attempt, const LastSeen* last);
  double reach_px(const LastSeen& last) const;
  int start_keyframe(const Map& map, int matches) const;
  bool pose_of_three(int a, int b, int c, SE3* T_cam_world) const;
  int agreeing(int matches, const SE3& T_cam_world) const;

  const CameraModel& camera_;
  LandmarkFinderOptions options_;
  BriefPattern upright_{0.0};
  FeatureDetector detector_;
  std::unique_ptr<std::array<Look, kMaxPoints>> looks_;
  int next_to_learn_ = 0;
  std::array<Feature, kMaxCorners> corners_;
  int corner_count_ = 0;
  std::array<Match, kMaxCorners> matches_;
  std::array<PoseMeasurement, kMaxCorners> measurements_;
};

}  // namespace godwit::vo
