#include "vo_core/inertial/scale_aids.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {
bool ScaleAids::take_start(const AidReading& r) {
  if (map_id_ != 0 || !(r.value_m.z() > 0)) return false;
  start_ = {true, 0, r.value_m, Vec3::Zero(), r.sigma_m};
  return true;
}

bool ScaleAids::take(const AidReading& r) {
  const bool number = r.value_m.allFinite() && std::isfinite(r.sigma_m) && r.sigma_m >= 0;
  if (number && r.source == ScaleSource::kStartHeight) return take_start(r);
  rt::TimeNs* const t_last_ns = &t_read_ns_[scale_source_index(r.source)];
  if (!number || r.t_ns <= *t_last_ns || waiting_count_ == kWaiting) return false;
  *t_last_ns = r.t_ns;
  waiting_[waiting_count_++] = r;
  return true;
}

bool ScaleAids::camera_at(rt::TimeNs t_ns, Vec3* camera) const {
  for (std::size_t i = place_count_; i-- > 1;) {
    const Place &from = places_[i - 1], &to = places_[i];
    if (t_ns < from.t_ns) continue;
    if (to.t_ns <= from.t_ns || to.t_ns - from.t_ns > options_.gap_ns) return false;
    const double share = rt::to_seconds(t_ns - from.t_ns) / rt::to_seconds(to.t_ns - from.t_ns);
    *camera = from.camera + share * (to.camera - from.camera);
    return true;
  }
  return false;
}

void ScaleAids::keep_place(const AidPose& pose) {
  if (place_count_ == kPlaces) {
    std::move(places_.begin() + 1, places_.end(), places_.begin());
    --place_count_;
  }
  places_[place_count_++] = {pose.t_ns, pose.camera};
}

void ScaleAids::pose(const AidPose& pose) {
  if (pose.map_id != map_id_) {
    // The height is that of the first map's beginning; where another one begins nobody said.
    start_.set = start_.set && map_id_ == 0;
    start_.t_ns = pose.t_ns;
    start_.camera = pose.camera;
    map_id_ = pose.map_id;
    state_.new_map();
    moments_ = {};
    t_ground_ns_ = 0;
    place_count_ = 0;
  }
  keep_place(pose);
  std::size_t kept = 0;
  for (std::size_t i = 0; i < waiting_count_; ++i) {
    const AidReading& r = waiting_[i];
    if (r.t_ns > pose.t_ns) {
      waiting_[kept++] = r;
      continue;
    }
    Vec3 camera;
    if (camera_at(r.t_ns, &camera)) compare(r, pose, camera);
  }
  waiting_count_ = kept;
  above_start(pose);
  state_.advance(pose.t_ns);
  t_told_ns_ = std::max(t_told_ns_, pose.t_ns);
}

void ScaleAids::compare(const AidReading& r, const AidPose& pose, const Vec3& camera) {
  if (r.source == ScaleSource::kRange) {
    above_ground(r, pose, camera);
    return;
  }
  Moment* const from = &moments_[scale_source_index(r.source)];
  ScaleReading reading;
  if (from->set && r.t_ns - from->t_ns <= options_.longest_ns) {
    if (!lengths(r, pose, camera, *from, &reading)) return;
    state_.take(reading);
    t_told_ns_ = reading.t_ns;
  }
  *from = {true, r.t_ns, r.value_m, camera, r.sigma_m};
}

bool ScaleAids::lengths(const AidReading& r, const AidPose& pose, const Vec3& camera, const Moment& from,
                        ScaleReading* out) const {
  const Vec3 way = camera - from.camera, way_m = r.value_m - from.value_m;
  double variance = r.sigma_m * r.sigma_m + from.sigma_m * from.sigma_m;
  double stray = 0;
  if (r.source == ScaleSource::kBarometer) {
    if (pose.up.isZero()) return false;
    out->units = pose.up.dot(way);
    out->metres = way_m.z();
    variance += options_.pressure_walk * options_.pressure_walk * rt::to_seconds(r.t_ns - from.t_ns);
    stray = pose.up_sigma * (way - out->units * pose.up).norm();
  } else {
    out->units = way.norm();
    // Noise makes every length longer, by two axes across it.
    out->metres = std::sqrt(std::max(0.0, way_m.squaredNorm() - 2 * variance));
    variance += options_.arm_m * options_.arm_m;
  }
  out->source = r.source;
  // What comes late is news all the same, and the state's time never goes back.
  out->t_ns = std::max(r.t_ns, t_told_ns_);
  out->metres_sigma = std::sqrt(variance);
  out->units_sigma = std::hypot(stray, options_.depth_share * pose.depth, options_.way_share * way.norm());
  // Whether it is long enough is asked of vision where that can be told: who waits for a noisy length to become long
  // takes it when its noise is long.
  const bool known = state_.known();
  const double metres = known ? std::abs(out->units) * state_.scale() : std::abs(out->metres);
  const double share = known ? options_.share : options_.first_share;
  return out->metres_sigma < share * metres && out->units_sigma < share * std::abs(out->units);
}

bool ScaleAids::height_above_ground(const AidPose& pose, const Vec3& camera, double* units) const {
  if (pose.up.isZero() || std::ssize(pose.points) < options_.ground_points) return false;
  std::array<double, 64> below{};
  const std::size_t count = std::min(pose.points.size(), below.size());
  for (std::size_t i = 0; i < count; ++i) below[i] = pose.up.dot(camera - pose.points[i].cast<double>());
  const auto place =
      below.begin() + static_cast<std::ptrdiff_t>(options_.ground_quantile * static_cast<double>(count - 1));
  std::nth_element(below.begin(), place, below.begin() + static_cast<std::ptrdiff_t>(count));
  *units = *place;
  return true;
}

void ScaleAids::above_ground(const AidReading& r, const AidPose& pose, const Vec3& camera) {
  const double down = -pose.up.dot(pose.beam);
  // A beam that lies flatter than this meets a wall as soon as the ground.
  double units = 0;
  if (r.t_ns - t_ground_ns_ < options_.ground_ns || !(down > 0.8) || !height_above_ground(pose, camera, &units)) return;
  t_ground_ns_ = r.t_ns;
  t_told_ns_ = std::max(r.t_ns, t_told_ns_);
  state_.take({ScaleSource::kRange, t_told_ns_, down * r.value_m.z(), r.sigma_m, units,
               options_.ground_share * std::abs(units)});
}

void ScaleAids::above_start(const AidPose& pose) {
  double units = 0;
  if (!start_.set || !height_above_ground(pose, start_.camera, &units)) return;
  start_.set = false;
  // By then other ground is below.
  if (pose.t_ns - start_.t_ns > options_.longest_ns) return;
  t_told_ns_ = std::max(pose.t_ns, t_told_ns_);
  state_.take({ScaleSource::kStartHeight, t_told_ns_, start_.value_m.z(), start_.sigma_m, units,
               options_.ground_share * std::abs(units)});
}

void ScaleAids::correct_map(const MapCorrection& c) {
  for (Moment& m : moments_) m.camera = c.moved(m.t_ns, m.camera);
  start_.camera = c.moved(start_.t_ns, start_.camera);
  for (std::size_t i = 0; i < place_count_; ++i) places_[i].camera = c.moved(places_[i].t_ns, places_[i].camera);
}

}  // namespace godwit::vo
