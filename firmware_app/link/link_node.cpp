#include "firmware_app/link/link_node.h"

#include <Eigen/LU>
#include <algorithm>

#include "firmware_app/link/dronecan/types.h"

namespace godwit::link {
namespace {

std::vector<dronecan::TypeInfo> accepted_types() {
  std::vector<dronecan::TypeInfo> types = dronecan::Node::accepted_types();
  types.insert(types.end(),
               {dronecan::TunnelTargetted::kType, dronecan::RangeMeasurement::kType, dronecan::StaticPressure::kType,
                dronecan::GnssFix2::kType, dronecan::RawImu::kType, dronecan::ArmingStatus::kType,
                dronecan::GlobalTimeSync::kType, dronecan::NodeStatus::kType});
  return types;
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
      carrier_(ports.bytes, &parameters_, &node_, &queue_),
      endpoint_(
          [&] {
            mavlink::EndpointConfig endpoint = config.mavlink;
            endpoint.system = static_cast<std::uint8_t>(parameters_.get(Parameter::kSystemId));
            return endpoint;
          }(),
          &carrier_, ports.inputs),
      filters_(ports.inputs != nullptr),
      watch_(config.patience),
      resets_(stored.reset_counter),
      between_(ports.readings != nullptr ? std::make_unique<PoseCarrier>(ports.readings) : nullptr) {
  config_.odometry.profile = static_cast<Profile>(parameters_.get(Parameter::kProfile));
  reassembler_.protect_source(static_cast<std::uint8_t>(parameters_.get(Parameter::kAutopilotNode)));
  filters_.follow(node_.node_id(), ports_.bus, &reassembler_);
}

void LinkNode::send_pose(rt::TimeNs t_stamp_ns, rt::TimeNs t_published_ns, rt::TimeNs now_ns) {
  if (!pacing_.grows(t_stamp_ns)) {
    ++status_.poses_stale;
    return;
  }
  const BodyPose& pose = hold_.pose();
  if (!endpoint_.send_odometry(odometry_message(pose, config_.odometry, t_stamp_ns, resets_.value()), now_ns)) return;
  account_.given({t_stamp_ns, t_published_ns, pose.quality, carrier_.last_queued()});
  ++status_.odometry_sent;
  hold_.sent();
  pacing_.sent(t_stamp_ns, now_ns);
}

void LinkNode::take_sample(const PoseSample& sample, rt::TimeNs now_ns) {
  const bool late = sample.t_capture_ns <= sample_.t_capture_ns && watch_.any();
  const bool old = now_ns - sample.t_capture_ns > config_.max_pose_age_ns;
  bad_pose_ = sample.t_capture_ns > now_ns;
  if (late || old || bad_pose_) {
    ++status_.poses_stale;  // not taken: if nothing better comes, the watch says so
    return;
  }
  sample_ = sample;
  watch_.came(now_ns);
  // What can be carried goes out in carry_on().
  if (between_ && between_->reaches(sample_) > sample_.t_capture_ns) return;
  offer(sample_, now_ns);
  // A pose that fails is told at once, whatever the plan says.
  const bool failed = hold_.pose().quality < 0 && status_.quality >= 0;
  const bool due = pacing_.due(sample.t_capture_ns, period_ns()) || failed;
  if (!due || pose_waits_) ++status_.poses_paced;
  pose_waits_ = pose_waits_ || due;
  status_.quality = hold_.pose().quality;
}

void LinkNode::offer(const PoseSample& sample, rt::TimeNs now_ns) {
  const BodyPose pose = body_pose(sample, config_.odometry);
  resets_.add(hold_.take(pose, sample.map_id, sample.reset_counter, now_ns));
  const bool known = sample.has_gravity || config_.odometry.bench_metric;
  bad_pose_ = vo::claims_pose(sample.state) && known && !pose.attitude_known;
  t_held_ns_ = sample.t_capture_ns;
  t_given_ns_ = sample.t_published_ns;
  // After a pose that was carried past this picture the word that there is none would go back.
  if (between_ && hold_.pose().quality < 0) t_held_ns_ = pacing_.stamp_without_pose_ns(t_held_ns_);
}

// The newest measured pose at the newest reading's time, whenever the plan wants one.
void LinkNode::carry_on(rt::TimeNs now_ns) {
  const rt::TimeNs t_ns = std::min(between_->reaches(sample_), now_ns);
  if (watch_.stalled(now_ns) || !pacing_.far_enough(now_ns) || !pacing_.grows(t_ns)) return;
  if (t_ns <= sample_.t_capture_ns || !pacing_.due(t_ns, period_ns())) return;
  PoseSample carried;
  if (!between_->carry(sample_, t_ns, &carried)) return;
  offer(carried, now_ns);
  pose_waits_ = true;
  status_.quality = hold_.pose().quality;
  ++status_.poses_carried;
}

void LinkNode::move_poses(rt::TimeNs now_ns) {
  if (endpoint_.t_attitude_ns() != 0) {
    const mavlink::AttitudeQuaternion& a = endpoint_.attitude();
    hold_.heard_attitude({a.q1, a.q2, a.q3, a.q4}, endpoint_.t_attitude_ns());
  }
  if (between_) between_->hear();
  PoseSample sample;
  if (ports_.poses->read(&sample)) take_sample(sample, now_ns);
  if (between_) carry_on(now_ns);
  if (pose_waits_ && pacing_.far_enough(now_ns)) {
    pose_waits_ = false;
    send_pose(t_held_ns_, t_given_ns_, now_ns);
  }
  if (!watch_.any() || !watch_.stalled(now_ns)) return;
  // Camera or odometry fell silent: say so at the usual rate; the last position is told as no pose.
  sample_.state = PoseState::kLost;
  pose_waits_ = false;
  hold_.lose(now_ns);
  status_.quality = -1;
  if (pacing_.silence_due(now_ns, period_ns())) send_pose(pacing_.silence_stamp_ns(now_ns), 0, now_ns);
}

void LinkNode::send_telemetry(rt::TimeNs now_ns) {
  if (ports_.bus == nullptr || t_held_ns_ == 0 || !telemetry_.due(parameters_, now_ns)) return;
  TelemetrySnapshot snapshot;
  snapshot.state = sample_.state;
  snapshot.has_scale = sample_.has_scale;
  snapshot.has_gravity = sample_.has_gravity;
  snapshot.reset_counter = resets_.value();
  snapshot.map_id = static_cast<std::uint16_t>(sample_.map_id);
  snapshot.t_capture_ns = t_held_ns_;
  snapshot.age_ns = now_ns - t_held_ns_;
  snapshot.temperature_c = health_.temperature_c;
  snapshot.throttled = health_.throttled;
  snapshot.pose = hold_.pose();
  telemetry_.send(snapshot, parameters_, &queue_, now_ns);
}

void LinkNode::say(const std::optional<StatusLine>& line, rt::TimeNs now_ns) {
  if (!line) return;
  endpoint_.send_text(line->severity, line->view(), now_ns);
  using Text = mavlink::StatusText;
  using Log = dronecan::LogMessage;
  const auto level = line->severity <= Text::kError     ? Log::kError
                     : line->severity == Text::kWarning ? Log::kWarning
                                                        : Log::kInfo;
  node_.log(level, line->view(), now_ns);
}

void LinkNode::send_origin(rt::TimeNs now_ns) {
  if (parameters_.get(Parameter::kSendOrigin) == 0) return;
  parameters_.set(Parameter::kSendOrigin, 0);
  say(StatusTexts::of_origin(endpoint_.send_origin(now_ns)), now_ns);
}

Reasons LinkNode::reasons(rt::TimeNs now_ns) const {
  const bool stall = watch_.stalled(now_ns);
  const bool has_pose = !stall && vo::claims_pose(sample_.state);
  const bool bench = config_.odometry.bench_metric;
  const bool all_live = config_.heartbeats == nullptr || config_.heartbeats->silent(now_ns).name == nullptr;
  Reasons r;
  r.set(kCameraFailed, !health_.camera_ok);
  r.set(kImuFailed, !health_.imu_ok);
  r.set(kProcessFailed, !health_.process_ok || !all_live);
  r.set(kPoseStalled, stall);
  r.set(kNoPose, !has_pose);
  r.set(kNoScale, !sample_.has_scale && !bench);
  r.set(kNoGravity, !sample_.has_gravity && !bench);
  r.set(kTooHot, health_.temperature_c > config_.max_temperature_c);
  r.set(kLatencyGrew, status_.latency.grew);
  r.set(kBusTrouble, account_.figures().trouble);
  r.set(kNoAutopilot, !endpoint_.autopilot_alive(now_ns));
  r.set(kNoTimesync, !endpoint_.time_sync().synchronised(now_ns));
  r.set(kDetectorFailed, !health_.detector_ok);
  r.set(kBadPose, bad_pose_);
  r.set(kSameNodeId, status_.own_id_heard);
  return r;
}

void LinkNode::account_sent_pose(rt::TimeNs now_ns) {
  const bool by_bytes = ports_.bytes != nullptr;
  if (!(by_bytes ? account_.left() : account_.left(queue_.last_pose_sent()))) return;
  const TimeSync& sync = endpoint_.time_sync();
  Wire wire;
  wire.synchronised = sync.synchronised(now_ns);
  wire.round_trip_ns = sync.round_trip_ns();
  wire.line_baud = by_bytes ? ports_.bytes->baud_rate() : 0;
  wire.tunnel = !by_bytes;
  wire.bus_bit_rate = ports_.bus != nullptr ? ports_.bus->bit_rate() : 0;
  wire.pose_bits = queue_.last_pose_bits();
  wire.tunnel_baud = static_cast<double>(parameters_.get(Parameter::kBaudRate));
  const rt::TimeNs t_sent_ns = config_.clock != nullptr ? config_.clock() : now_ns;
  const PoseDeparture departure = account_.account(t_sent_ns, path_over(wire));
  if (departure.t_capture_ns != 0 && ports_.departures != nullptr) ports_.departures->try_push(departure);
}

void LinkNode::each_second(rt::TimeNs now_ns) {
  if (now_ns < t_next_second_ns_) return;
  t_next_second_ns_ = now_ns + rt::kNsPerSecond;
  const std::uint32_t known = ports_.bus != nullptr ? ports_.bus->bit_rate() : 0;
  const hal::CanState state = ports_.bus != nullptr ? ports_.bus->state() : hal::CanState::kActive;
  const bool line_gone = ports_.bytes != nullptr && ports_.bytes->gone();
  status_.tx = queue_.counters();
  const BusFigures& figures =
      account_.each_second(status_.tx, known > 0 ? known : config_.assumed_bit_rate,
                           line_gone || state == hal::CanState::kBusOff || state == hal::CanState::kGone);
  status_.latency = figures.latency;
  status_.own_samples = figures.own_samples;
  status_.own_p50_ms = figures.own_p50_ms;
  status_.own_p99_ms = figures.own_p99_ms;
  status_.own_max_ms = figures.own_max_ms;
  status_.bus_load_percent = figures.load_percent;
  say(texts_.of_latency(figures.latency, endpoint_.time_sync().synchronised(now_ns), now_ns), now_ns);
}

void LinkNode::step(rt::TimeNs now_ns) {
  if (!started_) {
    started_ = true;
    watch_.begin(now_ns);
    pacing_.begin(now_ns);
    t_next_second_ns_ = now_ns + rt::kNsPerSecond;
  }
  receive(now_ns);
  status_.own_id_heard = t_own_id_ns_ != 0 && now_ns - t_own_id_ns_ <= kNodeGoneNs;
  ports_.health->read(&health_);
  move_poses(now_ns);
  resets_.reserve(ports_.storage);
  send_origin(now_ns);
  endpoint_.step(now_ns);
  if (watch_.any()) {
    say(texts_.of_state(sample_.state, hold_.pose().quality > 0, watch_.stalled(now_ns), now_ns), now_ns);
  }
  const bool pose_wanted = parameters_.get(Parameter::kRequirePose) != 0 && !armed(now_ns) && hold_.pose().quality < 0;
  status_.condition = condition(reasons(now_ns), {config_.imu_required, pose_wanted, watch_.any()});
  static const hal::CanCounters kNoBus;
  node_.step(now_ns, status_.condition, reassembler_.counters(),
             ports_.bus != nullptr ? ports_.bus->counters() : kNoBus);
  send_telemetry(now_ns);
  if (ports_.bus != nullptr) queue_.drain(*ports_.bus, now_ns, kMaxFramesPerStep);
  account_sent_pose(now_ns);
  each_second(now_ns);
  restart_due_ = node_.restart_due(now_ns);
  fill_status(now_ns);
  if (ports_.status != nullptr) ports_.status->write(status_);
}

void LinkNode::fill_status(rt::TimeNs now_ns) {
  status_.t_ns = now_ns;
  status_.node_id = node_.node_id();
  status_.armed = armed(now_ns);
  status_.autopilot_alive = endpoint_.autopilot_alive(now_ns);
  status_.reset_counter = resets_.value();
  status_.pictures_repeated = watch_.repeated();
  status_.readings_missed = between_ ? between_->missed() : 0;
  status_.synchronised = endpoint_.time_sync().synchronised(now_ns);
  status_.round_trip_ms = rt::to_ms(endpoint_.time_sync().round_trip_ns());
  status_.reception = reassembler_.counters();
  status_.mavlink = endpoint_.counters();
  status_.port_gone = ports_.bytes != nullptr && ports_.bytes->gone();
  if (ports_.bus == nullptr) return;
  status_.has_bus = true;
  status_.bus = ports_.bus->counters();
  status_.bus_state = ports_.bus->state();
}

}  // namespace godwit::link
