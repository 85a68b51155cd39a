#include "firmware_app/pipeline/inertial_poses.h"

#include <Eigen/Geometry>
#include <cmath>

#include "firmware_app/pipeline/inertial_options.h"

namespace godwit::app {
namespace {

/// What the gyroscope's turn over a frame is taken to be wrong by. Measured against vision's on euroc_mh01: 0.3 to 0.5
/// mrad RMS, but 3 mrad for a while where mounting and time offset had not settled; with 1 and with 3 mrad the start at
/// frame 135 lost its pose there, with 5 none did.
constexpr double kTurnSigmaRad = 5e-3;

constexpr std::array<vo::ScaleSource, hal::kAidKinds> kSources = {vo::ScaleSource::kRange, vo::ScaleSource::kBarometer,
                                                                  vo::ScaleSource::kSatellites};

/// The same as who checks.
constexpr std::array<vo::CheckedBy, hal::kAidKinds> kCheckedBy = {vo::CheckedBy::kRange, vo::CheckedBy::kBarometer,
                                                                  vo::CheckedBy::kSatellites};

/// What is known of the scale beside the inertial sensor is mostly this one's.
std::size_t most_heard(const vo::ScaleState& aided) {
  std::size_t most = 0;
  for (std::size_t i = 1; i < kSources.size(); ++i) {
    if (aided.share(kSources[i]) > aided.share(kSources[most])) most = i;
  }
  return most;
}

/// All of vision's numbers that are used are numbers.
bool finite(const vo::FrameResult& r) {
  return r.T_world_cam.R.allFinite() && r.T_world_cam.t.allFinite() && r.covariance.allFinite() &&
         r.own_covariance.allFinite() && r.relative.covariance.allFinite() && std::isfinite(r.median_depth) &&
         r.moved_by.allFinite() && r.turned_by.allFinite();
}

vo::CameraMounting mounting_of(const std::array<double, 16>& T) {
  vo::CameraMounting out;
  for (std::size_t row = 0; row < 3; ++row) {
    for (std::size_t column = 0; column < 3; ++column) {
      out.R_body_cam(static_cast<int>(row), static_cast<int>(column)) = T[4 * row + column];
    }
    out.t_body_cam_m[static_cast<int>(row)] = T[4 * row + 3];
  }
  // A file's digits are no rotation to the last bit.
  out.R_body_cam = Eigen::Quaterniond(out.R_body_cam).normalized().toRotationMatrix();
  return out;
}

/// What the smoother knows of the sensor goes with the pose, so that dead reckoning begins with it.
vo::MetricMoment moment_of(const vo::InertialOdometry& odometry, const vo::MetricPose& pose) {
  using S = vo::InertialState;
  vo::MetricMoment m;
  m.child_id = odometry.begun();
  m.T_child_cam = pose.T_nav_cam;
  m.velocity_m_s = pose.velocity_m_s;
  m.covariance = pose.covariance;
  m.velocity_covariance = pose.velocity_covariance;
  m.moved_by_m = pose.moved_by_m;
  m.turned_by_rad = pose.turned_by_rad;
  const S& x = odometry.smoother().newest();
  const auto variances = odometry.smoother().covariance().diagonal();
  m.bias = x.bias;
  m.gyro_bias_sigma = std::sqrt(variances.segment<3>(S::kGyroBias).maxCoeff());
  m.accel_bias_sigma = std::sqrt(variances.segment<3>(S::kAccelBias).maxCoeff());
  m.R_body_cam = odometry.smoother().mounting().R_body_cam * vo::so3_exp(x.mounting);
  m.time_offset_s = x.time_offset_s;
  return m;
}

}  // namespace

InertialPoses::InertialPoses(const std::array<double, 16>& T_body_cam, rt::TimeNs coast_ns, double time_offset_s,
                             const hal::ImuErrorModel& errors)
    : odometry_(std::make_unique<vo::InertialOdometry>(mounting_of(T_body_cam), inertial_options(errors))),
      navigation_(std::make_unique<vo::NavigationFrame>(mounting_of(T_body_cam).t_body_cam_m,
                                                        navigation_options(errors, coast_ns))),
      coast_ns_(coast_ns),
      shift_ns_(static_cast<rt::TimeNs>(std::llround(time_offset_s * 1e9))) {}

void InertialPoses::take(const hal::ImuSample& s) {
  if (!hal::possible(s)) return;
  const vo::ImuReading reading{s.t_ns, Eigen::Vector3d(s.gyro_rad_s.data()), Eigen::Vector3d(s.accel_m_s2.data())};
  odometry_->add(reading);
  navigation_->add(reading);
}

void InertialPoses::take(const hal::AidSample& s) {
  odometry_->take(vo::AidReading{kSources[static_cast<std::size_t>(s.kind)], s.t_ns + shift_ns_,
                                 Eigen::Vector3d(s.value_m.data()), s.sigma_m});
}

vo::RotationPrior InertialPoses::turn_since_last(rt::TimeNs t_ns) const {
  vo::RotationPrior prior;
  if (t_last_ns_ > 0 && odometry_->camera_turn(t_last_ns_, t_ns + shift_ns_, &prior.R_cur_ref))
    prior.sigma_rad = kTurnSigmaRad;
  return prior;
}

vo::PosePrior InertialPoses::expected(rt::TimeNs t_ns) const {
  vo::PosePrior prior;
  vo::NavigationFrame::Expected there;
  vo::SE3 T_map_cam;
  prior.known = !last_seen_ && navigation_->expected(t_ns + shift_ns_, &there) &&
                odometry_->in_map(there.T_child_cam, &T_map_cam, &prior.map_id);
  if (!prior.known) return prior;
  prior.T_cam_map = T_map_cam.inverse();
  prior.place_sigma = there.place_sigma_m / odometry_->smoother().newest().scale();
  prior.turn_sigma_rad = there.turn_sigma_rad;
  return prior;
}

void InertialPoses::make_metric(const vo::FrameResult& result, rt::TimeNs t_ns, FrameRecord* record) {
  // Nothing was measured, and what was told stands.
  if (result.repeated) return;
  t_ns += shift_ns_;
  t_last_ns_ = t_ns;
  vo::VisualPose seen;
  seen.t_ns = t_ns;
  seen.tracked = last_seen_ = result.tracked && finite(result);
  seen.map_id = result.map_id;
  seen.T_map_cam = result.T_world_cam;
  seen.covariance = result.covariance;
  seen.own_covariance = result.own_covariance;
  seen.relative_covariance = result.relative.covariance;
  if (result.relative.keyframe_id != 0) seen.relative_age_ns = t_ns - shift_ns_ - result.relative.t_keyframe_ns;
  seen.median_depth = result.median_depth;
  seen.points = std::span(result.points.at).first(result.points.count);
  seen.map_moved = result.map_moved;
  seen.moved_by = result.moved_by;
  seen.turned_by = result.turned_by;
  const vo::MetricPose metric = odometry_->frame(seen);
  if (metric.valid && odometry_->aids_off2() >= 0)
    navigation_->contradicted(kCheckedBy[most_heard(odometry_->aided_scale())], odometry_->aids_off2(), t_ns);
  vo::MetricMoment moment;
  if (metric.valid) moment = moment_of(*odometry_, metric);
  const vo::NavigationPose pose = navigation_->frame(t_ns, metric.valid ? &moment : nullptr);
  using Source = vo::NavigationPose::Source;
  if (pose.source == Source::kSeen) {
    tell_sensor(metric.log_scale_sigma);
    fill(pose, record);
    if (pose.why[0] != '\0')
      record->reason.assign_measured(pose.why, measured_figure(pose.value), measured_figure(pose.limit));
    return;
  }
  const bool seen_without_metres = record->has_pose;
  record->tracked = record->has_pose = false;
  if (pose.source == Source::kCoasted) {
    fill(pose, record);
    record->has_pose = true;
    record->state = vo::State::kCoasting;
    record->why = {"by the inertial sensor alone [ms]", static_cast<std::int32_t>(pose.unseen_ns / rt::kNsPerMs),
                   static_cast<std::int32_t>(coast_ns_ / rt::kNsPerMs)};
    record->reason.assign_measured(record->why.text, record->why.value, record->why.limit);
  } else if (seen_without_metres) {
    record->state = vo::State::kInitialising;
    const auto& why = odometry_->refusal();
    const char* const text = why.text[0] != '\0' ? why.text : "waiting for motion that shows scale and vertical";
    // In thousandths: a reason's figures are whole numbers.
    record->why = {text, measured_figure(1000 * why.value), measured_figure(1000 * why.limit)};
    record->reason.assign_measured(text, record->why.value, record->why.limit);
  }
}

void InertialPoses::tell_sensor(double log_scale_sigma) {
  const vo::InertialState& x = odometry_->smoother().newest();
  sensor_.log_scale_sigma = log_scale_sigma;
  Eigen::Map<Eigen::Vector3d>(sensor_.gyro_bias.data()) = x.bias.gyro;
  Eigen::Map<Eigen::Vector3d>(sensor_.accel_bias.data()) = x.bias.accel;
  Eigen::Map<Eigen::Vector3d>(sensor_.mounting.data()) = x.mounting;
  const vo::ScaleState& aided = odometry_->aided_scale();
  sensor_.aided_log_sigma = aided.known() ? aided.log_sigma() : 0;
  for (std::size_t i = 0; i < kSources.size(); ++i) sensor_.aid_share[i] = aided.share(kSources[i]);
  sensor_.time_offset_s = rt::to_seconds(shift_ns_) + x.time_offset_s;
}

void InertialPoses::fill(const vo::NavigationPose& pose, FrameRecord* record) const {
  record->metric = true;
  record->inertial = sensor_;
  record->frame_id = pose.frame_id;
  record->trust = pose.trust;
  record->motion = navigation_->motion();
  const Eigen::Quaterniond q = pose.T_nav_cam.quaternion();
  record->q_world_cam = {q.x(), q.y(), q.z(), q.w()};
  Eigen::Map<Eigen::Vector3d>(record->t_world_cam.data()) = pose.T_nav_cam.t;
  Eigen::Map<Eigen::Vector3d>(record->velocity.data()) = pose.velocity_m_s;
  Eigen::Map<Eigen::Vector3d>(record->moved_by.data()) = pose.moved_by_m;
  Eigen::Map<Eigen::Vector3d>(record->turned_by.data()) = pose.turned_by_rad;
  record->map_moved = pose.moved_by_m.squaredNorm() + pose.turned_by_rad.squaredNorm() > 0;
  // The record's covariance is along the camera's axes (see autopilot/pose_sampler.cpp).
  vo::Mat6 to_cam = vo::Mat6::Zero();
  to_cam.topLeftCorner<3, 3>() = to_cam.bottomRightCorner<3, 3>() = pose.T_nav_cam.R.transpose();
  const vo::Mat6 C = to_cam * pose.covariance * to_cam.transpose();
  std::size_t k = 0, v = 0;
  for (int row = 0; row < 6; ++row) {
    for (int column = row; column < 6; ++column) record->covariance[k++] = C(row, column);
    for (int column = row; column < 3; ++column)
      record->velocity_covariance[v++] = pose.velocity_covariance(row, column);
  }
}

}  // namespace godwit::app
