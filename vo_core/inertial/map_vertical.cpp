#include "vo_core/inertial/map_vertical.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {

bool MapVertical::take(const AttitudeReading& r) {
  const bool number =
      r.up.allFinite() && std::abs(r.up.norm() - 1) < 0.1 && std::isfinite(r.sigma_rad) && r.sigma_rad > 0;
  if (!number || r.t_ns <= t_read_ns_ || waiting_count_ == kWaiting) return false;
  t_read_ns_ = r.t_ns;
  waiting_[waiting_count_++] = r;
  return true;
}

void MapVertical::forget() {
  up_.setZero();
  count_ = 0;
  t_contradicted_ns_ = 0;
}

void MapVertical::correct_map(const MapCorrection& c) {
  const auto kept = static_cast<std::size_t>(std::min<std::uint64_t>(count_, kHeard));
  double earlier = 1, moved = 0;
  for (std::size_t i = 0; i < kept; ++i) {
    earlier -= recent_[i].weight;
    moved += recent_[i].weight * c.share(recent_[i].t_ns);
  }
  moved += std::max(0.0, earlier) * c.share(t_first_ns_);
  up_ = so3_exp(moved * c.turned_by) * up_;
  for (std::size_t i = 0; i < place_count_; ++i) places_[i].R_map_cam = c.turn(places_[i].t_ns) * places_[i].R_map_cam;
}

bool MapVertical::camera_at(rt::TimeNs t_ns, Mat3* R_map_cam, double* rate_rad_s) const {
  for (std::size_t i = place_count_; i-- > 1;) {
    const Place &from = places_[i - 1], &to = places_[i];
    if (t_ns < from.t_ns) continue;
    if (to.t_ns <= from.t_ns || to.t_ns - from.t_ns > options_.gap_ns) return false;
    const Vec3 turn = so3_log(from.R_map_cam.transpose() * to.R_map_cam);
    const double span_s = rt::to_seconds(to.t_ns - from.t_ns);
    *R_map_cam = from.R_map_cam * so3_exp(rt::to_seconds(t_ns - from.t_ns) / span_s * turn);
    *rate_rad_s = turn.norm() / span_s;
    return true;
  }
  return false;
}

void MapVertical::pose(rt::TimeNs t_ns, std::uint32_t map_id, const Mat3& R_map_cam, double stray_rate) {
  if (map_id != map_id_) {
    map_id_ = map_id;
    place_count_ = 0;
    forget();
  }
  if (place_count_ == kPlaces) {
    std::move(places_.begin() + 1, places_.end(), places_.begin());
    --place_count_;
  }
  places_[place_count_++] = {t_ns, R_map_cam};
  stray_rate_ = std::max(stray_rate, options_.walk * options_.walk);
  t_pose_ns_ = t_ns;
  std::size_t kept = 0;
  for (std::size_t i = 0; i < waiting_count_; ++i) {
    const AttitudeReading r = waiting_[i];
    if (r.t_ns > t_ns) {
      waiting_[kept++] = r;
      continue;
    }
    ++heard_;
    Mat3 R;
    double rate = 0;
    if (camera_at(r.t_ns, &R, &rate)) hear(r, R * (R_cam_body_ * r.up.normalized()), rate);
  }
  waiting_count_ = kept;
}

void MapVertical::hear(const AttitudeReading& r, const Vec3& up, double rate_rad_s) {
  if (r.t_ns < t_silent_until_ns_) return;
  const double turned = rate_rad_s * options_.time_sigma_s, own = r.sigma_rad * r.sigma_rad;
  // Turning this fast it says less of the vertical than of its own clock.
  if (turned > r.sigma_rad) return;
  if (count_ > 0) {
    // Both the mean and this one are off by what the source is; how the camera sits is common to them.
    const double variance = own + turned * turned + sigma_rad() * sigma_rad();
    const double off = angle_between(up, up_);
    const bool fits = off * off <= options_.limit2 * variance;
    if (!fits) ++contradictions_;
    if (!fits && !known()) {
      forget();  // the first one may have been the wrong one
    } else if (!fits) {
      if (t_contradicted_ns_ == 0) t_contradicted_ns_ = r.t_ns;
      if (r.t_ns - t_contradicted_ns_ < options_.contradicted_ns) return;
      // Which of the two is wrong nobody can tell.
      ++given_up_;
      t_silent_until_ns_ = r.t_ns + options_.silent_ns;
      forget();
      return;
    }
  }
  t_contradicted_ns_ = 0;
  if (count_ == 0) t_first_ns_ = t_heard_ns_ = r.t_ns;
  // A mean of all at first, and then one that forgets.
  const double since_s = rt::to_seconds(r.t_ns - t_heard_ns_) / rt::to_seconds(options_.memory_ns);
  const double share = std::min(1.0, std::max(1.0 / static_cast<double>(count_ + 1), since_s));
  for (Heard& h : recent_) h.weight *= 1 - share;
  recent_[count_ % kHeard] = {r.t_ns, share};
  ++count_;
  up_ = (up_ + share * (up - up_)).normalized();
  source_variance_ += share * (own - source_variance_);
  t_heard_ns_ = r.t_ns;
}

double MapVertical::sigma_rad() const {
  // The mean lags behind a map that strays by half its memory's worth of that walk; since the last reading nothing
  // holds it.
  const double memory_s = std::min(rt::to_seconds(options_.memory_ns), rt::to_seconds(t_heard_ns_ - t_first_ns_));
  const double unheard_s = rt::to_seconds(std::max<rt::TimeNs>(0, t_pose_ns_ - t_heard_ns_));
  return std::sqrt(source_variance_ + options_.mounting_sigma_rad * options_.mounting_sigma_rad +
                   stray_rate_ * (memory_s / 2 + unheard_s));
}

}  // namespace godwit::vo
