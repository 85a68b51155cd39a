#include "vo_core/inertial/navigation_frame.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {

using D = DeadReckoning;

namespace {

/// The turn about z that is nearest to a rotation.
double heading_of(const Mat3& R) {
  return std::atan2(R(1, 0) - R(0, 1), R(0, 0) + R(1, 1));
}

bool is_rotation(const Mat3& R) {
  return R.allFinite() && (R * R.transpose() - Mat3::Identity()).norm() < 1e-3 && R.determinant() > 0;
}

bool usable(const MetricMoment& m) {
  return is_rotation(m.T_child_cam.R) && is_rotation(m.R_body_cam) && m.T_child_cam.t.allFinite() &&
         m.velocity_m_s.allFinite() && m.covariance.allFinite() && m.velocity_covariance.allFinite() &&
         m.covariance.diagonal().minCoeff() > 0 && m.velocity_covariance.diagonal().minCoeff() > 0 &&
         m.moved_by_m.allFinite() && m.turned_by_rad.allFinite() && m.map_moved_by_m.allFinite() &&
         m.map_turned_by_rad.allFinite() && m.bias.gyro.allFinite() && m.bias.accel.allFinite() &&
         std::isfinite(m.gyro_bias_sigma) && std::isfinite(m.accel_bias_sigma) && std::abs(m.time_offset_s) < 1;
}

}  // namespace

NavigationFrame::NavigationFrame(const Vec3& t_body_cam_m, const NavigationOptions& options)
    : t_body_cam_(t_body_cam_m), options_(options), self_check_(options.self_check) {}

bool NavigationFrame::add(const ImuReading& reading) {
  const bool taken = buffer_.add(reading);
  // The buffer forgets after two seconds, and a camera may be silent for longer. Not up to the reading: a picture that
  // is late must not find the state ahead of it.
  const rt::TimeNs t_ns = reading.t_ns - shift_ns_ - ImuBuffer::kSpanNs / 4;
  if (taken && known_ && t_ns - t_state_ns_ > ImuBuffer::kSpanNs / 4) go_on_to(t_ns);
  return taken;
}

void NavigationFrame::break_frame(const char* why, double value, double limit) {
  known_ = drifted_off_ = false;
  state_.v.setZero();
  why_ = why;
  value_ = value;
  limit_ = limit;
}

void NavigationFrame::go_on_to(rt::TimeNs t_ns) {
  if (!known_ || t_ns <= t_state_ns_) return;
  blind_ns_ += state_.propagate(buffer_, t_state_ns_ + shift_ns_, t_ns + shift_ns_, options_.inertial);
  t_state_ns_ = t_ns;
  const double turned = std::sqrt(std::max(0.0, state_.P(D::kAttitude + 2, D::kAttitude + 2) - seen_heading_variance_));
  if (!(turned <= options_.broken_heading_rad)) {
    break_frame("turned blind too far to join on: sigma [mrad]", 1e3 * turned, 1e3 * options_.broken_heading_rad);
    drifted_off_ = true;
  }
}

bool NavigationFrame::expected(rt::TimeNs t_ns, Expected* out) const {
  if (!known_ || blind_ns_ > 0 || t_ns < t_state_ns_) return false;
  DeadReckoning then = state_;
  if (then.propagate(buffer_, t_state_ns_ + shift_ns_, t_ns + shift_ns_, options_.inertial) > 0) return false;
  const Vec3 p_nav = then.p + then.R * t_body_cam_;
  out->T_child_cam = {turn_.transpose() * then.R * R_body_cam_, anchor_child_ + turn_.transpose() * (p_nav - anchor_)};
  const auto variances = then.P.diagonal();
  out->place_sigma_m = std::sqrt(std::max(0.0, variances.segment<3>(D::kPlace).sum() - seen_variance_));
  out->turn_sigma_rad = std::sqrt(variances.segment<3>(D::kAttitude).sum());
  return true;
}

Vec3 NavigationFrame::rate_at(rt::TimeNs t_ns) const {
  return body_rate(buffer_, t_ns + shift_ns_, state_.bias, options_.inertial.imu);
}

Motion NavigationFrame::motion() const {
  if (!known_ || blind_ns_ > 0) return {};
  return motion_of(state_, {R_body_cam_, t_body_cam_}, t_state_ns_ + shift_ns_);
}

