// What an inertial sensor measured between two times, integrated once and for all: Forster, Carlone, Dellaert,
// Scaramuzza, "On-Manifold Preintegration for Real-Time Visual-Inertial Odometry", TRO 2017.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "hal/rt/time.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

using Mat9 = Eigen::Matrix<double, 9, 9>;
using Vec9 = Eigen::Matrix<double, 9, 1>;

/// One reading, in the axes of the body.
struct ImuReading {
  rt::TimeNs t_ns = 0;
  Vec3 gyro_rad_s = Vec3::Zero();
  Vec3 accel_m_s2 = Vec3::Zero();  ///< specific force
  /// An axis stood at the end of its range: what it reads is the least that it may have been.
  bool gyro_saturated = false, accel_saturated = false;
};

/// Densities of white noise and of the biases' walks. Defaults: MPU-6000 and sensors like it
/// (hal/sim/sensors/sim_imu.h), the white ones three times the data sheet's: what shakes, is late or crooked is in
/// there, too.
struct ImuNoise {
  double gyro = 3e-4;        ///< [rad/s/sqrt(Hz)]
  double accel = 1.2e-2;     ///< [m/s^2/sqrt(Hz)]
  double gyro_walk = 5e-5;   ///< [rad/s^2/sqrt(Hz)]
  double accel_walk = 5e-4;  ///< [m/s^3/sqrt(Hz)]
};

struct ImuBias {
  Vec3 gyro = Vec3::Zero(), accel = Vec3::Zero();
};

/// Turn, speed and way between times i and j in the body's axes at i, without gravity and without the speed at i:
///   R_j = R_i dR,   v_j = v_i + g dt + R_i dv,   p_j = p_i + v_i dt + g dt^2 / 2 + R_i dp          (Forster, 33)
/// Plain value, no allocation.
class Preintegration {
 public:
  explicit Preintegration(const ImuBias& bias = {}) : bias_(bias) {}

  /// Both readings hold over dt_s > 0, as measured (the bias is taken off here). Second order: the force acts at the
  /// attitude in the middle of the step. more: variance that these readings have beside the noise, by axis, those of
  /// the gyroscope first [rad^2/s^2, m^2/s^4].
  void add(const Vec3& gyro, const Vec3& accel, double dt_s, const ImuNoise& noise, const Vec6& more = Vec6::Zero());

  double dt_s() const { return dt_s_; }
  const ImuBias& bias() const { return bias_; }  ///< that it was integrated with
  const Mat9& covariance() const { return covariance_; }

  /// With another bias, to first order (Forster, 44).
  Mat3 dR(const Vec3& gyro_bias) const { return dR_ * so3_exp(dR_dbg_ * (gyro_bias - bias_.gyro)); }
  Vec3 dv(const ImuBias& b) const { return dv_ + dv_dbg_ * (b.gyro - bias_.gyro) + dv_dba_ * (b.accel - bias_.accel); }
  Vec3 dp(const ImuBias& b) const { return dp_ + dp_dbg_ * (b.gyro - bias_.gyro) + dp_dba_ * (b.accel - bias_.accel); }
  const Mat3& dR_dbg() const { return dR_dbg_; }  ///< of the rotation vector right of dR
  const Mat3& dv_dbg() const { return dv_dbg_; }
  const Mat3& dv_dba() const { return dv_dba_; }
  const Mat3& dp_dbg() const { return dp_dbg_; }
  const Mat3& dp_dba() const { return dp_dba_; }

 private:
  ImuBias bias_;
  double dt_s_ = 0;
  Mat3 dR_ = Mat3::Identity();
  Vec3 dv_ = Vec3::Zero(), dp_ = Vec3::Zero();
  Mat3 dR_dbg_ = Mat3::Zero(), dv_dbg_ = Mat3::Zero(), dv_dba_ = Mat3::Zero(), dp_dbg_ = Mat3::Zero(),
       dp_dba_ = Mat3::Zero();
  Mat9 covariance_ = Mat9::Zero();  ///< of (rotation vector right of dR, dv, dp)
};

/// Right Jacobian of SO(3): exp(w + d) = exp(w) exp(Jr d), and its inverse.
Mat3 so3_right_jacobian(const Vec3& w);
Mat3 so3_right_jacobian_inverse(const Vec3& w);

