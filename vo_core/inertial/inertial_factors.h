// What ties two moments of a flight together: the inertial sensor between them, how slowly biases and scale may change,
// and where vision saw the camera. Residuals and their Jacobians; no memory of their own.
#pragma once

#include "vo_core/geometry/geometry.h"
#include "vo_core/inertial/imu_preintegration.h"

namespace godwit::vo {

/// Strength of gravity where nothing else is known [m/s^2]. It differs by 0.05 over the earth: a thousandth of scale.
constexpr double kStandardGravity = 9.80665;

/// State of a moment, in the frame of vision's map: its axes, its origin, its unit of length. Only velocities and
/// biases are metric. The map's own scale and vertical are part of the state and may change slowly from moment to
/// moment: so far as vision's map drifts in them, they follow.
struct InertialState {
  static constexpr int kSize = 31;
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
    kCourse = 22,
    kPicture = 25
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
  /// Vision's motion is turned by this against its own attitudes, rotation vector along the map's axes: a way in the
  /// map is one of exp(course) times it. A map whose depths lean shows every way askew by the same share, for as long
  /// as it lasts: as noise of single moments that would be taken for a bias and a lean of the vertical, surer and
  /// surer.
  Vec3 course = Vec3::Zero();
  /// What vision is off by in this picture alone, beyond what it shares with its neighbours: rotation vector and place
  /// along the map's axes [rad, map units]. Zero where the sight says that there is no such thing.
  Vec6 picture = Vec6::Zero();

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
  /// The moment is so much later than the picture's stamp: the time offset as it was known then. A turn over what is
  /// left of it is a straight line; over 20 ms of a hand's motion that would be wrong by 2 mrad.
  double shift_s = 0;
  double depth = 1;         ///< of the scene [map units]: lengths are seen with an error in proportion
  double own_position = 0;  ///< what this picture's own matches leave open, one sigma an axis [map units]
  /// How fast vision strays, as the tracker tells it of the pose relative to its reference keyframe: variance an axis
  /// and second [rad^2/s, map units^2/s]. A young map strays ten times as fast as a grown one.
  double rotation_rate = 0, position_rate = 0;
  /// What it strayed in all since the map began, one sigma an axis [rad, map units].
  double rotation_in_map = 0, position_in_map = 0;
  /// A camera that shakes within the readout of a rolling shutter: what one picture is off by, its neighbours are not.
  /// Inverse covariance of InertialState::picture; zero: there is no such thing, and own_position is part of the walk.
  Mat6 own_information = Mat6::Zero();
  /// How the walk's six errors, rotation and place along the map's axes, hang together: correlations. A turn and a way
  /// that look alike are mistaken for each other, and as the gyroscope knows the one, the other is known.
  Mat6 walk_correlation = Mat6::Identity();