// The first frame is the first child itself; one after a break goes on where the last one ended.
void NavigationFrame::begin(const MetricMoment& m, const Mat3& R_child_body, const Vec3& p_child_body) {
  ++frame_id_;
  gauge_.setZero();
  child_id_ = m.child_id;
  if (!any_) {
    turn_ = Mat3::Identity();
    anchor_ = anchor_child_ = p_child_body;
  } else {
    turn_ = so3_exp(Vec3(0, 0, heading_of(state_.R * R_child_body.transpose())));
    anchor_ = state_.p;
    anchor_child_ = p_child_body;
  }
}

bool NavigationFrame::join(const MetricMoment& m, const Mat3& R_child_body, const Vec3& p_child_body) {
  DeadReckoning joined = state_;
  const auto turn_to_child = [&] { return so3_exp(Vec3(0, 0, heading_of(joined.R * R_child_body.transpose()))); };
  Mat3 turn = turn_to_child();
  const Mat3 own = turn * m.covariance.bottomRightCorner<3, 3>() * turn.transpose();
  const Vec3 tilt = so3_log(turn * R_child_body * joined.R.transpose());
  Eigen::Matrix<double, 2, D::kSize> H_tilt = Eigen::Matrix<double, 2, D::kSize>::Zero();
  H_tilt.block<2, 2>(0, D::kAttitude).setIdentity();
  const double tilt2 = joined.update<2>(tilt.head<2>(), H_tilt, own.topLeftCorner<2, 2>());

  turn = turn_to_child();
  const Vec3 arm = joined.R * rate_at(t_state_ns_).cross(t_body_cam_);
  const Vec3 speed = turn * m.velocity_m_s - arm;
  // The child's speed, turned by a heading that is dead reckoning's: its error is part of what is compared.
  Eigen::Matrix<double, 3, D::kSize> H_speed = Eigen::Matrix<double, 3, D::kSize>::Zero();
  H_speed.block<3, 3>(0, D::kSpeed).setIdentity();
  H_speed.col(D::kAttitude + 2) = -Vec3::UnitZ().cross(speed);
  const double speed2 =
      joined.update<3>(speed - joined.v, H_speed, Mat3(turn * m.velocity_covariance * turn.transpose()));

  if (!(tilt2 <= options_.most_tilt2)) {
    break_frame("the new map's vertical is not the sensor's: sigmas squared [0.1]", 10 * tilt2,
                10 * options_.most_tilt2);
    return false;
  }
  if (!(speed2 <= options_.most_speed2)) {
    break_frame("the new map's speed is not the sensor's: sigmas squared [0.1]", 10 * speed2,
                10 * options_.most_speed2);
    return false;
  }
  // Only now: what a wrong vertical or bias did to the speed it did to the place, too, so that the new map's speed
  // takes most of it back.
  const double grown = std::sqrt(std::max(0.0, joined.P.diagonal().segment<3>(D::kPlace).sum() - seen_variance_));
  if (!(grown <= options_.broken_sigma_m)) {
    break_frame("flown blind too far to join on: sigma [cm]", 100 * grown, 100 * options_.broken_sigma_m);
    state_.p = joined.p;
    return false;
  }
  state_ = joined;
  child_id_ = m.child_id;
  turn_ = turn_to_child();
  anchor_ = joined.p;
  anchor_child_ = p_child_body;
  gauge_.topLeftCorner<3, 3>() = joined.P.block<3, 3>(D::kPlace, D::kPlace);
  gauge_.topRightCorner<3, 1>() = joined.P.block<3, 1>(D::kPlace, D::kAttitude + 2);
  gauge_.bottomLeftCorner<1, 3>() = gauge_.topRightCorner<3, 1>().transpose();
  gauge_(3, 3) = joined.P(D::kAttitude + 2, D::kAttitude + 2);
  return true;
}

NavigationPose NavigationFrame::tell_seen(const MetricMoment& m) const {
  NavigationPose out;
  out.source = NavigationPose::Source::kSeen;
  out.frame_id = frame_id_;
  const Vec3 from_anchor = turn_ * (m.T_child_cam.t - anchor_child_);
  out.T_nav_cam = {turn_ * m.T_child_cam.R, anchor_ + from_anchor};
  out.velocity_m_s = turn_ * m.velocity_m_s;
  // Where and how the child hangs moves and turns all of it about the anchor; its own errors come on top.
  Eigen::Matrix<double, 6, 4> J = Eigen::Matrix<double, 6, 4>::Zero();
  J.topLeftCorner<3, 3>().setIdentity();
  J.block<3, 1>(0, 3) = Vec3::UnitZ().cross(from_anchor);
  J.block<3, 1>(3, 3) = Vec3::UnitZ();
  Mat6 turn6 = Mat6::Zero();
  turn6.topLeftCorner<3, 3>() = turn6.bottomRightCorner<3, 3>() = turn_;
  out.covariance = turn6 * m.covariance * turn6.transpose() + J * gauge_ * J.transpose();
  const Vec3 aside = Vec3::UnitZ().cross(out.velocity_m_s);
  out.velocity_covariance =
      turn_ * m.velocity_covariance * turn_.transpose() + gauge_(3, 3) * aside * aside.transpose();
  out.moved_by_m = turn_ * m.moved_by_m;
  out.turned_by_rad = turn_ * m.turned_by_rad;
  return out;
}

