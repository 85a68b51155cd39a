#include "vo_core/inertial/georeference.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {

bool Georeference::take(const SatelliteFix& f) {
  const bool number = f.place_m.allFinite() && f.velocity_m_s.allFinite() && std::isfinite(f.place_sigma_m) &&
                      f.place_sigma_m > 0 && std::isfinite(f.velocity_sigma_m_s) && f.velocity_sigma_m_s >= 0;
  if (!number || f.t_ns <= t_fix_ns_ || waiting_count_ == kWaiting) return false;
  t_fix_ns_ = f.t_ns;
  waiting_[waiting_count_++] = f;
  return true;
}

bool Georeference::place_at(rt::TimeNs t_ns, NavigatedPlace* out, double* turn_rate) const {
  for (std::size_t i = place_count_; i-- > 1;) {
    const NavigatedPlace &from = places_[i - 1], &to = places_[i];
    if (t_ns < from.t_ns) continue;
    if (to.t_ns - from.t_ns > options_.gap_ns) return false;
    const double dt = rt::to_seconds(to.t_ns - from.t_ns), share = rt::to_seconds(t_ns - from.t_ns) / dt;
    *out = to;
    out->t_ns = t_ns;
    out->T_nav_cam.t = from.T_nav_cam.t + share * (to.T_nav_cam.t - from.T_nav_cam.t);
    out->velocity_m_s = from.velocity_m_s + share * (to.velocity_m_s - from.velocity_m_s);
    *turn_rate = so3_log(from.T_nav_cam.R.transpose() * to.T_nav_cam.R).norm() / dt;
    return true;
  }
  return false;
}

void Georeference::pose(const NavigatedPlace& place) {
  const bool number = place.T_nav_cam.R.allFinite() && place.T_nav_cam.t.allFinite() &&
                      place.velocity_m_s.allFinite() && std::isfinite(place.place_variance) &&
                      std::isfinite(place.heading_variance) && std::isfinite(place.velocity_variance);
  if (!number || (place_count_ > 0 && place.t_ns <= places_[place_count_ - 1].t_ns)) return;
  if (place.frame_id != frame_id_) {
    if (begun_ && frame_id_ != 0) {
      P_(kHeading, kHeading) += options_.broken_heading_rad * options_.broken_heading_rad;
      P_.diagonal().segment<3>(kPlace).array() += options_.broken_sigma_m * options_.broken_sigma_m;
    }
    frame_id_ = place.frame_id;
    place_count_ = 0;
    first_set_ = false;
    last_ = place;
  }
  if (place_count_ == kPlaces) {
    std::move(places_.begin() + 1, places_.end(), places_.begin());
    --place_count_;
  }
  places_[place_count_++] = place;
  std::size_t kept = 0;
  for (std::size_t i = 0; i < waiting_count_; ++i) {
    const SatelliteFix fix = waiting_[i];
    NavigatedPlace at;
    double turn_rate = 0;
    if (fix.t_ns > place.t_ns) {
      waiting_[kept++] = fix;
    } else if (place_at(fix.t_ns, &at, &turn_rate)) {
      hear(fix, at, turn_rate);
    }
  }
  waiting_count_ = kept;
}

double Georeference::white_variance(const SatelliteFix& fix) const {
  const double white = options_.white_share * fix.place_sigma_m;
  return white * white + options_.arm_m * options_.arm_m;
}

// The heading that a velocity shows, or a way; the surer of both once it is worth something.
bool Georeference::begin_heading(const SatelliteFix& fix, const NavigatedPlace& at, double velocity_variance) {
  if (!first_set_) {
    first_set_ = true;
    first_ = fix;
    first_place_ = at.T_nav_cam.t;
  }
  const Vec2 way = (at.T_nav_cam.t - first_place_).head<2>(), way_told = (fix.place_m - first_.place_m).head<2>();
  const double apart_s = rt::to_seconds(fix.t_ns - first_.t_ns), wander_s = rt::to_seconds(options_.wander_ns);
  const double strayed = fix.place_sigma_m * fix.place_sigma_m * (1 - std::exp(-apart_s / wander_s));
  const double by_way = 2 * (strayed + white_variance(fix)) / std::max(way.squaredNorm(), 1e-12);
  const Vec2 speed = at.velocity_m_s.head<2>();
  const double by_speed =
      fix.velocity_sigma_m_s > 0 ? velocity_variance / std::max(speed.squaredNorm(), 1e-12) : by_way;
  const double variance = std::min(by_way, by_speed);
  if (!(variance < options_.begin_sigma_rad * options_.begin_sigma_rad)) return false;
  const Vec2 seen = by_speed < by_way ? speed : way, told = by_speed < by_way ? fix.velocity_m_s : way_told;
  heading_ = std::atan2(seen.x() * told.y() - seen.y() * told.x(), seen.dot(told));
  reference_ = at.T_nav_cam.t;
  place_ = fix.place_m;
  wander_.setZero();
  // The place is what was told less what it wanders by, of which nothing is known.
  const double wander2 = fix.place_sigma_m * fix.place_sigma_m;
  P_.setZero();
  P_(kHeading, kHeading) = variance;
  P_.diagonal().segment<3>(kPlace).setConstant(wander2 + white_variance(fix));
  P_.diagonal().segment<3>(kWander).setConstant(wander2);
  P_.block<3, 3>(kPlace, kWander).diagonal().setConstant(-wander2);
  P_.block<3, 3>(kWander, kPlace).diagonal().setConstant(-wander2);
  last_ = at;
  contradictions_ = 0;
  return true;
}