  bool shakes() const { return own_information(0, 0) > 0; }
};

/// How vision and the slow parts err. Vision's error is a walk that is held near zero, neighbours share most of it, and
/// each picture's own noise on top. How large all that is, the tracker says of each picture: from worlds half a metre
/// to forty metres away, and from maps a second old, it differs by a factor of fifty. The factors below bring what it
/// says to what was measured on euroc_mh01 against its truth: 0.3 mm and 0.15 mrad from picture to picture at 20 Hz, 4
/// mm and 1.3 mrad over all, the scene 0.7 m away (its truth lags by 8 ms, which is in there, too).
struct InertialModel {
  /// Where nobody says what the sensor is like. The walk of the accelerometer's bias as EuRoC's calibration has it:
  /// with a sixth of it the bias was told five times too certain where the sensor rests, whose scale is 0.2 % off. With
  /// ten times it, which is what a file's own word would come to (firmware_app/pipeline/inertial_options.cpp), a
  /// rangefinder that lies is believed too far.
  ImuNoise imu{3e-4, 8e-3, 5e-5, 3e-3};
  /// Times what the tracker tells of a place: neighbouring pictures look at the same points, whose own errors are most
  /// of what it tells, so that they err alike. What a moment's place is off from where the sensor has it is 0.1 to 0.3
  /// of its variance with twice this, in flight on euroc_mh01 0.3 to 0.5; what lasts longer is the walk and the course.
  double own_position = 0.75;
  double gravity_m_s2 = kStandardGravity;
  double rotation_stray = 1.3;   ///< times VisionSight::rotation_rate's root
  double position_stray = 1.2;   ///< times position_rate's
  double in_map = 1.4;           ///< times rotation_in_map and position_in_map: how far the walk is held
  double rotation_walk = 2e-4;   ///< what is left where the tracker says zero [rad/sqrt(s)]
  double position_walk = 1e-4;   ///< [depths/sqrt(s)]
  double rotation_sigma = 1e-3;  ///< [rad]
  double position_sigma = 5e-4;  ///< [depths]
  /// Where vision strays, the map's vertical and scale do: by so much of its rotation [rad], and by so many parts for
  /// each depth it strays by. Chosen on take-offs (scenario gnss-loss): their NEES is
  /// 0.2 with them, and was 45 without before the window held a course; with twice these no NEES is nearer to 1.
  double up_stray = 0.5, scale_stray = 1, still = 0.01;
  double scale_walk = 3e-4;  ///< of the map's scale [1/sqrt(s)]
  double up_walk = 1e-4;     ///< of the map's vertical [rad/sqrt(s)]
  /// A map that grows strays, one that is looked at from the same place does not: by less than `still` depths or
  /// radians between two moments, all of the above is less in proportion, down to this share, since the mapper may
  /// still correct it. So scale and vertical are held at rest and in a hover, without anybody deciding that it is one.
  double at_rest = 0.05;
  double mounting_walk = 1e-6;  ///< [rad/sqrt(s)]
  double time_walk = 1e-7;      ///< [s/sqrt(s)]
  /// A way that is seen with an error of so many parts is seen askew by as many radians: what vision strays by in a
  /// second over the way of a second, times this, is one sigma of the course, a first-order Gauss-Markov process of the
  /// time below: what a map leans by ends as other parts of it come into view. A rough choice, by velocities of eight
  /// take-offs (gnss-loss): 2 s come out the same, twice the sigma 20 % worse; other flights do not feel either.
  double course = 1, course_s = 8;
  /// And times this where a map begins: one a second old shows ways askew by 0.3 rad on take-offs.
  double course_begin = 2;
};

/// How far vision strays in a root of a second, as it says itself at one moment [map units].
double position_stray(const VisionSight& sight, const InertialModel& model);

/// How much of a full share of its strays vision strays by between two moments: 1 where the camera moves,
/// InertialModel::at_rest at the least.
double moving_share(const VisionSight& at_i, const VisionSight& at_j, const InertialModel& model);

/// What is left of the course from one moment to another, so many seconds later: all of it where nothing moves.
double course_kept(const VisionSight& at_i, const VisionSight& at_j, double dt_s, const InertialModel& model);

/// Rows of the residual between two moments: inertial (turn, speed, way), slow parts, change of vision's error.
constexpr int kPairRows = 9 + 16 + 6;
using PairResidual = Eigen::Matrix<double, kPairRows, 1>;
using PairJacobian = Eigen::Matrix<double, kPairRows, InertialState::kSize, Eigen::RowMajor>;

/// The residual between i and the later j (Forster, 45, with the lever of the camera and vision's scale), and its
/// Jacobians by the errors of both; unweighted. No allocation.
PairResidual pair_residual(const InertialState& i, const InertialState& j, const Preintegration& between,
                           const VisionSight& at_i, const VisionSight& at_j, const CameraMounting& mounting,
                           const InertialModel& model, PairJacobian* J_i, PairJacobian* J_j);

/// Weighs the rows: each becomes of unit variance, uncorrelated.
void whiten_pair(const Preintegration& between, const VisionSight& at_i, const VisionSight& at_j,
                 const InertialModel& model, PairResidual* r, PairJacobian* J_i, PairJacobian* J_j);

using SightJacobian = Eigen::Matrix<double, 6, InertialState::kSize>;
/// Vision's error at a moment: rotation vector along the map's axes [rad], place [map units].
Vec6 sight_residual(const InertialState& x, const VisionSight& sight, const CameraMounting& mounting, SightJacobian* J);

}  // namespace godwit::vo
