#include "vo_core/inertial/georeference.h"

namespace godwit::vo {
namespace {

constexpr double kMostSigma = 1e3;                         // [m], [m/s]: beyond, nobody measures
constexpr rt::TimeNs kMostAhead = 2 * rt::kNsPerSecond;    // of the pictures
constexpr rt::TimeNs kFirstKept = 120 * rt::kNsPerSecond;  // a way since longer ago is mostly stray
constexpr rt::TimeNs kTurned = 200 * rt::kNsPerMs;         // what stamps are late by, and longer than a shake

double squared(double x) {
  return x * x;
}

double turned_by(double to, double from) {
  return std::remainder(to - from, 2 * M_PI);
}

/// From one direction to the other [rad].
double angle(const Vec2& from, const Vec2& to) {
  return std::atan2(from.x() * to.y() - from.y() * to.x(), from.dot(to));
}

/// Variance of the angle between two that should be of one length [rad^2]; 1: they are not.
double angle_variance(const Vec2& seen, const Vec2& told, double variance) {
  if (!(squared(seen.norm() - told.norm()) < 9 * variance)) return 1;
  return variance / std::max(seen.squaredNorm(), 1e-12);
}

}  // namespace

bool Georeference::take(const SatelliteFix& f) {
  const bool number = f.place_m.allFinite() && f.velocity_m_s.allFinite() && f.place_sigma_m > 0 &&
                      f.place_sigma_m < kMostSigma && f.velocity_sigma_m_s >= 0 && f.velocity_sigma_m_s < kMostSigma;
  const bool ahead = place_count_ > 0 && f.t_ns > places_[place_count_ - 1].t_ns + kMostAhead;
  if (!number || ahead || f.t_ns <= t_fix_ns_) return false;
  if (waiting_count_ == kWaiting) {
    std::move(waiting_.begin() + 1, waiting_.end(), waiting_.begin());
    --waiting_count_;
  }
  t_fix_ns_ = f.t_ns;
  SatelliteFix& kept = waiting_[waiting_count_++];
  kept = f;
  kept.place_sigma_m = std::max(f.place_sigma_m, options_.least_place_sigma_m);
  if (f.velocity_sigma_m_s > 0)
    kept.velocity_sigma_m_s = std::max(f.velocity_sigma_m_s, options_.least_velocity_sigma_m_s);
  return true;
}

bool Georeference::moment_at(rt::TimeNs t_ns, Moment* out) const {
  for (std::size_t i = place_count_; i-- > 1;) {
    const NavigatedPlace &from = places_[i - 1], &to = places_[i];
    if (t_ns < from.t_ns) continue;
    if (to.t_ns - from.t_ns > options_.gap_ns) return false;
    const double dt = rt::to_seconds(to.t_ns - from.t_ns), share = rt::to_seconds(t_ns - from.t_ns) / dt;
    out->at = to;
    out->at.t_ns = t_ns;
    out->at.T_nav_cam.t = from.T_nav_cam.t + share * (to.T_nav_cam.t - from.T_nav_cam.t);
    out->at.velocity_m_s = from.velocity_m_s + share * (to.velocity_m_s - from.velocity_m_s);
    out->turn_rate = so3_log(from.T_nav_cam.R.transpose() * to.T_nav_cam.R).norm() / dt;
    std::size_t before = i - 1;
    while (before > 0 && t_ns - places_[before - 1].t_ns <= kTurned) --before;
    const NavigatedPlace& began = places_[before];
    out->acceleration = (to.velocity_m_s - began.velocity_m_s) / rt::to_seconds(to.t_ns - began.t_ns);
    return true;
  }
  return false;
}

void Georeference::new_frame(const NavigatedPlace& place) {
  if (frame_id_ != 0) {
    broken_ = known_;
    for (State* const s : {&x_, &held_, &first_known_}) {
      s->P(kHeading, kHeading) += squared(options_.broken_heading_rad);
      s->P.diagonal().segment<3>(kPlace).array() += squared(options_.broken_sigma_m);
      s->last = place;
    }
  }
  frame_id_ = place.frame_id;
  place_count_ = 0;
  first_set_ = false;
}

void Georeference::pose(const NavigatedPlace& place) {
  const bool number = place.T_nav_cam.R.allFinite() && place.T_nav_cam.t.allFinite() &&
                      place.velocity_m_s.allFinite() && std::isfinite(place.place_variance) &&
                      std::isfinite(place.heading_variance) && std::isfinite(place.velocity_variance);
  if (!number || (place_count_ > 0 && place.t_ns <= places_[place_count_ - 1].t_ns)) return;
  if (place.frame_id != frame_id_) new_frame(place);
  if (place_count_ > 0)
    strayed_variance_ += std::max(0.0, place.heading_variance - places_[place_count_ - 1].heading_variance);
  if (place_count_ == kPlaces) {
    std::move(places_.begin() + 1, places_.end(), places_.begin());
    --place_count_;
  }
  places_[place_count_++] = place;
  std::size_t kept = 0;
  for (std::size_t i = 0; i < waiting_count_; ++i) {
    const SatelliteFix fix = waiting_[i];
    Moment m;
    if (fix.t_ns > place.t_ns) {
      waiting_[kept++] = fix;
    } else if (moment_at(fix.t_ns, &m)) {
      hear(fix, m);
    }
  }
  waiting_count_ = kept;
}

void Georeference::corrected(double turned_rad, double moved_m) {
  if (!std::isfinite(turned_rad) || !std::isfinite(moved_m)) return;
  for (State* const s : {&x_, &held_, &first_known_}) {
    s->P(kHeading, kHeading) += squared(turned_rad);
    s->P.diagonal().segment<3>(kPlace).array() += squared(moved_m) / 3;
  }
}

double Georeference::heading_sigma() const {
  const State& s = state();
  return std::sqrt(s.P(kHeading, kHeading) + seen_variance(s, &NavigatedPlace::heading_variance));
}

double Georeference::place_sigma_m() const {
  const State& s = state();
  return std::sqrt(s.P.block<3, 3>(kPlace, kPlace).trace() / 3 + seen_variance(s, &NavigatedPlace::place_variance));
}

double Georeference::white_variance(const SatelliteFix& fix, const NavigatedPlace& at) const {
  return squared(options_.white_share * fix.place_sigma_m) + squared(options_.arm_m) +
         squared(options_.jitter_s) * at.velocity_m_s.squaredNorm() / 3;
}

// The heading that a velocity shows, or a way; the surer of both once it is worth something.
bool Georeference::begin(const SatelliteFix& fix, const Moment& m, double velocity_variance) {
  if (!first_set_ || fix.t_ns - first_.t_ns > kFirstKept) {
    first_set_ = true;
    first_ = fix;
    first_place_ = m.at;
  }
  const double apart_s = rt::to_seconds(fix.t_ns - first_.t_ns), wander_s = rt::to_seconds(options_.wander_ns);
  const double strayed = squared(fix.place_sigma_m) * (1 - std::exp(-apart_s / wander_s));
  const Vec2 way = (m.at.T_nav_cam.t - first_place_.T_nav_cam.t).head<2>();
  const Vec2 way_told = (fix.place_m - first_.place_m).head<2>();
  const double by_way = angle_variance(
      way, way_told,
      2 * (strayed + white_variance(fix, m.at)) + std::max(0.0, m.at.place_variance - first_place_.place_variance));
  const Vec2 speed = m.at.velocity_m_s.head<2>();
  const double by_speed =
      fix.velocity_sigma_m_s > 0
          ? angle_variance(speed, fix.velocity_m_s, velocity_variance + squared(options_.velocity_bias_m_s))
          : 1;
  const double variance = std::min(by_way, by_speed);
  if (!(variance < squared(options_.begin_sigma_rad))) return false;
  const bool by_velocity = by_speed < by_way;
  begin_at(fix, m, by_velocity ? angle(speed, fix.velocity_m_s) : angle(way, way_told), variance, by_velocity);
  return true;
}

void Georeference::begin_at(const SatelliteFix& fix, const Moment& m, double heading, double variance, bool by_speed) {
  const NavigatedPlace& at = m.at;
  x_ = {};
  x_.begun = true;
  x_.heading = heading;
  x_.reference = at.T_nav_cam.t;
  x_.place = fix.place_m;
  x_.last = at;
  x_.P(kHeading, kHeading) = variance;
  // The place is what was told less what it wanders by, of which nothing is known.
  const double wander = squared(fix.place_sigma_m);
  x_.P.diagonal().segment<3>(kPlace).setConstant(wander + white_variance(fix, at));
  x_.P.diagonal().segment<3>(kWander).setConstant(wander);
  x_.P.block<3, 3>(kPlace, kWander).diagonal().setConstant(-wander);
  x_.P.block<3, 3>(kWander, kPlace).diagonal().setConstant(-wander);
  x_.P.diagonal().segment<2>(kDrift).setConstant(squared(options_.velocity_bias_m_s));
  // What was told is of a moment ago: by so much a second the camera is further on, and on another course.
  StateVec late = StateVec::Zero();
  late.segment<3>(kPlace) = turn_of(heading) * at.velocity_m_s;
  const Vec2 v = at.velocity_m_s.head<2>(), a = m.acceleration.head<2>();
  if (by_speed) late(kHeading) = (v.x() * a.y() - v.y() * a.x()) / v.squaredNorm();
  late(kLag) = 1;
  x_.P += squared(options_.lag_s) * MatN(late.lazyProduct(late.transpose()));
}

// The camera's place becomes the reference: what vision strays by turns and moves what comes after it, not before.
void Georeference::advance(const SatelliteFix& fix, const NavigatedPlace& at) {
  const Vec3 way = turn_of(x_.heading) * (at.T_nav_cam.t - x_.reference);
  const double dt = std::max(0.0, rt::to_seconds(at.t_ns - x_.last.t_ns));
  const double decay = std::exp(-dt / rt::to_seconds(options_.wander_ns)), fresh = 1 - decay * decay;
  MatN F = MatN::Identity();
  F.block<3, 1>(kPlace, kHeading) = Vec3::UnitZ().cross(way);
  F.diagonal().segment<5>(kWander).setConstant(decay);  // and of its velocity
  // lazyProduct: from nine rows on Eigen's operator* calls its blocked product, which allocates.
  const MatN carried = F.lazyProduct(x_.P);
  x_.P = carried.lazyProduct(F.transpose());
  x_.place += way;
  x_.wander *= decay;
  x_.drift *= decay;
  x_.reference = at.T_nav_cam.t;
  x_.P(kHeading, kHeading) += std::max(0.0, at.heading_variance - x_.last.heading_variance);
  x_.P.diagonal().segment<3>(kPlace).array() += std::max(0.0, at.place_variance - x_.last.place_variance);
  x_.P.diagonal().segment<3>(kWander).array() += fresh * squared(fix.place_sigma_m);
  x_.P.diagonal().segment<2>(kDrift).array() += fresh * squared(options_.velocity_bias_m_s);
  x_.last = at;
}

template <int N>
bool Georeference::update(const Eigen::Matrix<double, N, 1>& innovation, const Rows<N>& H, double variance,
                          double limit2) {
  using MatS = Eigen::Matrix<double, N, N>;
  const Eigen::Matrix<double, kSize, N> PH = x_.P.lazyProduct(H.transpose());
  const MatS S = MatS(H.lazyProduct(PH)) + variance * MatS::Identity();
  const MatS S_inverse = S.inverse();
  if (!(innovation.dot(S_inverse * innovation) <= limit2)) return false;
  const Eigen::Matrix<double, kSize, N> K = PH.lazyProduct(S_inverse);
  const StateVec dx = K.lazyProduct(innovation);
  x_.heading = std::remainder(x_.heading + dx(kHeading), 2 * M_PI);
  x_.place += dx.template segment<3>(kPlace);
  x_.wander += dx.template segment<3>(kWander);
  x_.drift += dx.template segment<2>(kDrift);
  x_.lag += dx(kLag);
  const MatN A = MatN::Identity() - MatN(K.lazyProduct(H));
  const MatN carried = A.lazyProduct(x_.P);
  x_.P = carried.lazyProduct(A.transpose());
  x_.P += variance * MatN(K.lazyProduct(K.transpose()));
  return true;
}

// Level, height and velocity each for itself: a receiver whose height has another zero tells north all the same.
bool Georeference::weigh(const SatelliteFix& fix, const Moment& m, double velocity_variance) {
  const double white = white_variance(fix, m.at);
  const auto way = [&] { return Vec3(turn_of(x_.heading) * m.at.velocity_m_s); };
  const auto off = [&] { return Vec3(fix.place_m - x_.place - x_.wander + x_.lag * way()); };
  Rows<2> level = Rows<2>::Zero();
  level.block<2, 2>(0, kPlace).setIdentity();
  level.block<2, 2>(0, kWander).setIdentity();
  level.col(kLag) = -way().head<2>();
  bool fits = update<2>(off().head<2>(), level, white, options_.level_limit2);
  Rows<1> height = Rows<1>::Zero();
  height(kPlace + 2) = height(kWander + 2) = 1;
  height(kLag) = -way().z();
  fits = update<1>(off().tail<1>(), height, white, options_.height_limit2) && fits;
  if (!(fix.velocity_sigma_m_s > 0)) return fits;
  const Vec3 speed = way() - x_.lag * (turn_of(x_.heading) * m.acceleration);
  Rows<2> H = Rows<2>::Zero();
  H.col(kHeading) = Vec2(-speed.y(), speed.x());
  H.block<2, 2>(0, kDrift).setIdentity();
  H.col(kLag) = -(turn_of(x_.heading) * m.acceleration).head<2>();
  const Vec2 slipped = fix.velocity_m_s - speed.head<2>() - x_.drift;
  return update<2>(slipped, H, velocity_variance, options_.level_limit2) && fits;
}

bool Georeference::within_reach(double heading) const {
  const double variance = first_known_.P(kHeading, kHeading) + strayed_variance_;
  return broken_ || squared(turned_by(heading, first_known_.heading)) < squared(options_.most_moved) * variance;
}

void Georeference::suspend(const State& held) {
  ++given_up_;
  // One that is held already stays.
  if (known_ && !suspended_) {
    held_ = held;
    suspended_ = true;
  }
  x_ = {};
  first_set_ = false;
  t_contradicted_ns_ = 0;
}

void Georeference::know() {
  known_ = true;
  broken_ = suspended_ = false;
  first_known_ = x_;
  strayed_variance_ = 0;
}

void Georeference::take_over_if_it_agrees() {
  const double candidate = x_.P(kHeading, kHeading);
  const double variance = held_.P(kHeading, kHeading) + seen_variance(held_, &NavigatedPlace::heading_variance);
  if (candidate < squared(options_.known_sigma_rad) && within_reach(x_.heading) &&
      squared(turned_by(x_.heading, held_.heading)) < 9 * (variance + candidate))
    suspended_ = false;
}

void Georeference::hear(const SatelliteFix& fix, const Moment& m) {
  // Of velocities that the receiver smooths so many in a row say the same.
  const double apart_s = t_heard_ns_ > 0 ? rt::to_seconds(fix.t_ns - t_heard_ns_) : 0;
  const double repeats = apart_s > 0 ? std::max(1.0, rt::to_seconds(options_.velocity_ns) / apart_s) : 1;
  t_heard_ns_ = fix.t_ns;
  const double swung = squared(options_.arm_m * m.turn_rate),
               late = squared(options_.jitter_s) * m.acceleration.squaredNorm();
  const double velocity_variance =
      repeats * (squared(fix.velocity_sigma_m_s) + swung + late) + std::max(0.0, m.at.velocity_variance);
  if (!x_.begun) {
    if (begin(fix, m, velocity_variance)) ++used_;
    return;
  }
  advance(fix, m.at);
  if (!weigh(fix, m, velocity_variance)) {
    ++refused_;
    if (t_contradicted_ns_ == 0) t_contradicted_ns_ = fix.t_ns;
    if (rt::to_seconds(fix.t_ns - t_contradicted_ns_) >= options_.contradicted_s) suspend(x_);
    return;
  }
  t_contradicted_ns_ = 0;
  ++used_;
  if ((!known_ || broken_) && x_.P(kHeading, kHeading) < squared(options_.known_sigma_rad)) know();
  if (suspended_) {
    take_over_if_it_agrees();
  } else if (known_ && !within_reach(x_.heading)) {
    suspend(first_known_);
  }
}

}  // namespace godwit::vo
