#include "vo_core/inertial/rest_vertical.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {
namespace {

constexpr double kRestS = 1.0;  ///< that a rest was averaged over
/// Of a velocity gained: how wrongly scaled an accelerometer of this kind is (MPU-6000: 3 % as it is bought, less when
/// calibrated); and what a push that is too small to end a rest makes of one.
constexpr double kVelocityShare = 0.02, kUnseenPush = 0.02, kUnseenForce = 0.02;
/// Of the last of a rest its pictures may be still to come.
constexpr rt::TimeNs kUnseenNs = 300 * rt::kNsPerMs;

}  // namespace

void KnownVertical::go_on(const Preintegration& d) {
  const Mat3 back = d.dR(gyro_bias).transpose();
  if (velocity_sigma > 0) {
    velocity = back * (velocity + d.dv(ImuBias{gyro_bias, Vec3::Zero()}) - d.dt_s() * force);
    velocity_by_bias = back * (velocity_by_bias + d.dv_dba() + d.dt_s() * R_body_rest);
    // White forces, and what the vertical is off by, which stays.
    velocity_sigma = std::sqrt(velocity_sigma * velocity_sigma + 4 / 3.0 * d.covariance().block<3, 3>(3, 3).trace()) +
                     force.norm() * sigma * d.dt_s();
    force = back * force;
    R_body_rest = back * R_body_rest;
  }
  up = back * up;
  by_bias = back * by_bias;
  // White turns; what the bias is off by and how crooked the gyroscope is, which stay.
  sigma = std::sqrt(sigma * sigma + 4 / 3.0 * d.covariance().topLeftCorner<3, 3>().trace()) +
          gyro_bias_sigma * d.dt_s() + RestVertical::kTurnShare * so3_log(back).norm();
}

void RestVertical::add(const ImuReading& reading) {
  const rt::TimeNs step_ns = reading.t_ns - last_.t_ns;
  const bool gap = !heard_ || step_ns <= 0 || step_ns > ImuBuffer::kGapNs;
  if (gap || reading.gyro_saturated || reading.accel_saturated) {
    blocks_full_ = readings_ = 0;
    sum_ = {};
    t_block_ns_ = reading.t_ns;
  }
  if (gap || reading.gyro_saturated) {
    known_ = false;
  } else if (known_) {
    const Vec3 rate = 0.5 * (last_.gyro_rad_s + reading.gyro_rad_s) - gyro_bias_;
    const double step_s = rt::to_seconds(step_ns);
    const Mat3 R_middle = R_rest_body_ * so3_exp(0.5 * step_s * rate);
    velocity_ += step_s * (R_middle * (0.5 * (last_.accel_m_s2 + reading.accel_m_s2)) - stood_force_);
    turns_ += step_s * R_middle;
    R_rest_body_ = R_rest_body_ * so3_exp(rate * step_s);
    velocity_known_ = velocity_known_ && !reading.accel_saturated;
  }
  last_ = reading;
  heard_ = true;
  sum_.gyro += reading.gyro_rad_s;
  sum_.accel += reading.accel_m_s2;
  ++readings_;
  if (reading.t_ns - t_block_ns_ >= kBlockNs) close_block();
}

void RestVertical::close_block() {
  blocks_[block_next_] = {sum_.gyro / readings_, sum_.accel / readings_};
  block_next_ = (block_next_ + 1) % kBlocks;
  blocks_full_ = std::min(kBlocks, blocks_full_ + 1);
  sum_ = {};
  readings_ = 0;
  t_block_ns_ = last_.t_ns;
  if (known_)
    turned_rad_ += rt::to_seconds(kBlockNs) * (blocks_[(block_next_ + kBlocks - 1) % kBlocks].gyro - gyro_bias_).norm();
  Block mean;
  if (!at_rest(&mean) || !shown_as_still(last_.t_ns)) return;
  known_ = true;
  turned_rad_ = 0;
  drift_rad_s_ = still_rad_ / std::max(kRestS / 2, rt::to_seconds(still_until_ns_ - still_since_ns_));
  force_ = mean.accel;
  gyro_bias_ = mean.gyro;
  R_rest_body_.setIdentity();
  t_rest_ns_ = last_.t_ns;
  velocity_known_ = true;
  stood_force_.setZero();
  velocity_.setZero();
  const auto block = [&](int k) { return blocks_[(block_next_ + k) % kBlocks].accel; };  // the oldest first
  for (int k = 0; k < kBlocks - kDoubtful; ++k) stood_force_ += block(k) / (kBlocks - kDoubtful);
  const double block_s = rt::to_seconds(kBlockNs);
  for (int k = kBlocks - kDoubtful; k < kBlocks; ++k) velocity_ += block_s * (block(k) - stood_force_);
  turns_ = kDoubtful * block_s * Mat3::Identity();
}

void RestVertical::picture(rt::TimeNs t_ns, double still_rad) {
  if (!(still_rad > 0)) {
    still_since_ns_ = kNever;
    return;
  }
  if (still_since_ns_ == kNever || t_ns < still_until_ns_) still_since_ns_ = t_ns;
  still_until_ns_ = t_ns;
  still_rad_ = still_rad;
}

