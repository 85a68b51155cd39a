// How certain a pose is: relative to a keyframe of the map, and in the map as a whole, with the share of the map's own
// errors in it. What the pose optimiser says (own noise of one frame, the map taken for true) is only the smaller part.
//
// The model. Let N be the keyframe that the mapper adjusted last, K an older one, C the frame at hand. M(N,K) is what
// the errors of the points relative to K make of N's pose (bundle_shares.cpp). The frame C looks at the same points: it
// shares M, carried to its own axes by the adjoint, and has its own noise, H_C^-1:
//   C(C,K) = H_C^-1 + Ad(T_CN) M(N,K) Ad(T_CN)^T.
// Where K is N itself, N hangs on the points just as C does: M(N,N) = H_N^-1, as N's own residuals have it.
//
// That holds while C looks from where N did. What the points are off by together - the shape that a wrong motion
// between two views gives them - looks otherwise from elsewhere: N agrees with it, a frame beyond N is pulled. So it is
// also told how M changes with the place that a frame looks from.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "hal/rt/time.h"
#include "vo_core/geometry/geometry.h"
#include "vo_core/map/map.h"

namespace godwit::vo {

/// Adjoint of T for twists (v, w): T exp(x) T^-1 = exp(Ad x).
inline Mat6 adjoint(const SE3& T) {
  Mat6 ad;
  ad << T.R, skew(T.t) * T.R, Mat3::Zero(), T.R;
  return ad;
}

using Vec18 = Eigen::Matrix<double, 18, 1>;
using Mat18 = Eigen::Matrix<double, 18, 18>;
using Mat6_18 = Eigen::Matrix<double, 6, 18>;

/// Share of the map's errors in the pose of keyframe `centre` relative to keyframe `keyframe_id`: covariance of the
/// left twist of T_centre_keyframe [map units, rad], and of that with its change (MapShares).
struct MapShare {
  std::uint32_t keyframe_id = 0;
  Mat6 covariance = Mat6::Zero();
  Mat6_18 with_change = Mat6_18::Zero();
};
/// The same for all keyframes that were adjusted together. Travels from mapper to tracker.
struct MapShares {
  static constexpr int kMax = 24;
  std::uint32_t centre = 0;  ///< id of the keyframe; 0: none
  int count = 0;
  double median_depth = 1.0;  ///< of the centre
  /// Covariance of what a frame's twist, along the centre's axes, changes by for each unit of length that it lies along
  /// the centre's x, y and z (6 each): the same relative to all keyframes.
  Mat18 change = Mat18::Zero();
  std::array<MapShare, kMax> share;
};

/// A pose relative to a keyframe.
struct RelativePose {
  std::uint32_t keyframe_id = 0;   ///< 0: there is none
  rt::TimeNs t_keyframe_ns = 0;    ///< its capture time
  SE3 T_ref_cam;                   ///< camera to keyframe [map units]
  Mat6 covariance = Mat6::Zero();  ///< of the left twist (v, w) of T_cam_ref, along the camera's axes [map units, rad]
};

struct PoseCertaintyOptions {
  /// The reference is the newest keyframe at least so old, if there is one: what a filter wants to know is how the
  /// camera moved over a while.
  rt::TimeNs reference_age_ns = 500 * rt::kNsPerMs;
};

/// Tracker thread. Fixed storage; no allocation, bounded by the number of keyframes.
class PoseCertainty {
 public:
  explicit PoseCertainty(const PoseCertaintyOptions& options = {}) : options_(options) { clear(); }

  /// A new map begins.
  void clear();
  /// What the mapper found out with its last adjustment.
  void take(const MapShares& shares) { shares_ = shares; }
  /// The frame just judged becomes a keyframe at this place.
  void keyframe(int place, const Mat6& covariance) { in_map_[place] = covariance; }

  /// Pose and covariance relative to the reference keyframe, of a frame at T_cam_world whose own noise is `own` (left
  /// twist of T_cam_world, the map taken for true).
  /// `strayed` (frame_noise.h) comes on top, of the frame and of the keyframe, which strayed as much.
  RelativePose relative(const Map& map, const SE3& T_cam_world, rt::TimeNs t_capture_ns, const Mat6& own,
                        const Mat6& strayed) const;
  /// Covariance of the same twist in the map's world: the reference's own and the relative one, along the chain of
  /// references back to the map's first keyframe.
  Mat6 in_map(const Map& map, const RelativePose& relative) const;

 private:
  const MapShare* find_share(std::uint32_t keyframe_id) const;
  Mat6 carried(const MapShare& share, const SE3& T_cam_centre) const;

  PoseCertaintyOptions options_;
  MapShares shares_;
  std::array<Mat6, kMaxKeyframes> in_map_;  ///< by place: covariance of the left twist of T_kf_world
};

}  // namespace godwit::vo
