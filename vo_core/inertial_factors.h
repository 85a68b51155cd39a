// What ties two moments of a flight together: the inertial sensor between them, how slowly biases and scale may change,
// and where vision saw the camera. Residuals and their Jacobians; no memory of their own.
#pragma once

#include "vo_core/geometry.h"
#include "vo_core/imu_preintegration.h"

namespace godwit::vo {

/// Strength of gravity where nothing else is known [m/s^2]. It differs by 0.05 over the earth: a thousandth of scale.
constexpr double kStandardGravity = 9.80665;

/// State of a moment, in the frame of vision's map: its axes, its origin, its unit of length. Only velocities and
/// biases are metric. The map's own scale and vertical are part of the state and may change slowly from moment to
/// moment: so far as vision's map drifts in them, they follow.
struct InertialState {
  static constexpr int kSize = 25;
  /// Where each part lies in a vector of errors.
  enum Index {
    kRotation = 0,
    kCamera = 3,
    kVelocity = 6,
    kGyroBias = 9,
    kAccelBias = 12,
    kScale = 15,
    kUp = 16,
    kMounting = 18,
    kTime = 21,
    kPlace = 22
  };
  using Error = Eigen::Matrix<double, kSize, 1>;

  Mat3 R_map_body = Mat3::Identity();
  Vec3 camera = Vec3::Zero();    ///< the camera's place [map units]
  Vec3 velocity = Vec3::Zero();  ///< of the body along the map's axes [m/s]
  ImuBias bias;
  double log_scale = 0;          ///< log of the metres in a map unit
  Vec3 up = Vec3(0, -1, 0);      ///< unit vector against gravity, along the map's axes
  Vec3 mounting = Vec3::Zero();  ///< rotation vector right of R_body_cam: what the calibration has wrong
  double time_offset_s = 0;      ///< a picture stamped t was taken at t + this on the inertial sensor's clock
  /// The camera's way from the anchor, along the map's axes, each step with the scale that the map had there [m].
  /// What is learned of the scale later moves it as far as the scale was the same then.
  Vec3 place = Vec3::Zero();

  double scale() const { return std::exp(log_scale); }
  /// Two directions at right angles to up, as columns: how up moves by its two errors.
  Eigen::Matrix<double, 3, 2> up_basis() const;
  /// Rotations on the right, up along its basis, all else added.
  InertialState plus(const Error& e) const;
  /// The error that leads from `from` to this one.
  Error minus(const InertialState& from) const;
};

/// Where the camera sits on the body.
struct CameraMounting {
  Mat3 R_body_cam = Mat3::Identity();
  Vec3 t_body_cam_m = Vec3::Zero();
};

/// What vision saw at a moment, and what the gyroscope read then.
struct VisionSight {
  Mat3 R_map_cam = Mat3::Identity();
  Vec3 camera = Vec3::Zero();  ///< [map units]
  Vec3 gyro_rad_s = Vec3::Zero();
  double depth = 1;  ///< of the scene [map units]: lengths are seen with an error in proportion
  /// How far the scene was replaced by another since the moment before [depths]: there the map's scale was handed on.
  double new_scene = 0;
  /// The picture's own noise, the map taken for true: covariance of (rotation vector, place), along the map's axes
  /// [rad, map units].
  Mat6 own = Mat6::Zero();
};

/// How vision and the slow parts err. Vision's error is a walk that is drawn back to zero (Ornstein and Uhlenbeck's),
/// so that neighbours share most of it: over a time t it changes by sigma sqrt(2 - 2 exp(-t / time)). Measured on
/// euroc_mh01 against its truth, an axis, the scene 0.65 m away: 0.6, 1.4, 2.4, 3.0 and 3.1 mm over 0.05, 0.2, 0.5, 1
/// and 4 s, and 0.3, 0.5, 0.8, 1.1, 1.4 and 1.8 mrad over 0.05, 0.2, 0.5, 1, 2 and 4 s (calibration and truth are in
/// there, too).
struct InertialModel {
  ImuNoise imu{3e-4, 8e-3, 5e-5, 5e-4};
  double gravity_m_s2 = kStandardGravity;
  double rotation_sigma = 2e-3;  ///< [rad]
  double rotation_time_s = 2;
  double position_sigma = 3.3e-3;  ///< [depths]
  double position_time_s = 0.8;
  double scale_walk = 3e-4;      ///< of the map's scale [1/sqrt(s)]
  double scale_handed = 5e-3;    ///< and where the scene is replaced by another [1/sqrt(depths)]
  double up_walk = 1e-4;         ///< of the map's vertical [rad/sqrt(s)]
  double mounting_walk = 1e-6;   ///< [rad/sqrt(s)]
  double time_walk = 1e-7;       ///< [s/sqrt(s)]
  double place_walk = 1e-3;      ///< drift of what vision adds up, in depths, over the root of the depths flown
  double anchor_sigma_m = 1e-4;  ///< where the anchor is
};

/// Rows of the residual between two moments: inertial (turn, speed, way), slow parts, change of vision's error, way
/// added up.
constexpr int kPairRows = 9 + 13 + 6 + 3;
using PairResidual = Eigen::Matrix<double, kPairRows, 1>;
using PairJacobian = Eigen::Matrix<double, kPairRows, InertialState::kSize>;

/// The residual between i and the later j (Forster, 45, with the lever of the camera and vision's scale), and its
/// Jacobians by the errors of both; unweighted. No allocation.
PairResidual pair_residual(const InertialState& i, const InertialState& j, const Preintegration& between,
                           const VisionSight& at_i, const VisionSight& at_j, const CameraMounting& mounting,
                           const InertialModel& model, PairJacobian* J_i, PairJacobian* J_j);

/// Weighs the rows: each becomes of unit variance, uncorrelated.
void whiten_pair(const Preintegration& between, const VisionSight& at_i, const VisionSight& at_j, double scale,
                 const InertialModel& model, PairResidual* r, PairJacobian* J_i, PairJacobian* J_j);

using SightJacobian = Eigen::Matrix<double, 6, InertialState::kSize>;
/// Vision's error at a moment: rotation vector along the map's axes [rad], place [map units].
Vec6 sight_residual(const InertialState& x, const VisionSight& sight, const CameraMounting& mounting, SightJacobian* J);
/// Weighs it by how far vision may stray in all: once for a chain of moments, the pairs tell how it goes on.
void whiten_sight(const VisionSight& sight, const InertialModel& model, Vec6* r, SightJacobian* J);

}  // namespace godwit::vo
