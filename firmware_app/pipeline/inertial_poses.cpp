#include "firmware_app/pipeline/inertial_poses.h"

#include <Eigen/Geometry>
#include <cmath>

#include "firmware_app/link/imu_reading.h"
#include "firmware_app/pipeline/inertial_options.h"
#include "firmware_app/pipeline/metric_record.h"

namespace godwit::app {
namespace {

/// What the gyroscope's turn over a frame is taken to be wrong by. Measured against vision's on euroc_mh01: 0.3 to 0.5
/// mrad RMS, but 3 mrad for a while where mounting and time offset had not settled; with 1 and with 3 mrad the start at
/// frame 135 lost its pose there, with 5 none did.
constexpr double kTurnSigmaRad = 5e-3;

/// Who tells lengths as one who checks, by vo::ScaleSource.
constexpr std::array<vo::CheckedBy, hal::kLengthKinds> kCheckedBy = {vo::CheckedBy::kRange, vo::CheckedBy::kBarometer,
                                                                     vo::CheckedBy::kSatellites};

/// What is known of the scale beside the inertial sensor is mostly this one's.
std::size_t most_heard(const vo::ScaleState& aided) {
  std::size_t most = 0;
  for (std::size_t i = 1; i < kCheckedBy.size(); ++i) {
    const auto share = [&](std::size_t k) { return aided.share(static_cast<vo::ScaleSource>(k)); };
    if (share(i) > share(most)) most = i;
  }
  return most;
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
  m.map_moved_by_m = pose.map_moved_by_m;
  m.map_turned_by_rad = pose.map_turned_by_rad;
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
                             const hal::ImuErrorModel& errors, rt::TimeNs readout_ns)
    : odometry_(std::make_unique<vo::InertialOdometry>(mounting_of(T_body_cam), inertial_options(errors, readout_ns))),
      navigation_(std::make_unique<vo::NavigationFrame>(mounting_of(T_body_cam).t_body_cam_m,
                                                        navigation_options(errors, coast_ns))),
      coast_ns_(coast_ns),
      shift_ns_(static_cast<rt::TimeNs>(std::llround(time_offset_s * 1e9))) {}

void InertialPoses::take(const hal::ImuSample& s) {
  if (!hal::possible(s)) return;
  const vo::ImuReading reading = link::imu_reading(s, pace_.lay(s.t_ns));
  odometry_->add(reading);
  navigation_->add(reading);
}

void InertialPoses::take(const hal::AidSample& s) {
  // The vertical is this sensor's own.
  if (s.kind == hal::AidKind::kAttitude) return;
  odometry_->take(reading_of(s, shift_ns_));
}

void InertialPoses::starts_at_height(double height_m) {
  odometry_->take(start_reading(height_m));
}

vo::RotationPrior InertialPoses::turn_since_last(rt::TimeNs t_ns) const {
  vo::RotationPrior prior;
  if (t_last_ns_ > 0 && odometry_->camera_turn(t_last_ns_, t_ns + shift_ns_, &prior.R_cur_ref))
    prior.sigma_rad = kTurnSigmaRad;
  return prior;
}

vo::MeasuredShake InertialPoses::shake(rt::TimeNs t_ns) const {
  vo::MeasuredShake out;
  out.t_ns = t_ns;
  out.known = t_last_ns_ > 0 && odometry_->row_turns(t_last_ns_, t_ns + shift_ns_, &out.turn, &out.rate);
  return out;
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
  const vo::VisualPose seen = visual_pose(result, t_ns - shift_ns_, t_ns);
  last_seen_ = seen.tracked;
  const vo::MetricPose metric = odometry_->frame(seen);
  if (metric.valid && odometry_->aids_off2() >= 0)
    navigation_->contradicted(kCheckedBy[most_heard(odometry_->aided_scale())], odometry_->aids_off2(), t_ns);
  // Dead reckoning would go on from what has just been found wrong.
  if (odometry_->contradicted())
    navigation_->break_frame(odometry_->refusal().text, odometry_->refusal().value, odometry_->refusal().limit);
  vo::MetricMoment moment;
  if (metric.valid) moment = moment_of(*odometry_, metric);
  const vo::NavigationPose pose = navigation_->frame(t_ns, metric.valid ? &moment : nullptr);
  using Source = vo::NavigationPose::Source;
  if (pose.source == Source::kSeen) {
    tell_sensor(metric.log_scale_sigma);
    fill(pose, record);
    if (pose.why[0] != '\0') {
      record->why = {pose.why, measured_figure(pose.value), measured_figure(pose.limit)};
      record->reason.assign_measured(record->why.text, record->why.value, record->why.limit);
    }
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
    const auto& why = odometry_->refusal();
    const char* const text = why.text[0] != '\0' ? why.text : "waiting for motion that shows scale and vertical";
    tell_unmetric(text, why.value, why.limit, record);
  }
}

void InertialPoses::tell_sensor(double log_scale_sigma) {
  const vo::InertialState& x = odometry_->smoother().newest();
  sensor_.log_scale_sigma = log_scale_sigma;
  Eigen::Map<Eigen::Vector3d>(sensor_.gyro_bias.data()) = x.bias.gyro;
  Eigen::Map<Eigen::Vector3d>(sensor_.accel_bias.data()) = x.bias.accel;
  Eigen::Map<Eigen::Vector3d>(sensor_.mounting.data()) = x.mounting;
  tell_shares(odometry_->aided_scale(), &sensor_);
  sensor_.time_offset_s = rt::to_seconds(shift_ns_) + x.time_offset_s;
}

void InertialPoses::fill(const vo::NavigationPose& pose, FrameRecord* record) const {
  fill_metric(pose, record);
  record->inertial = sensor_;
  record->motion = navigation_->motion();
}

}  // namespace godwit::app
