// How the camera moves, from its poses so far: where the next picture will find it, and how sure that is. A camera has
// mass. Where all that a picture shows lies in one corner of it, a step aside and a turn look alike; then this tells
// which of the two it was.
#pragma once

#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

struct MotionPriorOptions {
  /// How fast velocity and turn rate change by chance: roots of the spectral densities of their white accelerations
  /// [scene depths/s^1.5, rad/s^1.5]. The true motion of tum_fr1_xyz, a camera in a hand, has 0.10 and 0.76 (the depth
  /// is 1 m), that of euroc_mh01, swung by hand 3 m before a wall, 0.04 and 0.20. Among severe walkers (eight flights,
  /// masks 85 and 120 ms old) 0.25 and 0.7 leave 8 poses that are off by more than 5 cm; without a prior there are 232.
  double acceleration = 0.25, turn_acceleration = 0.7;
  /// How fast a camera may be of which nothing is known yet [scene depths/s, rad/s].
  double first_speed = 3.0, first_turn = 3.0;
};

/// What is known of a pose before its picture is looked at.
struct PosePrediction {
  bool known = false;
  SE3 T_cam_world;
  Mat6 information = Mat6::Zero();  ///< of the left twist (v, w) of T_cam_world [map units, rad]
  /// How much likelier than with a camera of which nothing is known the pose is this one [nats].
  double most_evidence = 0.0;
  /// By how much a picture's measurements together are less sure than one by one: ratio of variances (frame_noise.h).
  double correlated = 1.0;

  /// Nats for a pose: the likelihood of it by how the camera moved over that by nothing.
  double evidence(const SE3& T) const {
    const Vec6 off = (T * T_cam_world.inverse()).log();
    return known ? most_evidence - 0.5 * off.dot(information * off) : 0.0;
  }
};

/// Constant velocity and white acceleration: a Kalman filter of the pose's left twist and its rate (Bar-Shalom, Li and
/// Kirubarajan, Estimation with Applications to Tracking and Navigation, section 6.2.2). Tracker thread; no allocation.
class MotionPrior {
 public:
  explicit MotionPrior(const MotionPriorOptions& options = {}) : options_(options) {}

  /// The camera was lost, or looks at another map.
  void forget() { known_ = false; }

  /// Of the pose dt [s] after the last one, which is by now at T_last (the map may have moved it); depth: the scene's
  /// [map units]. Not known without a last pose. May be asked for again, later, where nothing was found.
  PosePrediction predict(const SE3& T_last, double dt, double depth);

  /// The first pose. Its rate is where to look next, and may be anything.
  void begin(const Vec6& rate, const Mat6& covariance, double depth);
  /// The pose that came of the last prediction and its picture, with the covariance of both together.
  void measured(const PosePrediction& predicted, const SE3& T_cam_world, const Mat6& covariance);

 private:
  struct Moments {
    Mat6 pose = Mat6::Zero(), rate = Mat6::Zero();
    Mat6 rate_pose = Mat6::Zero();  ///< covariance of the rate (rows) with the pose
  };

  MotionPriorOptions options_;
  bool known_ = false;
  Vec6 rate_ = Vec6::Zero();  ///< of the left twist [1/s]
  Moments last_, ahead_;      ///< at the last pose, and at the one predicted
};

}  // namespace godwit::vo
