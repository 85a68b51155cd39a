#include "firmware_app/link/link_node.h"

#include <Eigen/LU>
#include <algorithm>
#include <cstdio>

#include "firmware_app/link/dronecan/types.h"

namespace godwit::link {
namespace {

using dronecan::NodeCondition;
using dronecan::NodeHealth;
using dronecan::NodeMode;

// ArduPilot drops samples that arrive within 20 ms of the one before.
constexpr rt::TimeNs kMinOdometryGapNs = 21 * rt::kNsPerMs;
constexpr rt::TimeNs kLatestPoseNs = 250 * rt::kNsPerMs;
constexpr rt::TimeNs kMinTextGapNs = 500 * rt::kNsPerMs;
constexpr rt::TimeNs kLatencyTextPeriodNs = 60 * rt::kNsPerSecond;
constexpr std::uint8_t kResetReserve = 8;
constexpr double kTimesyncBits = 4 * 135;  // a TIMESYNC of 28 bytes through the tunnel
constexpr double kTimesyncBytes = 28;
constexpr double kPoseBytes = 245;

std::vector<dronecan::TypeInfo> accepted_types() {
  std::vector<dronecan::TypeInfo> types = dronecan::Node::accepted_types();
  types.insert(types.end(), {dronecan::TunnelTargetted::kType, dronecan::RangeMeasurement::kType,
                             dronecan::StaticPressure::kType, dronecan::RawImu::kType, dronecan::ArmingStatus::kType,
                             dronecan::GlobalTimeSync::kType, dronecan::NodeStatus::kType});
  return types;
}

const char* state_text(PoseState state) {
  switch (state) {
    case PoseState::kInitialising:
      return "initialising";
    case PoseState::kTracking:
      return "tracking";
    case PoseState::kCoasting:
      return "coasting on inertial data";
    case PoseState::kRelocalising:
      return "relocalising, no pose";
    case PoseState::kLost:
      return "lost, no pose";
  }
  return "unknown";
}

}  // namespace

rt::Result<std::unique_ptr<LinkNode>> LinkNode::create(const LinkConfig& config, const LinkPorts& ports,
                                                       const StoredState& stored) {
  if (ports.bus == nullptr && ports.bytes == nullptr)
    return rt::Error{"link: neither a CAN bus nor a MAVLink port is given"};
  if (ports.storage == nullptr || ports.poses == nullptr || ports.health == nullptr) {
    return rt::Error{"link: storage, poses and health must be given"};
  }
  const Eigen::Matrix3d& R = config.odometry.R_body_cam;
  if (!R.allFinite() || !config.odometry.t_body_cam.allFinite() ||
      (R * R.transpose() - Eigen::Matrix3d::Identity()).norm() > 1e-6 || R.determinant() < 0) {
    return rt::Error{"link: T_body_cam must hold a rotation (right-handed, orthonormal) and a finite translation"};
  }
  std::unique_ptr<LinkNode> link(new LinkNode(config, ports, stored));
  if (ports.bytes == nullptr && link->config_.odometry.profile == Profile::kPx4) {
    return rt::Error{"link: PX4 takes no MAVLink through CAN: give it a MAVLink port (udp: or serial:)"};
  }
  const bool wants_fd =
      link->parameters_.get(Parameter::kCanFd) != 0 || link->parameters_.get(Parameter::kTelemetryFd) != 0;
  if (ports.bus != nullptr && wants_fd && !ports.bus->supports_fd()) {
    return rt::Error{"link: CAN FD is asked for (VIO_CANFD or VIO_TEL_FD), but the interface is not set to it"};
  }
  return link;
}

LinkNode::LinkNode(const LinkConfig& config, const LinkPorts& ports, const StoredState& stored)
    : config_(config),
      ports_(ports),
      parameters_(config.parameters, stored.has_parameters ? stored.parameters : config.parameters),
      queue_(config.fd_data_rate_factor),
      reassembler_(accepted_types()),
      node_(config.identity, parameters_.get(Parameter::kCanFd) != 0, &parameters_, ports.storage, &queue_,
            config.write_rules),
      carrier_(this),
      endpoint_(
          [&] {
            mavlink::EndpointConfig endpoint = config.mavlink;
            endpoint.system = static_cast<std::uint8_t>(parameters_.get(Parameter::kSystemId));
            return endpoint;
          }(),
          &carrier_, ports.inputs),
      body_(body_pose(PoseSample{}, config.odometry)),
      reset_counter_(stored.reset_counter),
      reset_reserved_(stored.reset_counter) {
  config_.odometry.profile = static_cast<Profile>(parameters_.get(Parameter::kProfile));
  reassembler_.protect_source(static_cast<std::uint8_t>(parameters_.get(Parameter::kAutopilotNode)));
  set_bus_filters();
}

// Poses leave in step with VIO_RATE: one is due when its capture time has come within a quarter period of the plan, so
// that a camera of the same rate loses none to jitter, and a faster one is thinned evenly.
bool LinkNode::pose_is_due(const PoseSample& sample) {
  const rt::TimeNs period = rt::kNsPerSecond / parameters_.get(Parameter::kRate);
  if (sample.t_capture_ns < t_next_due_ns_ - period / 4) return false;
  t_next_due_ns_ += period;
  // After a gap the plan begins anew.
  if (sample.t_capture_ns - t_next_due_ns_ > 0) t_next_due_ns_ = sample.t_capture_ns + period;
  return true;
}

void LinkNode::send_pose(const BodyPose& pose, rt::TimeNs t_capture_ns, rt::TimeNs t_published_ns, rt::TimeNs now_ns) {
  last_carried_ = 0;
  if (t_capture_ns / 1000 <= t_last_stamp_ns_ / 1000) {
    ++status_.poses_stale;
    return;
  }
  if (!endpoint_.send_odometry(odometry_message(pose, config_.odometry, t_capture_ns, reset_counter_), now_ns)) return;
  ++status_.odometry_sent;
  hold_.sent();
  t_last_odometry_ns_ = now_ns;
  t_last_stamp_ns_ = t_capture_ns;
  sample_sent_ = {t_capture_ns, t_published_ns, pose.quality};
  pose_under_way_ = true;
  pose_number_ = last_carried_;
}

void LinkNode::take_pose(rt::TimeNs now_ns) {
  if (endpoint_.t_attitude_ns() != 0) {
    const mavlink::AttitudeQuaternion& a = endpoint_.attitude();
    hold_.heard_attitude({a.q1, a.q2, a.q3, a.q4}, endpoint_.t_attitude_ns());
  }
  PoseSample sample;
  if (ports_.poses->read(&sample)) {
    const bool late = sample.t_capture_ns <= sample_.t_capture_ns && any_pose_;
    const bool old = now_ns - sample.t_capture_ns > config_.max_pose_age_ns;
    bad_pose_ = sample.t_capture_ns > now_ns;
    if (late || old || bad_pose_) {
      ++status_.poses_stale;  // not taken: if nothing better comes, the watch below says so
    } else {
      sample_ = sample;
      any_pose_ = true;
      t_last_pose_ns_ = now_ns;
      const BodyPose pose = body_pose(sample, config_.odometry);
      const std::uint8_t steps = hold_.take(pose, sample.map_id, sample.reset_counter, now_ns);
      reset_counter_ = static_cast<std::uint8_t>(reset_counter_ + steps);
      body_ = hold_.pose();
      const bool claims_pose = sample.state == PoseState::kTracking || sample.state == PoseState::kCoasting;
      const bool known = sample.has_gravity || config_.odometry.bench_metric;
      bad_pose_ = claims_pose && known && !pose.attitude_known;
      // A pose that fails is told at once, whatever the plan says.
      const bool failed = body_.quality < 0 && status_.quality >= 0;
      const bool due = pose_is_due(sample) || failed;
      if (!due || pose_waits_) ++status_.poses_paced;
      pose_waits_ = pose_waits_ || due;
      status_.quality = body_.quality;
    }
  }
  // Poses that come bunched after a delay leave as far apart as the autopilot takes them, always the newest.
  if (pose_waits_ && now_ns - t_last_odometry_ns_ >= kMinOdometryGapNs) {
    pose_waits_ = false;
    send_pose(body_, sample_.t_capture_ns, sample_.t_published_ns, now_ns);
  }
  if (!any_pose_ || !stalled(now_ns)) return;
  // Camera or odometry fell silent: say so at the usual rate; the last position is told as no pose.
  sample_.state = PoseState::kLost;
  pose_waits_ = false;
  hold_.lose(now_ns);
  body_ = hold_.pose();
  status_.quality = -1;
  const rt::TimeNs period = rt::kNsPerSecond / parameters_.get(Parameter::kRate);
  if (now_ns - t_last_odometry_ns_ < period) return;
  // Stamped so that a pose which comes after all is later still: times only grow.
  send_pose(body_, std::max(t_last_stamp_ns_ + rt::kNsPerMs, now_ns - kLatestPoseNs), 0, now_ns);
}

void LinkNode::send_telemetry(rt::TimeNs now_ns) {
  const std::int64_t rate = parameters_.get(Parameter::kTelemetryRate);
  if (ports_.bus == nullptr || rate == 0 || !any_pose_ || now_ns < t_next_telemetry_ns_) return;
  t_next_telemetry_ns_ = now_ns + rt::kNsPerSecond / rate;
  TelemetrySnapshot snapshot;
  snapshot.state = sample_.state;
  snapshot.has_scale = sample_.has_scale;
  snapshot.has_gravity = sample_.has_gravity;
  snapshot.reset_counter = reset_counter_;
  snapshot.map_id = static_cast<std::uint16_t>(sample_.map_id);
  snapshot.t_capture_ns = sample_.t_capture_ns;
  snapshot.age_ns = now_ns - sample_.t_capture_ns;
  snapshot.temperature_c = health_.temperature_c;
  snapshot.pose = body_;
  const auto base = static_cast<std::uint32_t>(parameters_.get(Parameter::kTelemetryBase));
  if (!queue_.begin(TxClass::kService, now_ns)) return;
  ++telemetry_sequence_;
  if (parameters_.get(Parameter::kTelemetryFd) != 0) {
    queue_.add_raw(telemetry_fd_frame(snapshot, telemetry_sequence_, base));
  } else {
    for (const hal::CanFrame& frame : telemetry_frames(snapshot, telemetry_sequence_, base)) queue_.add_raw(frame);
  }
  queue_.commit();
}

void LinkNode::say(mavlink::StatusText::Severity severity, std::string_view text, rt::TimeNs now_ns) {
  endpoint_.send_text(severity, text, now_ns);
  using Text = mavlink::StatusText;
  using Log = dronecan::LogMessage;
  const auto level = severity <= Text::kError ? Log::kError : severity == Text::kWarning ? Log::kWarning : Log::kInfo;
  node_.log(level, text, now_ns);
}

void LinkNode::tell_state(rt::TimeNs now_ns) {
  const bool metric = body_.quality > 0;
  if (!any_pose_ || (sample_.state == told_state_ && metric == told_metric_) || now_ns - t_told_ns_ < kMinTextGapNs) {
    return;
  }
  told_state_ = sample_.state;
  told_metric_ = metric;
  t_told_ns_ = now_ns;
  const bool has_pose = sample_.state == PoseState::kTracking || sample_.state == PoseState::kCoasting;
  std::array<char, 51> text{};
  std::snprintf(text.data(), text.size(), "VIO: %s%s",
                stalled(now_ns) ? "no picture, no pose" : state_text(sample_.state),
                has_pose && !metric ? ", no scale yet" : "");
  say(metric ? mavlink::StatusText::kInfo : mavlink::StatusText::kWarning, text.data(), now_ns);
}

NodeCondition LinkNode::condition(rt::TimeNs now_ns) const {
  NodeCondition c;
  const auto set = [&c](Reason reason, bool on) {
    c.reasons = static_cast<std::uint16_t>(c.reasons | (on ? reason : 0));
  };
  const bool stall = stalled(now_ns);
  const bool has_pose = !stall && (sample_.state == PoseState::kTracking || sample_.state == PoseState::kCoasting);
  const bool bench = config_.odometry.bench_metric;
  set(kCameraFailed, !health_.camera_ok);
  set(kImuFailed, !health_.imu_ok);
  const bool all_live = config_.heartbeats == nullptr || config_.heartbeats->silent(now_ns).name == nullptr;
  set(kProcessFailed, !health_.process_ok || !all_live);
  set(kPoseStalled, stall);
  set(kNoPose, !has_pose);
  set(kNoScale, !sample_.has_scale && !bench);
  set(kNoGravity, !sample_.has_gravity && !bench);
  set(kTooHot, health_.temperature_c > config_.max_temperature_c);
  set(kLatencyGrew, status_.latency.grew);
  set(kBusTrouble, bus_trouble_);
  set(kNoAutopilot, !endpoint_.autopilot_alive(now_ns));
  set(kNoTimesync, !endpoint_.time_sync().synchronised(now_ns));
  set(kDetectorFailed, !health_.detector_ok);
  set(kBadPose, bad_pose_);
  set(kSameNodeId, status_.own_id_heard);
  // Camera, inertial sensor and process make the health; whether there is a pose is told by state and quality, and
  // enters here only where the user wants arming to wait for one.
  const bool failed = (c.reasons & (kCameraFailed | kProcessFailed | kPoseStalled | kBadPose | kSameNodeId)) != 0 ||
                      (config_.imu_required && !health_.imu_ok);
  const bool wants_pose = parameters_.get(Parameter::kRequirePose) != 0 && !armed(now_ns) && body_.quality < 0;
  const bool warned = wants_pose || (c.reasons & kTooHot) != 0;
  c.health = failed ? NodeHealth::kError : warned ? NodeHealth::kWarning : NodeHealth::kOk;
  c.mode = any_pose_ || failed ? NodeMode::kOperational : NodeMode::kInitialization;
  return c;
}

void LinkNode::account_sent_pose(rt::TimeNs now_ns) {
  const bool by_bytes = ports_.bytes != nullptr;
  if (!pose_under_way_ || (!by_bytes && queue_.last_pose_sent() != pose_number_)) return;
  pose_under_way_ = false;
  const rt::TimeNs sent_ns = config_.clock != nullptr ? config_.clock() : now_ns;
  if (sample_sent_.t_published_ns != 0) {
    own_time_.add(sent_ns - sample_sent_.t_published_ns);
    if (ports_.departures != nullptr) ports_.departures->try_push({sample_sent_.t_capture_ns, sent_ns});
  }
  if (sample_sent_.quality <= 0) return;
  LatencyPath path;
  const TimeSync& sync = endpoint_.time_sync();
  if (sync.synchronised(now_ns)) path.one_way_ns = sync.round_trip_ns() / 2;
  const std::uint32_t bit_rate = ports_.bus != nullptr ? ports_.bus->bit_rate() : 0;
  if (by_bytes && ports_.bytes->baud_rate() > 0) {
    // Half a round trip holds a TIMESYNC's way along the line; a pose is longer.
    path.wire_extra_ns = static_cast<rt::TimeNs>((kPoseBytes - kTimesyncBytes) * 10 / ports_.bytes->baud_rate() * 1e9);
  }
  if (!by_bytes) {
    if (bit_rate > 0) {
      path.wire_extra_ns =
          static_cast<rt::TimeNs>(std::max(0.0, queue_.last_pose_bits() - kTimesyncBits) / bit_rate * 1e9);
    }
    const auto baud = static_cast<double>(parameters_.get(Parameter::kBaudRate));
    path.serial_correction_ns = static_cast<rt::TimeNs>(kPoseBytes * 10 / baud * 1e9);
  }
  latency_.add(sample_sent_.t_capture_ns, sent_ns, path);
}

void LinkNode::tell_latency(rt::TimeNs now_ns) {
  const LatencySummary& l = status_.latency;
  const bool growth = l.grew && !told_growth_;
  const bool due = l.samples >= LatencyMonitor::kMinSamples && now_ns >= t_next_latency_text_ns_ &&
                   endpoint_.time_sync().synchronised(now_ns);
  if (!growth && !due) return;
  told_growth_ = l.grew;
  t_next_latency_text_ns_ = now_ns + kLatencyTextPeriodNs;
  std::array<char, 51> text{};
  std::snprintf(text.data(), text.size(), "VIO %s p50 %d p99 %d ms, VISO_DELAY_MS %d",
                growth ? "LATENCY GREW" : "latency", static_cast<int>(l.p50_ms), static_cast<int>(l.p99_ms),
                l.viso_delay_ms);
  say(growth ? mavlink::StatusText::kWarning : mavlink::StatusText::kInfo, text.data(), now_ns);
}

void LinkNode::each_second(rt::TimeNs now_ns) {
  if (now_ns < t_next_second_ns_) return;
  t_next_second_ns_ = now_ns + rt::kNsPerSecond;
  status_.latency = latency_.summary();
  own_time_.sort();
  status_.own_samples = own_time_.size();
  status_.own_p50_ms = own_time_.share_ms(0.5);
  status_.own_p99_ms = own_time_.share_ms(0.99);
  status_.own_max_ms = own_time_.share_ms(1);
  status_.tx = queue_.counters();
  const std::uint32_t known = ports_.bus != nullptr ? ports_.bus->bit_rate() : 0;
  const double bit_rate = known > 0 ? known : config_.assumed_bit_rate;
  status_.bus_load_percent = 100 * (status_.tx.bits - bits_before_) / bit_rate;
  bits_before_ = status_.tx.bits;
  const std::uint64_t drops = status_.tx.abandoned + status_.tx.refused + status_.tx.poses_replaced;
  const hal::CanState state = ports_.bus != nullptr ? ports_.bus->state() : hal::CanState::kActive;
  const bool line_gone = ports_.bytes != nullptr && ports_.bytes->gone();
  bus_trouble_ =
      line_gone || drops != drops_before_ || state == hal::CanState::kBusOff || state == hal::CanState::kGone;
  drops_before_ = drops;
  tell_latency(now_ns);
}

void LinkNode::step(rt::TimeNs now_ns) {
  if (!started_) {
    started_ = true;
    t_last_pose_ns_ = now_ns;
    t_next_second_ns_ = now_ns + rt::kNsPerSecond;
    t_last_odometry_ns_ = now_ns - rt::kNsPerSecond;
  }
  receive(now_ns);
  ports_.health->read(&health_);
  take_pose(now_ns);
  // Counters are written to disk ahead of use, so that a crash cannot bring one back: a restart is a reset.
  const auto reserve_left = static_cast<std::uint8_t>(reset_reserved_ - reset_counter_);
  if (reserve_left < kResetReserve / 2 || reserve_left > kResetReserve) {
    StorageRequest request;
    request.kind = StorageRequest::Kind::kReserveResets;
    request.reset_counter = static_cast<std::uint8_t>(reset_counter_ + kResetReserve);
    if (ports_.storage->request(request)) reset_reserved_ = request.reset_counter;
  }
  if (parameters_.get(Parameter::kSendOrigin) != 0) {
    parameters_.set(Parameter::kSendOrigin, 0);
    origin_requested_.store(true, std::memory_order_relaxed);
  }
  if (origin_requested_.exchange(false, std::memory_order_relaxed)) {
    const bool sent = endpoint_.send_origin(now_ns);
    say(sent ? mavlink::StatusText::kInfo : mavlink::StatusText::kWarning,
        sent ? "VIO: origin sent" : "VIO: no origin is configured", now_ns);
  }
  endpoint_.step(now_ns);
  tell_state(now_ns);
  status_.condition = condition(now_ns);
  static const hal::CanCounters kNoBus;
  node_.step(now_ns, status_.condition, reassembler_.counters(),
             ports_.bus != nullptr ? ports_.bus->counters() : kNoBus);
  send_telemetry(now_ns);
  if (ports_.bus != nullptr) {
    queue_.drain(*ports_.bus, now_ns, kMaxFramesPerStep);
    status_.bus = ports_.bus->counters();
    status_.bus_state = ports_.bus->state();
  }
  account_sent_pose(now_ns);
  each_second(now_ns);

  restart_due_ = node_.restart_due(now_ns);
  status_.t_ns = now_ns;
  status_.node_id = node_.node_id();
  status_.armed = armed(now_ns);
  status_.autopilot_alive = endpoint_.autopilot_alive(now_ns);
  status_.reset_counter = reset_counter_;
  status_.synchronised = endpoint_.time_sync().synchronised(now_ns);
  status_.round_trip_ms = rt::to_ms(endpoint_.time_sync().round_trip_ns());
  status_.reception = reassembler_.counters();
  status_.mavlink = endpoint_.counters();
  if (ports_.status != nullptr) ports_.status->write(status_);
}

}  // namespace godwit::link
