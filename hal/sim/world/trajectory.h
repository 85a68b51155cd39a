// Where the aircraft is: legs (take-off, hover, path, survey, dash, spin, climb, land, tilt) made into one smooth
// motion.
//
// World frame: x, y on the ground, z up; heading counts from x towards y. Body frame: x forward, y right, z down (FRD).
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "hal/sim/world/spline.h"

namespace godwit::sim {

using Vec2 = Eigen::Vector2d;
using Vec3 = Eigen::Vector3d;
using Mat3 = Eigen::Matrix3d;

constexpr double kGravity = 9.80665;

enum class LegKind : std::uint8_t { kTakeOff, kHover, kPath, kSurvey, kDash, kSpin, kClimb, kLand, kTilt };

/// One leg of a flight. Which fields count depends on kind.
struct Leg {
  LegKind kind = LegKind::kHover;
  double duration_s = 0;       ///< hover
  double height_m = 0;         ///< take-off, climb: above the start's ground
  double speed_m_s = 1;        ///< all that move
  double distance_m = 0;       ///< dash: along the present heading
  double angle_deg = 0;        ///< spin: positive turns from x towards y
  double rate_deg_s = 0;       ///< spin, tilt
  double pitch_deg = 0;        ///< tilt: nose up; as a hand tilts it, in place, and kept until the next tilt
  double roll_deg = 0;         ///< tilt: right side down
  double length_m = 0;         ///< survey: along the present heading
  double width_m = 0;          ///< survey: to the left of it
  double spacing_m = 0;        ///< survey: between lanes
  bool face_path = true;       ///< path, survey: the nose follows the motion
  std::vector<Vec2> points_m;  ///< path: world positions
};

/// Shaking by motors and propellers: the sum of three sinusoids an axis around the frequency.
struct Vibration {
  double frequency_hz = 0;  ///< 0: none
  double angle_deg = 0;     ///< amplitude of roll, pitch and yaw
  double position_mm = 0;   ///< amplitude of x, y and z
};

struct TrajectoryPlan {
  Vec2 start_m = Vec2::Zero();
  double start_height_m = 0.3;  ///< above the start's ground: skids, or in the air
  double heading_deg = 0;
  double sway = 1.0;  ///< wind and control: 1 is about 0.1 m and 0.6 degrees
  double acceleration_m_s2 = 1.5;
  Vibration vibration;
  std::vector<Leg> legs;
};

/// State of the body at one instant; all exact derivatives of one curve.
struct BodyState {
  Vec3 position_m, velocity_m_s, acceleration_m_s2;  ///< world
  Mat3 R_world_body;
  Vec3 omega_rad_s;          ///< body rates in the body frame
  Vec3 specific_force_m_s2;  ///< what an ideal accelerometer in the body's origin reads, body frame
};

class Trajectory {
 public:
  /// ground_m: height of the ground below the start, added to all heights. seed chooses sway and vibration phases.
  Trajectory(const TrajectoryPlan& plan, double ground_m, std::uint64_t seed);
  double duration_s() const { return spline_.duration_s(); }
  /// t_s in [0, duration_s()]; clamped outside. No allocation, any thread.
  BodyState at(double t_s) const;

 private:
  QuinticSpline spline_;
  Vibration vibration_;
  std::uint64_t seed_;
};

}  // namespace godwit::sim
