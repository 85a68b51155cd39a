// A visual map that may become metric, whoever knows the metres: what vision says of a frame, what is told of it, how
// fast vision strays in the map, where the map became metric, and why it is not.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>

#include "hal/rt/time.h"
#include "vo_core/inertial/map_anchor.h"
#include "vo_core/inertial/map_correction.h"

namespace godwit::vo {

/// What the tracker said of one frame, as much of it as counts here.
struct VisualPose : MapPose {
  rt::TimeNs t_ns = 0;
  bool tracked = false;
  /// There is no map yet, and the pictures since the first view have moved by this at most; 0: they move, or nobody
  /// knows.
  double still_rad = 0;
  std::uint32_t map_id = 0;
  Mat6 relative_covariance = Mat6::Zero();  ///< as covariance, of the pose relative to a keyframe of the map
  rt::TimeNs relative_age_ns = 0;           ///< that is so much older; 0: there is none
  double median_depth = 1;                  ///< [map units]
  std::span<const Eigen::Vector3f> points;  ///< of the map, some that the picture shows [map units]
  bool map_moved = false;                   ///< the map was corrected before this frame; by it the last frame's camera
  Vec3 moved_by = Vec3::Zero();             ///< moved [map units]
  Vec3 turned_by = Vec3::Zero();            ///< and turned, rotation vector along the map's axes
};

/// Position and attitude of the camera in the navigation frame: metres, z up; origin and heading where it began.
struct MetricPose {
  bool valid = false;  ///< the rest means something
  SE3 T_nav_cam;
  Vec3 velocity_m_s = Vec3::Zero();  ///< of the camera, along the navigation frame's axes
  Mat6 covariance = Mat6::Zero();    ///< of (position [m], rotation vector [rad]), along the navigation frame's axes
  Mat3 velocity_covariance = Mat3::Zero();
  double log_scale_sigma = 0;
  /// By how much better knowledge of scale, vertical and map moved the last frame's pose [m], and turned it.
  Vec3 moved_by_m = Vec3::Zero(), turned_by_rad = Vec3::Zero();
  /// What a correction of the map has of that, levelled: vision had strayed by it, which poses of longer ago than
  /// kStrayedNs are not concerned by. The rest moves all that was ever told alike.
  Vec3 map_moved_by_m = Vec3::Zero(), map_turned_by_rad = Vec3::Zero();
};

struct VisionStrayOptions {
  /// Vision's error relative to a keyframe is taken for a walk since then; one that is older counts as so old, since
  /// the tracker's keyframes are about this far apart and it does not stray while it sees nothing new.
  rt::TimeNs age_ns = 500 * rt::kNsPerMs;
  /// What is hung on a wrong part of a map inherits its error and does not know it. Measured on a take-off over flat
  /// ground (scenario gnss-loss): 20 mrad in the half second in which the map began, 10 mrad 2 s later, 2 mrad 6 s
  /// later, told from the second second on: 0.5 mrad.
  rt::TimeNs memory_ns = 5 * rt::kNsPerSecond;
  rt::TimeNs strayed_ns = kStrayedNs;  ///< before a correction of the map
  /// What shakes a rolling shutter is another thing in each picture: the frame's own noise, and the keyframe's, which
  /// is as large, are then in what is told of the pose relative to the keyframe, and are no walk.
  bool pictures_err_alone = false;
};

/// How fast vision strays, by what the tracker says itself. Plain value; no allocation.
class VisionStray {
 public:
  explicit VisionStray(const VisionStrayOptions& options = {}) : options_(options) {}

  void judge(const VisualPose& pose);
  double rotation_rate() const { return std::max(told_.rotation, taken_back_.rotation); }  ///< of an axis [rad^2/s]
  double position_rate() const { return std::max(told_.position, taken_back_.position); }  ///< the same [depths^2/s]
  rt::TimeNs strayed_ns() const { return options_.strayed_ns; }

 private:
  struct Rates {
    double rotation = 0, position = 0;
    void forget(double since_s, double memory_s) {
      const double kept = std::exp(-2 * since_s / memory_s);
      rotation *= kept;
      position *= kept;
    }
    void hear(double rotation_rate, double position_rate) {
      rotation = std::max(rotation, rotation_rate);
      position = std::max(position, position_rate);
    }
  };

  VisionStrayOptions options_;
  Rates told_;        ///< by the tracker's covariance
  Rates taken_back_;  ///< by corrections of the map, for as long as they reach back
  std::uint32_t map_id_ = 0;
  rt::TimeNs t_judged_ns_ = 0;
};

/// What they have in common who make a map metric. No allocation.
///
/// What is told stands in one frame as long as the map is metric; what ends that ends the frame, and the next one
/// begins where and as it headed then.
class MetricMap {
 public:
  bool metric() const { return metric_; }
  /// How often it became metric: poses of one number stand in one frame.
  std::uint32_t begun() const { return begun_; }
  /// Why the last frame is not metric. What is told of it are whole numbers: value and limit count in the unit that the
  /// text names in brackets, one that is fine enough for that.
  struct Refusal {
    const char* text = "";
    double value = 0, limit = 0;
  };
  const Refusal& refusal() const { return refusal_; }

 protected:
  explicit MetricMap(const VisionStrayOptions& stray) : stray_(stray) {}
  ~MetricMap() = default;

  /// Static text. False, always.
  bool refuse(const char* text, double value, double limit) {
    refusal_ = {text, value, limit};
    return false;
  }
  /// From this frame on the map is metric. up: along its axes, unit length.
  void begin(const VisualPose& pose, const Vec3& up);
  void end() { metric_ = told_ = false; }
  /// The map was corrected. The frame's own view of it stays but for the vertical: what was corrected, jumps. up: along
  /// the corrected map's axes, unit length: what it was seen by turned with the map, so that no pose may lean until
  /// the vertical is asked for again.
  void correct(const VisualPose& pose, const Vec3& up);
  /// The same for moments before it. The last picture's time and camera, before the correction.
  MapCorrection correction_of(const VisualPose& pose, rt::TimeNs t_last_ns, const Vec3& last_camera) const {
    return {t_last_ns - stray_.strayed_ns(), t_last_ns, last_camera, pose.turned_by, pose.moved_by};
  }
  /// The pose in the frame, with what moved the last one; no velocity. shared: covariance of the scale's logarithm and
  /// of the vertical about the frame's x and y; to it comes vision's own (MapAnchor::grown).
  MetricPose pose_in_frame(const VisualPose& pose, double scale, const Mat3& shared, double strayed2 = 0);
  /// A pose was told in the present frame.
  bool told() const { return told_; }

  VisionStray stray_;
  MapAnchor anchor_;

 private:
  bool metric_ = false;
  bool told_ = false;      ///< last_map_ was told in the present frame
  bool have_nav_ = false;  ///< last_nav_ means something
  std::uint32_t begun_ = 0;
  Refusal refusal_;
  SE3 last_map_;  ///< the last pose told as vision has it, corrections of the map taken in
  SE3 last_nav_;
  // What corrections of the map did to it since: moved [map units, along the map's axes], and turned along the frame's.
  Vec3 corrected_by_ = Vec3::Zero(), corrected_turn_ = Vec3::Zero();
};

}  // namespace godwit::vo