NavigationPose NavigationFrame::tell_coasted(rt::TimeNs t_ns) const {
  NavigationPose out;
  out.frame_id = frame_id_;
  out.unseen_ns = any_ ? t_ns - t_seen_ns_ : 0;
  out.why = why_;
  out.value = value_;
  out.limit = limit_;
  if (!known_) return out;
  if (blind_ns_ > 0) {
    out.why = "nothing seen, and the inertial sensor is silent [ms]";
    out.value = rt::to_ms(blind_ns_);
    out.limit = rt::to_ms(options_.inertial.held_ns);
    return out;
  }
  const double grown = std::sqrt(std::max(0.0, state_.P.diagonal().segment<3>(D::kPlace).sum() - seen_variance_));
  if (out.unseen_ns > options_.coast_ns) {
    out.why = "nothing seen for too long to coast [ms]";
    out.value = rt::to_ms(out.unseen_ns);
    out.limit = rt::to_ms(options_.coast_ns);
    return out;
  }
  if (!(grown <= options_.coast_sigma_m)) {
    out.why = "nothing seen, and too uncertain to coast: sigma [mm]";
    out.value = 1e3 * grown;
    out.limit = 1e3 * options_.coast_sigma_m;
    return out;
  }
  out.source = NavigationPose::Source::kCoasted;
  out.trust = self_check_.trust();
  const CameraMotion camera = camera_motion(state_, {R_body_cam_, t_body_cam_}, rate_at(t_ns));
  out.T_nav_cam = camera.T_nav_cam;
  out.velocity_m_s = camera.velocity_m_s;
  out.covariance = camera.covariance;
  out.velocity_covariance = camera.velocity_covariance;
  return out;
}

void NavigationFrame::hold(const NavigationPose& pose, const MetricMoment& m, rt::TimeNs t_ns) {
  shift_ns_ = static_cast<rt::TimeNs>(m.time_offset_s * 1e9);
  R_body_cam_ = m.R_body_cam;
  state_.bias = m.bias;
  state_.R = pose.T_nav_cam.R * m.R_body_cam.transpose();
  const Vec3 arm = state_.R * t_body_cam_;
  state_.p = pose.T_nav_cam.t - arm;
  state_.v = pose.velocity_m_s - state_.R * rate_at(t_ns).cross(t_body_cam_);
  Mat6 J = Mat6::Identity();
  J.topRightCorner<3, 3>() = skew(arm);
  const Mat6 C = J * pose.covariance * J.transpose();
  state_.P.setZero();
  state_.P.block<3, 3>(D::kPlace, D::kPlace) = C.topLeftCorner<3, 3>();
  state_.P.block<3, 3>(D::kPlace, D::kAttitude) = C.topRightCorner<3, 3>();
  state_.P.block<3, 3>(D::kAttitude, D::kPlace) = C.bottomLeftCorner<3, 3>();
  state_.P.block<3, 3>(D::kAttitude, D::kAttitude) = C.bottomRightCorner<3, 3>();
  state_.P.block<3, 3>(D::kSpeed, D::kSpeed) = pose.velocity_covariance;
  state_.P.diagonal().segment<3>(D::kGyroBias).setConstant(m.gyro_bias_sigma * m.gyro_bias_sigma);
  state_.P.diagonal().segment<3>(D::kAccelBias).setConstant(m.accel_bias_sigma * m.accel_bias_sigma);
  seen_variance_ = C.diagonal().head<3>().sum();
  seen_heading_variance_ = C(5, 5);
  t_state_ns_ = t_seen_ns_ = t_ns;
  blind_ns_ = 0;
  known_ = any_ = true;
}

