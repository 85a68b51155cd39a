#include "vo_core/inertial/inertial_odometry.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "vo_core/inertial/rolling_sight.h"

namespace godwit::vo {

using S = InertialState;

namespace {

/// How sure one is of a gyroscope's bias that a map before saw some seconds ago [rad/s].
constexpr double kKeptGyroSigma = 2e-3;

}  // namespace

InertialOdometry::InertialOdometry(const CameraMounting& mounting, const InertialOdometryOptions& options)
    : MetricMap(options.stray_as_seen()),
      options_(options),
      prior_(options.prior),
      begin_accel_sigma_(options.begin_bias_margin * options.prior.accel_bias_sigma),
      rest_(options.model.imu, options.model.gravity_m_s2, options.prior.gyro_bias_sigma),
      smoother_(mounting, options.model),
      aids_(options.aids) {}

void InertialOdometry::add(const ImuReading& reading) {
  if (buffer_.add(reading)) rest_.add(reading);
  if (smoother_.size() == 0) return;
  // Not up to the reading: a picture may be late.
  const rt::TimeNs t_node_ns = smoother_.node(smoother_.size() - 1).t_ns;
  const rt::TimeNs t_ns = reading.t_ns - ImuBuffer::kSpanNs / 4;
  if (t_ns - std::max(t_bridge_ns_, t_node_ns) <= ImuBuffer::kSpanNs / 4) return;
  bridge_missing_ns_ = measured_since(t_ns, &bridge_);
  t_bridge_ns_ = t_ns;
}

rt::TimeNs InertialOdometry::measured_since(rt::TimeNs t_ns, Preintegration* since) const {
  rt::TimeNs from_ns = smoother_.node(smoother_.size() - 1).t_ns;
  rt::TimeNs missing_ns = 0;
  if (t_bridge_ns_ > from_ns) {
    *since = bridge_;
    from_ns = t_bridge_ns_;
    missing_ns = bridge_missing_ns_;
  } else {
    *since = Preintegration(smoother_.newest().bias);
  }
  return missing_ns + buffer_.integrate(from_ns, t_ns, options_.model.imu, since).missing_ns;
}

rt::TimeNs InertialOdometry::moment_of(const VisualPose& pose) const {
  const double offset_s = metric() ? smoother_.newest().time_offset_s : prior_.time_offset_s;
  return pose.t_ns + static_cast<rt::TimeNs>(offset_s * 1e9);
}

VisionSight InertialOdometry::sight_of(const VisualPose& pose, rt::TimeNs t_ns) const {
  VisionSight sight;
  sight.shift_s = rt::to_seconds(t_ns - pose.t_ns);
  sight.R_map_cam = pose.T_map_cam.R;
  sight.camera = pose.T_map_cam.t;
  sight.depth = std::max(1e-6, pose.median_depth);
  sight.own_position = std::sqrt(pose.own_covariance.diagonal().head<3>().mean());
  sight.position_rate = stray_.position_rate() * sight.depth * sight.depth;
  sight.rotation_rate = stray_.rotation_rate();
  sight.position_in_map = std::sqrt(std::max(0.0, pose.covariance.diagonal().head<3>().mean()));
  sight.rotation_in_map = std::sqrt(std::max(0.0, pose.covariance.diagonal().tail<3>().mean()));
  // The mean rate over 10 ms around the frame.
  const rt::TimeNs half_ns = std::max(5 * rt::kNsPerMs, options_.readout_ns / 2);
  sight.gyro_rad_s = buffer_.turned(t_ns - half_ns, t_ns + half_ns) / rt::to_seconds(2 * half_ns);
  if (options_.readout_ns > 0) {
    const Vec3 mean_turn = buffer_.mean_turn(t_ns, options_.readout_ns);
    see_rolling(pose, smoother_.mounting().R_body_cam, mean_turn, options_.model, &sight);
  }
  return sight;
}

void InertialOdometry::hear_aids(const VisualPose& pose) {
  AidPose p;
  p.t_ns = pose.t_ns;
  p.map_id = pose.map_id;
  p.camera = pose.T_map_cam.t;
  p.depth = pose.median_depth;
  p.points = pose.points;
  const Mat3 R_body_cam = smoother_.mounting().R_body_cam;
  p.beam = pose.T_map_cam.R * (R_body_cam.transpose() * options_.range_beam);
  if (metric() && pose.map_id == map_id_) {
    p.up = smoother_.newest().up;
    p.up_sigma = std::sqrt(smoother_.covariance().diagonal().segment<2>(S::kUp).maxCoeff());
  } else if (pose.map_id == map_id_) {
    p.up = attempt_up_;
    p.up_sigma = attempt_up_sigma_;
  }
  aids_.pose(p);
  look_who_speaks(pose.t_ns);
}

ScaleHint InertialOdometry::hint() {
  const ScaleState& told = aids_.state();
  dispute2_ = 1;
  if (!told.known()) return {};
  ScaleHint out{std::log(told.scale()), told.log_sigma()};
  if (!metric()) return out;
  // The window's own opinion, without what it took from them: beside what they had pulled it to they are never wrong.
  const double all = 1 / smoother_.covariance()(S::kScale, S::kScale);
  const double theirs = counted_.sigma > 0 ? 1 / (counted_.sigma * counted_.sigma) : 0;
  const double own = all - theirs;
  if (!(own > 1e-3 * all)) return out;  // it has none
  const double own_log_scale = (all * smoother_.newest().log_scale - theirs * counted_.log_scale) / own;
  const double off = out.log_scale - own_log_scale;
  const double off2 = off * off / (out.sigma * out.sigma + 1 / own);
  aids_off2_ = aids_speak_ ? off2 : -1;
  const bool counts = off2 <= options_.aid_limit * options_.aid_limit;
  if (!counts) ++aids_contradicted_;
  dispute2_ = counts ? std::max(1.0, off2) : 1;
  return counts ? out : ScaleHint{};
}

void InertialOdometry::begin_window(const VisualPose& pose) {
  if (metric() && prior_kept_) {
    // What the sensor is like outlives the map.
    const S& x = smoother_.newest();
    prior_.bias = x.bias;
    prior_.mounting = x.mounting;
    prior_.time_offset_s = x.time_offset_s;
    const auto sigma = [&](int i, int n, double floor) {
      return std::max(floor, 2 * std::sqrt(smoother_.covariance().diagonal().segment(i, n).maxCoeff()));
    };
    prior_.gyro_bias_sigma = std::min(prior_.gyro_bias_sigma, sigma(S::kGyroBias, 3, kKeptGyroSigma));
    prior_.accel_bias_sigma = std::min(prior_.accel_bias_sigma, sigma(S::kAccelBias, 3, 3e-2));
    begin_accel_sigma_ = std::min(begin_accel_sigma_, sigma(S::kAccelBias, 3, 3e-2));
    // Screwed on, and not turned by a map that was lost: a young map would take its own errors for it.
    prior_.mounting_sigma = std::min(prior_.mounting_sigma, sigma(S::kMounting, 3, 3e-3));
    prior_.time_sigma = std::min(prior_.time_sigma, sigma(S::kTime, 1, 5e-4));
  } else if (!prior_kept_) {
    prior_ = options_.prior;
    begin_accel_sigma_ = options_.begin_bias_margin * prior_.accel_bias_sigma;
  }
  end();
  prior_kept_ = true;
  attempt_up_.setZero();
  smoother_.clear();
  t_bridge_ns_ = 0;
  map_id_ = pose.map_id;
  InertialNode node;
  node.t_ns = measured_moment_of(pose);
  node.sight = sight_of(pose, node.t_ns);
  smoother_.add(node);
  first_vertical_ = rest_.at(node.t_ns, buffer_);
  smoother_.state(0).bias = prior_.bias;
  smoother_.state(0).mounting = prior_.mounting;
  smoother_.state(0).time_offset_s = prior_.time_offset_s;
}

bool InertialOdometry::add_node(const VisualPose& pose, rt::TimeNs after_ns) {
  const rt::TimeNs last = smoother_.node(smoother_.size() - 1).t_ns;
  InertialNode node;
  node.t_ns = measured_moment_of(pose);
  if (node.t_ns - last < after_ns) return false;
  const rt::TimeNs missing_ns = measured_since(node.t_ns, &node.since_last);
  // Readings held over the whole of it are none: the bias that they make outlives the window.
  if (missing_ns > options_.max_missing_ns || missing_ns >= node.t_ns - last || node.since_last.dt_s() <= 0) {
    refuse("inertial readings are missing [ms]", rt::to_ms(missing_ns),
           rt::to_ms(std::min(options_.max_missing_ns, node.t_ns - last)));
    begin_window(pose);
    return false;
  }
  node.sight = sight_of(pose, node.t_ns);
  while (metric() && smoother_.size() >= options_.window) smoother_.drop_oldest();
  if (smoother_.size() == InertialSmoother::kNodes) first_vertical_.go_on(smoother_.node(1).since_last);
  smoother_.add(node);
  return true;
}

bool InertialOdometry::plausible(double most_sigmas) {
  const S& x = smoother_.newest();
  const double off = std::max((x.bias.gyro - prior_.bias.gyro).norm() / prior_.gyro_bias_sigma,
                              (x.bias.accel - prior_.bias.accel).norm() / begin_accel_sigma_);
  if (!(off < most_sigmas)) return refuse("the biases would be absurd [0.1 sigma]", 10 * off, 10 * most_sigmas);
  const double turned = (x.mounting - prior_.mounting).norm() / prior_.mounting_sigma;
  if (!(turned < most_sigmas))
    return refuse("the sensor would sit far from how it is configured [0.1 sigma]", 10 * turned, 10 * most_sigmas);
  return true;
}

void InertialOdometry::stray_on() {
  const InertialNode &to = smoother_.node(smoother_.size() - 1), &from = smoother_.node(smoother_.size() - 2);
  const double stray = std::max(position_stray(from.sight, options_.model), position_stray(to.sight, options_.model));
  const double share = moving_share(from.sight, to.sight, options_.model);
  // Not while it sees nothing.
  const double seen_s = std::min(to.since_last.dt_s(), rt::to_seconds(options_.stray.age_ns));
  strayed2_ += share * share * stray * stray * seen_s;
}

MetricPose InertialOdometry::frame(const VisualPose& pose) {
  contradicted_ = false;
  rest_.picture(moment_of(pose), pose.tracked ? 0 : pose.still_rad);
  if (!pose.tracked || buffer_.empty()) return {};
  stray_.judge(pose);
  if (pose.map_moved && pose.map_id == map_id_)
    aids_.correct_map(correction_of(pose, t_last_seen_ns_, last_seen_camera_));
  last_seen_camera_ = pose.T_map_cam.t;
  t_last_seen_ns_ = pose.t_ns;
  hear_aids(pose);
  // Or where a clock was set back: the window would wait for its time to come again.
  if (smoother_.size() == 0 || pose.map_id != map_id_ || pose.t_ns < before_.t_ns) {
    before_ = pose;
    before_.points = {};
    begin_window(pose);
    return {};
  }
  if (pose.map_moved) {
    before_.T_map_cam = SE3(so3_exp(pose.turned_by) * before_.T_map_cam.R, before_.T_map_cam.t + pose.moved_by);
    smoother_.correct_map(correction_of(pose, before_.t_ns, smoother_.newest().camera));
    correct(pose, up_seen());
  }
  const bool added = add_node(too_early(pose) ? before_ : pose, metric() ? options_.node_ns : options_.begin_node_ns);
  before_ = pose;
  before_.points = {};
  if (added && !metric()) {
    try_to_begin(pose);
  } else if (added) {
    count_on(hint());
    // One step: all moments but the newest are where the solution before left them, and that one where readings led. A
    // second moved nothing that is measured (docs/inertial-design.md#one-step-a-moment) and cost as much again.
    const auto report = smoother_.solve(1);
    const double sigma = std::sqrt(smoother_.covariance()(S::kScale, S::kScale));
    if (!report.ok || !(sigma < options_.lost_scale_sigma)) {
      refuse("the scale was lost: its sigma [0.1 %]", 1e3 * sigma, 1e3 * options_.lost_scale_sigma);
      begin_window(pose);
    } else if (!plausible(options_.most_sigmas)) {
      // What vision and sensor disagree about has gone where it could go: nothing of this window can be believed.
      prior_kept_ = false;
      contradicted_ = true;
      begin_window(pose);
    } else {
      anchor_.level(up_seen());
      stray_on();
    }
  }
  return metric() ? tell(pose) : MetricPose{};
}

bool InertialOdometry::in_map(const SE3& T_nav_cam, SE3* T_map_cam, std::uint32_t* map_id) const {
  if (!told()) return false;
  *map_id = map_id_;
  *T_map_cam = anchor_.in_map(T_nav_cam, smoother_.newest().scale());
  return true;
}

Mat3 InertialOdometry::R_seen_map() const {
  const S& x = smoother_.newest();
  const Mat3 R_map_cam = x.R_map_body * smoother_.mounting().R_body_cam * so3_exp(x.mounting);
  // What the picture alone is off by is not the map's.
  return so3_exp(x.picture.head<3>()) * smoother_.node(smoother_.size() - 1).sight.R_map_cam * R_map_cam.transpose();
}

Eigen::Matrix<double, 3, S::kSize> InertialOdometry::shared_by_window() const {
  const S& x = smoother_.newest();
  const Mat3 R_nav_window = anchor_.R_nav_map() * R_seen_map();
  // The camera's vertical is R_cam_body R_body_map up, and the map turns back by as much as it errs.
  const auto turned = [&](const auto& d_up) {
    return (-R_nav_window * skew(x.up) * d_up).template topRows<2>().eval();
  };
  const Mat3 R_map_cam = x.R_map_body * smoother_.mounting().R_body_cam * so3_exp(x.mounting);
  Eigen::Matrix<double, 3, S::kSize> J = Eigen::Matrix<double, 3, S::kSize>::Zero();
  J(0, S::kScale) = 1;
  J.block<2, 3>(1, S::kRotation) = turned(skew(x.up) * x.R_map_body);
  J.block<2, 2>(1, S::kUp) = turned(x.up_basis());
  J.block<2, 3>(1, S::kMounting) = turned(skew(x.up) * R_map_cam * so3_right_jacobian(x.mounting));
  return J;
}

MetricPose InertialOdometry::tell(const VisualPose& pose) {
  const S& x = smoother_.newest();
  const Eigen::Matrix<double, 3, S::kSize> J = shared_by_window();
  const Eigen::Matrix<double, 3, S::kSize> JC = J.lazyProduct(smoother_.covariance());
  Mat3 shared = doubt2() * JC.lazyProduct(J.transpose());
  shared(0, 0) += options_.told_scale_sigma * options_.told_scale_sigma;
  MetricPose out = pose_in_frame(pose, x.scale(), shared, strayed2_);
  const double place =
      std::hypot(options_.model.position_sigma * x.scale() * pose.median_depth, options_.told_place_sigma_m);
  out.covariance.diagonal().head<3>().array() += place * place;
  out.covariance.diagonal().tail<3>().array() += options_.told_turn_sigma_rad * options_.told_turn_sigma_rad;
  tell_velocity(pose, &out);
  return out;
}

void InertialOdometry::tell_velocity(const VisualPose& pose, MetricPose* out) const {
  const S& x = smoother_.newest();
  const Mat3 R_nav_map = anchor_.R_nav_map() * R_seen_map();
  // That of the newest moment, carried on to this frame.
  const rt::TimeNs t_node = smoother_.node(smoother_.size() - 1).t_ns;
  Preintegration d(x.bias);
  const rt::TimeNs t_ns = std::max(t_node, moment_of(pose));
  const auto covered = buffer_.integrate(t_node, t_ns, options_.model.imu, &d);
  const Vec3 omega = sight_of(pose, t_ns).gyro_rad_s - x.bias.gyro;
  const Vec3 body = x.velocity - options_.model.gravity_m_s2 * d.dt_s() * x.up + x.R_map_body * d.dv(x.bias);
  const Mat3 R_map_body = x.R_map_body * d.dR(x.bias.gyro);
  out->velocity_m_s = R_nav_map * (body + R_map_body * omega.cross(smoother_.mounting().t_body_cam_m));
  Mat3 C = smoother_.covariance().block<3, 3>(S::kVelocity, S::kVelocity);
  // What came since is for the next window to weigh, but for what was not measured.
  if (covered.saturated()) C += x.R_map_body * d.covariance().block<3, 3>(3, 3) * x.R_map_body.transpose();
  const double scale_variance = options_.told_scale_sigma * options_.told_scale_sigma;
  out->velocity_covariance = doubt2() * R_nav_map * C * R_nav_map.transpose() +
                             scale_variance * out->velocity_m_s * out->velocity_m_s.transpose();
  out->velocity_covariance.diagonal().array() += options_.told_speed_sigma_m_s * options_.told_speed_sigma_m_s;
}

}  // namespace godwit::vo
