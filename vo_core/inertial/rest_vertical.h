// The vertical that an accelerometer shows while nothing moves it, carried on by the gyroscope once something does, and
// how fast one has become since. A vehicle stands before it takes off, and its map begins on the climb, when vision's
// own accelerations are those of a map a second old and it may climb evenly already.
#pragma once

#include <array>
#include <cmath>
#include <limits>

#include "vo_core/inertial/imu_preintegration.h"

namespace godwit::vo {

/// A vertical along the body's axes at one time: its direction is up + by_bias * b for an accelerometer's bias b. And
/// the velocity there, which is velocity + velocity_by_bias * b.
struct KnownVertical {
  bool known = false;
  Vec3 up = Vec3::Zero();         ///< unit vector against gravity, the bias taken for none
  Mat3 by_bias = Mat3::Zero();    ///< [s^2/m]
  double sigma = 0;               ///< of all but the bias [rad, an axis]
  Vec3 gyro_bias = Vec3::Zero();  ///< what the gyroscope read at rest [rad/s]
  double gyro_bias_sigma = 0;     ///< [rad/s, an axis]
  /// Since the rest, as far as the body has not turned without what gravity is and whatever the bias is: forces beside
  /// those that were read at rest.
  Vec3 velocity = Vec3::Zero();          ///< [m/s]
  Mat3 velocity_by_bias = Mat3::Zero();  ///< [s]
  double velocity_sigma = 0;  ///< of all but the bias and the drift [m/s, an axis]; 0: the velocity is not known
  /// How slowly it may have gone while pictures showed no motion, of what was depth_m away [1/s]. Whoever knows lengths
  /// says how far that was.
  double drift_rad_s = 0;
  double depth_m = 0;
  Vec3 force = Vec3::Zero();  ///< what was read at rest, turned along [m/s^2]
  /// Of that what is beyond gravity is the bias along it: up_at_rest * b, which leaves how fast one climbs known.
  Vec3 up_at_rest = Vec3::Zero();                       ///< unit vector, along the sensor's axes
  double beyond_gravity = 0, beyond_gravity_sigma = 0;  ///< [m/s^2]; sigma 0: not known
  Mat3 R_body_rest = Mat3::Identity();                  ///< from the body's axes at rest

  /// Along the axes of a map in which the body is turned like this [m/s^2].
  Vec3 in_map(const Mat3& R_map_body, const Vec3& accel_bias) const {
    return (R_map_body * (up + by_bias * accel_bias)).normalized();
  }
  double whole_velocity_sigma() const {
    return velocity_sigma > 0 ? std::hypot(velocity_sigma, drift_rad_s * depth_m) : 0;
  }
  /// The same some time later, as far as turn and force are what `d` measured.
  void go_on(const Preintegration& d);
};

/// At rest is who measures for a second no more than the sensor's own noise, twice over, while pictures show no motion:
/// means over a tenth of it scatter as its densities say, of forces and of turns. A vehicle that shakes on the ground
/// is not taken for one at rest, and its vertical is then that of the last rest or found as in flight. One thread; no
/// allocation.
class RestVertical {
 public:
  /// Of what was turned: how crooked and how wrongly scaled a gyroscope of this kind is (MPU-6000: 2 % and 3 %).
  static constexpr double kTurnShare = 0.02;

  /// gyro_sigma_rad_s: of the gyroscope's bias. Who turns by more than three of it is not at rest.
  RestVertical(const ImuNoise& noise, double gravity_m_s2, double gyro_sigma_rad_s)
      : noise_(noise), gravity_m_s2_(gravity_m_s2), gyro_sigma_rad_s_(gyro_sigma_rad_s) {}

  /// Readings in the order of their times; a gap ends what is known, and so does a turn at the end of the gyroscope's
  /// range. Who is at the end of a range is not at rest.
  void add(const ImuReading& reading);
  /// A picture's moment, and by how much at most it moved since the first view of a map to be [rad]; 0: it moves, or
  /// nobody knows. Only what pictures show as well is a rest: who is pushed evenly or flies evenly and is not shaken
  /// reads the same.
  void picture(rt::TimeNs t_ns, double still_rad);
  /// At a time within the buffer, which holds the same readings.
  KnownVertical at(rt::TimeNs t_ns, const ImuBuffer& buffer) const;

 private:
  static constexpr rt::TimeNs kBlockNs = 100 * rt::kNsPerMs;
  static constexpr int kBlocks = 10;
  /// Of a scatter of 27 degrees of freedom, as often exceeded by chance as in one of a million blocks; and the noise
  /// may be twice what its file says, as it is here and there (docs/inertial.md).
  static constexpr double kScatter = 3.0 * 4.0;
  struct Block {
    Vec3 gyro = Vec3::Zero(), accel = Vec3::Zero();  ///< means
  };
  void close_block();
  bool at_rest(Block* mean) const;
  /// Pictures showed no motion for the length of a rest that ended then.
  bool shown_as_still(rt::TimeNs end_ns) const;

  const ImuNoise noise_;
  const double gravity_m_s2_, gyro_sigma_rad_s_;
  std::array<Block, kBlocks> blocks_;
  int blocks_full_ = 0, block_next_ = 0;
  Block sum_;
  int readings_ = 0;  ///< in sum_
  rt::TimeNs t_block_ns_ = 0;
  ImuReading last_;
  bool heard_ = false;
  // Since the last rest, up to the newest reading.
  bool known_ = false;
  Vec3 force_ = Vec3::Zero(), gyro_bias_ = Vec3::Zero();  ///< what was read at rest
  Mat3 R_rest_body_ = Mat3::Identity();
  rt::TimeNs t_rest_ns_ = 0;
  // And of the velocity. The last blocks of a rest may be the first of a push that is too small yet to be seen: it
  // ended before them.
  static constexpr int kDoubtful = 3;
  bool velocity_known_ = false;
  Vec3 stood_force_ = Vec3::Zero();
  Vec3 velocity_ = Vec3::Zero();  ///< along the body's axes at rest [m/s]
  Mat3 turns_ = Mat3::Zero();     ///< integral of R_rest_body_ [s]
  double drift_rad_s_ = 0;
  double turned_rad_ = 0;  ///< there and back, since the rest
  static constexpr rt::TimeNs kNever = std::numeric_limits<rt::TimeNs>::min();
  rt::TimeNs still_since_ns_ = kNever, still_until_ns_ = kNever;
  double still_rad_ = 0;
};

}  // namespace godwit::vo