// What vision corrected since is no motion. Scale and vertical move all of the way alike; by what it strayed before a
// correction of the map, what dead reckoning began with was off by its share only.
void NavigationFrame::correct_checked(const NavigationPose& pose, const MetricMoment& m) {
  const Vec3 map_moved = turn_ * m.map_moved_by_m, map_turned = turn_ * m.map_turned_by_rad;
  const MapCorrection of_map{t_checked_ns_ - kStrayedNs, t_checked_ns_, checked_.p, map_turned, map_moved};
  const double share = of_map.share(t_check_ns_);
  const Vec3 moved = pose.moved_by_m - map_moved + share * map_moved;
  const Mat3 turned = so3_exp(pose.turned_by_rad) * so3_exp(-map_turned) * of_map.turn(t_check_ns_);
  check_from_ += moved;
  checked_.p += moved;
  checked_.v = turned * checked_.v;
  checked_.R = turned * checked_.R;
}

void NavigationFrame::check(const NavigationPose& pose, const MetricMoment& m, rt::TimeNs t_ns) {
  bool whole = t_check_ns_ != 0 && last_seen_;
  if (whole) {
    correct_checked(pose, m);
    whole = checked_.propagate(buffer_, t_checked_ns_ + shift_ns_, t_ns + shift_ns_, options_.inertial) == 0;
    t_checked_ns_ = t_ns;
  }
  if (whole && t_ns - t_check_ns_ < options_.check_ns) return;
  if (whole) {
    const double vision = options_.check_sigma_m + options_.check_share * (state_.p - check_from_).norm();
    const Mat3 both = checked_.P.block<3, 3>(D::kPlace, D::kPlace) + vision * vision * Mat3::Identity();
    const Vec3 off = state_.p - checked_.p;
    if (self_check_.add(CheckedBy::kInertial, off.dot(both.inverse() * off), 3, t_ns)) {
      break_frame(self_check_.reason(), 10 * self_check_.value(), 10 * options_.self_check.lost);
    }
  }
  checked_ = state_;
  // From here on both have the same place and heading: only what moves them apart counts.
  checked_.P.topRows<3>().setZero();
  checked_.P.leftCols<3>().setZero();
  check_from_ = state_.p;
  t_check_ns_ = t_checked_ns_ = t_ns;
}

void NavigationFrame::contradicted(CheckedBy by, double squared, rt::TimeNs t_ns) {
  if (t_contradicted_ns_ != 0 && t_ns - t_contradicted_ns_ < options_.check_ns) return;
  t_contradicted_ns_ = t_ns;
  self_check_.doubt(by, squared, 1, t_ns);
}

NavigationPose NavigationFrame::frame(rt::TimeNs t_ns, const MetricMoment* seen) {
  go_on_to(t_ns);
  // Whoever is found lying is not heard any more, and an opinion that nobody repeats is none.
  for (const CheckedBy by : {CheckedBy::kBarometer, CheckedBy::kRange, CheckedBy::kSatellites})
    self_check_.forget_older(by, t_ns - options_.self_check.memory_ns);
  if (seen == nullptr || !usable(*seen)) {
    last_seen_ = false;
    return tell_coasted(t_ns);
  }
  const MetricMoment& m = *seen;
  const Mat3 R_child_body = m.T_child_cam.R * m.R_body_cam.transpose();
  const Vec3 p_child_body = m.T_child_cam.t - R_child_body * t_body_cam_;
  const bool tied = known_;
  const DeadReckoning before = state_;
  const bool other = m.child_id != child_id_;
  // Dead reckoning got lost, not the map: that hangs where it hung.
  if (drifted_off_ && !other) known_ = true;
  drifted_off_ = false;
  if (!known_ || (other && !join(m, R_child_body, p_child_body))) begin(m, R_child_body, p_child_body);
  NavigationPose out = tell_seen(m);
  if (known_ && tied && (!last_seen_ || other)) {
    // Against where dead reckoning had the camera.
    out.moved_by_m = out.T_nav_cam.t - (before.p + before.R * t_body_cam_);
    out.turned_by_rad = so3_log(out.T_nav_cam.R * (before.R * m.R_body_cam).transpose());
  } else if (!known_) {
    out.moved_by_m.setZero();
    out.turned_by_rad.setZero();
    if (any_) out.why = why_, out.value = value_, out.limit = limit_;
  }
  hold(out, m, t_ns);
  check(out, m, t_ns);
  last_seen_ = true;
  out.trust = self_check_.trust();
  return out;
}

}  // namespace godwit::vo