bool RestVertical::shown_as_still(rt::TimeNs end_ns) const {
  const auto rest_ns = static_cast<rt::TimeNs>(kRestS * rt::kNsPerSecond);
  return still_since_ns_ != kNever && still_since_ns_ <= end_ns - rest_ns + kUnseenNs &&
         still_until_ns_ >= end_ns - kUnseenNs;
}

bool RestVertical::at_rest(Block* mean) const {
  if (blocks_full_ < kBlocks) return false;
  for (const Block& b : blocks_) {
    mean->gyro += b.gyro / kBlocks;
    mean->accel += b.accel / kBlocks;
  }
  double gyro2 = 0, accel2 = 0;
  for (const Block& b : blocks_) {
    gyro2 += (b.gyro - mean->gyro).squaredNorm();
    accel2 += (b.accel - mean->accel).squaredNorm();
  }
  const double freedom = 3 * (kBlocks - 1), block_s = rt::to_seconds(kBlockNs);
  return gyro2 / freedom < kScatter * noise_.gyro * noise_.gyro / block_s &&
         accel2 / freedom < kScatter * noise_.accel * noise_.accel / block_s &&
         mean->gyro.norm() < 3 * gyro_sigma_rad_s_ && mean->accel.norm() > 0.5 * gravity_m_s2_;
}

KnownVertical RestVertical::at(rt::TimeNs t_ns, const ImuBuffer& buffer) const {
  KnownVertical out;
  if (!known_) return out;
  Preintegration since(ImuBias{gyro_bias_, Vec3::Zero()});
  const rt::TimeNs begin_ns = std::min(t_ns, last_.t_ns), end_ns = std::max(t_ns, last_.t_ns);
  if (end_ns > begin_ns && buffer.integrate(begin_ns, end_ns, noise_, &since).missing_ns > ImuBuffer::kGapNs)
    return out;
  const Mat3 turned = since.dR(gyro_bias_);
  const Mat3 R_rest_body = t_ns > last_.t_ns ? Mat3(R_rest_body_ * turned) : Mat3(R_rest_body_ * turned.transpose());
  const double strength = force_.norm();
  const Vec3 up = force_ / strength;
  const Mat3 back = R_rest_body.transpose();
  out.known = true;
  out.up = back * up;
  out.by_bias = back * (up * up.transpose() - Mat3::Identity()) / strength;
  out.gyro_bias = gyro_bias_;
  // The means over the rest, white; then what the gyroscope's noise, its mean's, its walk and its scale turned.
  const double t = std::max(0.0, rt::to_seconds(t_ns - t_rest_ns_));
  const double turn = kTurnShare * std::max(turned_rad_, so3_log(R_rest_body).norm());
  out.sigma = std::sqrt(4 * (noise_.accel * noise_.accel / (kRestS * strength * strength) +
                             noise_.gyro * noise_.gyro * (t + t * t / kRestS) +
                             noise_.gyro_walk * noise_.gyro_walk * t * t * t / 3) +
                        turn * turn);
  out.gyro_bias_sigma = 2 * std::sqrt(noise_.gyro * noise_.gyro / kRestS + noise_.gyro_walk * noise_.gyro_walk * t);
  if (!velocity_known_) return out;
  out.drift_rad_s = drift_rad_s_;
  // Since the doubtful end of the rest began; before that it stood.
  const double doubtful_s = kDoubtful * rt::to_seconds(kBlockNs), stood_s = kRestS - doubtful_s;
  const double since_s = rt::to_seconds(t_ns - t_rest_ns_) + doubtful_s, moved_s = std::max(0.0, since_s);
  const double step_s = rt::to_seconds(t_ns - last_.t_ns);
  const Vec3 gained = since.dv(ImuBias{gyro_bias_, Vec3::Zero()});
  const bool later = t_ns > last_.t_ns;
  const Mat3& R_from = later ? R_rest_body_ : R_rest_body;  // of where `since` begins
  const Vec3 velocity = velocity_ + (later ? 1.0 : -1.0) * (R_from * gained) - step_s * stood_force_;
  const Mat3 turns = turns_ - (later ? 1.0 : -1.0) * (R_from * since.dv_dba());
  out.velocity = back * velocity;
  out.velocity_by_bias = back * (since_s * Mat3::Identity() - turns);
  out.force = back * stood_force_;
  out.up_at_rest = stood_force_.normalized();
  out.beyond_gravity = stood_force_.norm() - gravity_m_s2_;
  out.beyond_gravity_sigma =
      std::sqrt(4 * (noise_.accel * noise_.accel / stood_s + noise_.accel_walk * noise_.accel_walk * t) +
                kUnseenForce * kUnseenForce);
  out.R_body_rest = back;
  // White forces and the mean that is taken off them; what the gyroscope's noise, its mean's and its scale lean them
  // by; the accelerometer's scale.
  const double white = noise_.accel * noise_.accel * (moved_s + moved_s * moved_s / stood_s);
  const double leant = std::pow(strength * noise_.gyro, 2) * (std::pow(t, 3) / 3 + std::pow(t, 4) / (4 * kRestS));
  out.velocity_sigma = std::sqrt(4 * (white + leant) + std::pow(0.5 * strength * turn * t, 2) +
                                 std::pow(kVelocityShare * velocity.norm(), 2) + kUnseenPush * kUnseenPush);
  return out;
}

}  // namespace godwit::vo
