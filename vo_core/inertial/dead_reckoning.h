// Where a body is by its inertial sensor alone, and how fast that becomes uncertain.
#pragma once

#include "vo_core/inertial/imu_preintegration.h"
#include "vo_core/inertial/inertial_factors.h"

namespace godwit::vo {

struct DeadReckoningOptions {
  ImuNoise imu;
  double gravity_m_s2 = kStandardGravity;
  /// By how much a body may change its speed and turn in a second in which nobody measures it, one sigma of an axis; a
  /// walk: with the root of the time.
  double unknown_speed_m_s = 2;
  double unknown_turn_rad = 0.3;
  /// So long the last reading is held; what is missing beyond it moves nothing and is unknown.
  rt::TimeNs held_ns = ImuBuffer::kGapNs;
};

/// Strapdown navigation in a frame with z up, metres, and the covariance of its error:
/// place [m], speed [m/s], attitude [rad] (left: R_true = exp(e) R, along the frame's axes), biases of gyroscope and
/// accelerometer. Plain value; no allocation.
class DeadReckoning {
 public:
  static constexpr int kSize = 15;
  enum Index { kPlace = 0, kSpeed = 3, kAttitude = 6, kGyroBias = 9, kAccelBias = 12 };
  using Matrix = Eigen::Matrix<double, kSize, kSize>;
  using Error = Eigen::Matrix<double, kSize, 1>;

  Mat3 R = Mat3::Identity();  ///< body to frame
  Vec3 p = Vec3::Zero(), v = Vec3::Zero();
  ImuBias bias;
  Matrix P = Matrix::Zero();

  /// From t0 to t1 by the readings, on the sensor's own clock. Returns how much of it nobody measured; for that span
  /// nothing but the speed held is assumed, and the covariance says so.
  rt::TimeNs propagate(const ImuBuffer& readings, rt::TimeNs t0_ns, rt::TimeNs t1_ns,
                       const DeadReckoningOptions& options);

  /// A measurement z = h(x) of N parts: residual z - h(x), its Jacobian by the error, its covariance. Returns the
  /// squared residual in sigmas, with N degrees of freedom, before the state is corrected by it. N of 4 at most, so
  /// that the inverse is a closed form.
  template <int N>
  double update(const Eigen::Matrix<double, N, 1>& residual, const Eigen::Matrix<double, N, kSize>& H,
                const Eigen::Matrix<double, N, N>& noise);

  void correct(const Error& e);
};

template <int N>
double DeadReckoning::update(const Eigen::Matrix<double, N, 1>& residual, const Eigen::Matrix<double, N, kSize>& H,
                             const Eigen::Matrix<double, N, N>& noise) {
  static_assert(N <= 4);
  const Eigen::Matrix<double, kSize, N> PHt = P.lazyProduct(H.transpose());
  const Eigen::Matrix<double, N, N> both = H.lazyProduct(PHt) + noise;
  const Eigen::Matrix<double, N, N> information = both.inverse();
  const Eigen::Matrix<double, kSize, N> gain = PHt.lazyProduct(information);
  const Eigen::Matrix<double, N, 1> weighted = information.lazyProduct(residual);
  correct(gain.lazyProduct(residual));
  const Matrix taken = gain.lazyProduct(PHt.transpose());
  P -= taken;
  P = (0.5 * (P + P.transpose())).eval();
  return residual.dot(weighted);
}

}  // namespace godwit::vo
