#include "vo_core/inertial/rest_vertical.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {
namespace {

constexpr double kRestS = 1.0;  ///< that a rest was averaged over

}  // namespace

void KnownVertical::go_on(const Preintegration& d) {
  const Mat3 back = d.dR(gyro_bias).transpose();
  up = back * up;
  by_bias = back * by_bias;
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
    R_rest_body_ = R_rest_body_ * so3_exp(rate * rt::to_seconds(step_ns));
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
  Block mean;
  if (!at_rest(&mean)) return;
  known_ = true;
  force_ = mean.accel;
  gyro_bias_ = mean.gyro;
  R_rest_body_.setIdentity();
  t_rest_ns_ = last_.t_ns;
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
  const double turn = kTurnShare * so3_log(R_rest_body).norm();
  out.sigma = std::sqrt(4 * (noise_.accel * noise_.accel / (kRestS * strength * strength) +
                             noise_.gyro * noise_.gyro * (t + t * t / kRestS) +
                             noise_.gyro_walk * noise_.gyro_walk * t * t * t / 3) +
                        turn * turn);
  return out;
}

}  // namespace godwit::vo
