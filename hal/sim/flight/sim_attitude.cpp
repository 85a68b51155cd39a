#include "hal/sim/flight/sim_attitude.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

namespace godwit::sim {

SimAttitude::SimAttitude(const Flight& flight, rt::TimeNs start_ns)
    : flight_(flight), start_ns_(start_ns), rng_(flight.seed(), 0xa771) {
  const double sigma = flight.scenario().attitude.wander_deg * M_PI / 180;
  for (double& angle : wander_rad_) angle = sigma * rng_.gaussian();
}

bool SimAttitude::next(AttitudeSample* sample) {
  const AttitudePlan& plan = flight_.scenario().attitude;
  const double dt = 1 / plan.rate_hz, t = static_cast<double>(index_) * dt;
  if (t > flight_.duration_s()) return false;
  const double keep = std::exp(-dt / plan.wander_s), degree = M_PI / 180;
  Vec3 off;
  for (int i = 0; i < 3; ++i) {
    if (index_ > 0) {
      wander_rad_[i] = keep * wander_rad_[i] + std::sqrt(1 - keep * keep) * plan.wander_deg * degree * rng_.gaussian();
    }
    off[i] = wander_rad_[i] + plan.noise_deg * degree * rng_.gaussian();
  }
  // North is the world's x; its z is up.
  const Mat3 R_ned_world = Vec3(1, -1, -1).asDiagonal();
  const Mat3 R_world_body = flight_.trajectory().at(t).R_world_body;
  const Mat3 R = R_ned_world * R_world_body * Eigen::AngleAxisd(off.norm(), off.stableNormalized()).toRotationMatrix();
  const Eigen::Quaterniond q(R);
  off_deg_ = std::acos(std::min(1.0, R.row(2).dot((R_ned_world * R_world_body).row(2)))) / degree;
  sample->t_ns = start_ns_ + static_cast<rt::TimeNs>(std::llround(t * 1e9));
  sample->q_ned_body = {q.w(), q.x(), q.y(), q.z()};
  ++index_;
  return true;
}

}  // namespace godwit::sim