/// The readings of the last two seconds, so that any two times within them can be integrated between. One thread; no
/// allocation after the constructor.
class ImuBuffer {
 public:
  /// Two seconds of the fastest sensor, 1 kHz.
  static constexpr std::size_t kReadings = 2048;
  static constexpr rt::TimeNs kSpanNs = 2 * rt::kNsPerSecond;
  /// Between readings further apart than this nobody knows what happened: counted as missing.
  static constexpr rt::TimeNs kGapNs = 30 * rt::kNsPerMs;

  /// False, and counted: a time that repeats or goes back, or a reading that is no number. After a jump back of more
  /// than the span the old readings are forgotten and the new time begins.
  bool add(const ImuReading& reading);

  /// How well a span was covered.
  struct Coverage {
    rt::TimeNs missing_ns = 0;  ///< of it without readings: there the nearest reading was held
    int readings = 0;           ///< used
    bool gyro_saturated = false, accel_saturated = false;  ///< one of them, at least
    bool saturated() const { return gyro_saturated || accel_saturated; }
  };
  /// Integrates from t0 to t1 >= t0, between readings by straight lines. What lies before the oldest reading, behind
  /// the newest or in a gap is bridged by holding the nearest, and told. Without any reading at all *out is left as it
  /// is and everything is missing. Where the times told scatter (time_scatter_s) a reading that differs from the one
  /// before counts as that much worse: of a shake of 60 m/s^2 at 85 Hz half a millisecond makes 40 times the noise of
  /// the sensor. Of what is saturated the error grows with the time, not with its root: it goes one way all along.
  Coverage integrate(rt::TimeNs t0_ns, rt::TimeNs t1_ns, const ImuNoise& noise, Preintegration* out) const;

  /// Mean, over span_ns around t_ns, of the turn since t_ns: rotation vector [rad] in the body's axes, to first order.
  /// A steady turn, and so the gyroscope's bias, has none. Where readings do not reach the nearest is held. Zero
  /// without readings.
  Vec3 mean_turn(rt::TimeNs t_ns, rt::TimeNs span_ns) const;
  /// How a camera's rows turn that are read over span_ns around t_ns, in the body's axes, from the first row to the
  /// last: rotation vectors [rad], to first order, and their rates [rad/s]. Taken off is how the mean over the rows
  /// turned on since the rows around t_before_ns, as a steady turn, and the mean of what is left: what is left over of
  /// the gyroscope's bias is nothing. False, and nothing is changed: the readings leave out some of it, or saturate.
  bool row_turns(rt::TimeNs t_before_ns, rt::TimeNs t_ns, rt::TimeNs span_ns, std::span<Vec3> turns,
                 std::span<Vec3> rates) const;
  /// What was turned from t0_ns to t1_ns >= t0_ns, to first order, the bias in it; readings are held where they end
  /// [rad]. Not empty.
  Vec3 turned(rt::TimeNs t0_ns, rt::TimeNs t1_ns) const;
  /// How far a time told is off a sensor's even pace, one sigma [s]: by the steps of the last tenth of a second or so,
  /// those that leave readings out aside. 0 with fewer than ten.
  double time_scatter_s() const;

  bool empty() const { return count_ == 0; }
  rt::TimeNs newest_ns() const { return at(count_ - 1).t_ns; }  ///< not empty
  std::uint64_t refused() const { return refused_; }
  void clear() { count_ = 0; }

 private:
  struct Kept : ImuReading {
    rt::TimeNs gyro_since_ns = 0, accel_since_ns = 0;  ///< saturated since then, if it is
  };
  const Kept& at(std::size_t i) const { return readings_[(first_ + i) % kReadings]; }
  /// What readings between these two, of the step from from_ns to to_ns, may be wrong by since they saturate: variances
  /// as Preintegration::add takes them.
  static Vec6 unmeasured(const Kept& a, const Kept& b, rt::TimeNs from_ns, rt::TimeNs to_ns);
  /// Between readings by a straight line, beyond them the nearest. Not empty.
  Vec3 rate_at(rt::TimeNs t_ns) const;
  /// The last reading at or before t_ns, or the oldest. Not empty.
  std::size_t at_or_before(rt::TimeNs t_ns) const;
  std::array<Kept, kReadings> readings_;
  std::size_t first_ = 0, count_ = 0;
  std::uint64_t refused_ = 0;
};

}  // namespace godwit::vo