// The camera's place becomes the reference: what vision strays by turns and moves what comes after it, not before.
void Georeference::advance(const NavigatedPlace& at) {
  const Vec3 way = turn() * (at.T_nav_cam.t - reference_);
  const double dt = std::max(0.0, rt::to_seconds(at.t_ns - last_.t_ns));
  const double decay = std::exp(-dt / rt::to_seconds(options_.wander_ns));
  Eigen::Matrix<double, kSize, kSize> F = Eigen::Matrix<double, kSize, kSize>::Identity();
  F.block<3, 1>(kPlace, kHeading) = Vec3::UnitZ().cross(way);
  F.diagonal().segment<3>(kWander).setConstant(decay);
  P_ = (F * P_ * F.transpose()).eval();
  place_ += way;
  wander_ *= decay;
  reference_ = at.T_nav_cam.t;
  P_(kHeading, kHeading) += std::max(0.0, at.heading_variance - last_.heading_variance);
  P_.diagonal().segment<3>(kPlace).array() += std::max(0.0, at.place_variance - last_.place_variance);
  last_ = at;
}

template <int N>
bool Georeference::update(const Eigen::Matrix<double, N, 1>& innovation, const Rows<N>& H, double variance,
                          double limit2) {
  using MatN = Eigen::Matrix<double, N, N>;
  const MatN S = H * P_ * H.transpose() + variance * MatN::Identity();
  const MatN S_inverse = S.inverse();
  if (!(innovation.dot(S_inverse * innovation) <= limit2)) return false;
  const Eigen::Matrix<double, kSize, N> K = P_ * H.transpose() * S_inverse;
  const Eigen::Matrix<double, kSize, 1> dx = K * innovation;
  heading_ = std::remainder(heading_ + dx(kHeading), 2 * M_PI);
  place_ += dx.segment<3>(kPlace);
  wander_ += dx.segment<3>(kWander);
  const Eigen::Matrix<double, kSize, kSize> A = Eigen::Matrix<double, kSize, kSize>::Identity() - K * H;
  P_ = (A * P_ * A.transpose() + variance * K * K.transpose()).eval();
  return true;
}

void Georeference::contradicted() {
  ++refused_;
  if (++contradictions_ < options_.contradictions) return;
  ++given_up_;
  // What was held for true is told on, as no surer than after a broken frame, until a new heading has begun.
  P_(kHeading, kHeading) += options_.broken_heading_rad * options_.broken_heading_rad;
  begun_ = first_set_ = false;
  contradictions_ = 0;
}

void Georeference::hear(const SatelliteFix& fix, const NavigatedPlace& at, double turn_rate) {
  // Of velocities that the receiver smooths so many in a row say the same.
  const double apart_s = t_velocity_ns_ > 0 ? rt::to_seconds(fix.t_ns - t_velocity_ns_) : 0;
  const double repeats = apart_s > 0 ? std::max(1.0, rt::to_seconds(options_.velocity_ns) / apart_s) : 1;
  t_velocity_ns_ = fix.t_ns;
  const double swing = options_.arm_m * turn_rate;
  const double velocity_variance =
      repeats * (fix.velocity_sigma_m_s * fix.velocity_sigma_m_s + swing * swing) + at.velocity_variance;
  if (!begun_) {
    begun_ = begin_heading(fix, at, velocity_variance);
    used_ += begun_ ? 1 : 0;
    return;
  }
  advance(at);
  // The wander is as large as the receiver says now.
  const double decay = std::exp(-apart_s / rt::to_seconds(options_.wander_ns));
  P_.diagonal().segment<3>(kWander).array() += (1 - decay * decay) * fix.place_sigma_m * fix.place_sigma_m;

  Rows<3> H_place = Rows<3>::Zero();
  H_place.block<3, 3>(0, kPlace).setIdentity();
  H_place.block<3, 3>(0, kWander).setIdentity();
  bool fits = update<3>(fix.place_m - place_ - wander_, H_place, white_variance(fix), options_.place_limit2);
  if (fix.velocity_sigma_m_s > 0) {
    const Vec3 speed = turn() * at.velocity_m_s;
    Rows<2> H_speed = Rows<2>::Zero();
    H_speed.col(kHeading) = Vec2(-speed.y(), speed.x());
    const Vec2 off = fix.velocity_m_s - speed.head<2>();
    fits = update<2>(off, H_speed, velocity_variance, options_.velocity_limit2) && fits;
  }
  if (!fits) {
    contradicted();
    return;
  }
  contradictions_ = 0;
  ++used_;
  known_ |= heading_sigma() < options_.known_sigma_rad;
}

}  // namespace godwit::vo
