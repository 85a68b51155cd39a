#include "firmware_app/link/mavlink_endpoint.h"

#include <algorithm>
#include <cmath>

namespace godwit::link::mavlink {
namespace {

constexpr std::uint8_t kTypeOnboardController = 18;
constexpr std::uint8_t kAutopilotInvalid = 8;
constexpr std::uint8_t kStateActive = 4;
constexpr std::uint8_t kComponentAutopilot = 1;
constexpr rt::TimeNs kHeartbeatPeriodNs = rt::kNsPerSecond;
constexpr rt::TimeNs kAliveNs = 3 * rt::kNsPerSecond;
constexpr rt::TimeNs kRequestGapNs = 200 * rt::kNsPerMs;
constexpr int kEagerRequests = 5;
// Quick until the clocks agree, then often enough to see a latency that grows.
constexpr rt::TimeNs kTimesyncFirstNs = 100 * rt::kNsPerMs;
constexpr rt::TimeNs kTimesyncNs = 500 * rt::kNsPerMs;

std::int32_t degrees_e7(double degrees) {
  return static_cast<std::int32_t>(std::lround(degrees * 1e7));
}

}  // namespace

Endpoint::Endpoint(const EndpointConfig& config, Carrier* carrier, InputRing* inputs)
    : config_(config), carrier_(carrier), inputs_(inputs) {
  sender_.system = config.system != 0 ? config.system : 1;
  wanted_ = {Wanted{AttitudeQuaternion::kId, config.attitude_hz},
             Wanted{RawImu::kId, config.imu_hz},
             Wanted{DistanceSensor::kId, config.range_hz},
             Wanted{LocalPositionNed::kId, config.local_position_hz},
             Wanted{GlobalPositionInt::kId, config.global_position_hz},
             Wanted{HighresImu::kId, config.imu_hz},
             Wanted{ScaledPressure::kId, config.pressure_hz},
             Wanted{GpsRawInt::kId, config.satellites_hz}};
}

template <typename Message>
bool Endpoint::send(const Message& message, TxClass tx_class, rt::TimeNs now_ns) {
  MessageBytes bytes;
  const std::size_t length = encode(message, &sender_, &bytes);
  const bool sent = carrier_->send({bytes.data(), length}, tx_class, now_ns);
  ++(sent ? counters_.sent : counters_.not_sent);
  return sent;
}

bool Endpoint::send_odometry(const Odometry& message, rt::TimeNs now_ns) {
  return send(message, TxClass::kPose, now_ns);
}

bool Endpoint::autopilot_alive(rt::TimeNs now_ns) const {
  return t_heartbeat_ns_ != 0 && now_ns - t_heartbeat_ns_ <= kAliveNs;
}

void Endpoint::receive(std::span<const std::uint8_t> bytes, rt::TimeNs now_ns) {
  parser_.feed(bytes, [&](const RawMessage& raw) { take(raw, now_ns); });
}

void Endpoint::take(const RawMessage& raw, rt::TimeNs now_ns) {
  switch (raw.id) {
    case Heartbeat::kId: {
      Heartbeat m;
      decode(raw, &m);
      if (m.autopilot == kAutopilotInvalid || m.type == kTypeOnboardController) return;  // a camera, a ground station
      const bool first = autopilot_system_ == 0 && raw.component == kComponentAutopilot;
      if (!first && (raw.system != autopilot_system_ || raw.component != autopilot_component_)) {
        ++counters_.foreign_heartbeats;
        counters_.foreign_system = raw.system;
        counters_.foreign_component = raw.component;
        return;
      }
      autopilot_system_ = raw.system;
      autopilot_component_ = raw.component;
      if (config_.system == 0) sender_.system = raw.system;
      vehicle_type_ = m.type;
      armed_ = (m.base_mode & Heartbeat::kModeArmed) != 0;
      t_heartbeat_ns_ = now_ns;
      return;
    }
    case Timesync::kId: {
      Timesync m;
      decode(raw, &m);
      if (m.tc1 == 0) {
        send(TimeSync::answer(m, now_ns), TxClass::kFlight, now_ns);
      } else if (!time_sync_.take_answer(m, now_ns)) {
        ++counters_.bad_answers;
      }
      return;
    }
    case ParamValue::kId: {
      ParamValue m;
      decode(raw, &m);
      parameter_ = m;
      return;
    }
    default:
      break;
  }
  // Measurements are taken from the autopilot alone, once it is known.
  if (autopilot_system_ == 0 || raw.system != autopilot_system_ || raw.component != autopilot_component_) return;
  if (raw.id == AttitudeQuaternion::kId) {
    decode(raw, &attitude_);
    t_attitude_ns_ = now_ns;
  }
  for (Wanted& w : wanted_) {
    if (w.id != raw.id) continue;
    w.t_arrived_ns = now_ns;
    w.asked = 0;
  }
  take_input(raw, now_ns);
}

void Endpoint::take_input(const RawMessage& raw, rt::TimeNs now_ns) {
  AutopilotInput input;
  if (inputs_ == nullptr || !input_from_mavlink(raw, &input)) return;
  input.t_arrival_ns = now_ns;
  if (input.t_source_us != 0 && time_sync_.synchronised(now_ns)) {
    input.t_measured_ns = static_cast<rt::TimeNs>(input.t_source_us) * 1000 - time_sync_.offset_ns();
  }
  ++(inputs_->try_push(input) ? counters_.inputs : counters_.inputs_dropped);
}

void Endpoint::ask_for_messages(rt::TimeNs now_ns) {
  if (!autopilot_alive(now_ns) || now_ns < t_next_request_ns_) return;
  // One question at a time; a message that does not come is asked for every 2 s, after five times every 30 s.
  for (std::size_t tried = 0; tried < wanted_.size(); ++tried) {
    Wanted& w = wanted_[next_wanted_];
    next_wanted_ = (next_wanted_ + 1) % wanted_.size();
    const rt::TimeNs patience = (w.asked < kEagerRequests ? 2 : 30) * rt::kNsPerSecond;
    const bool silent = w.t_arrived_ns == 0 || now_ns - w.t_arrived_ns > kAliveNs;
    if (w.rate_hz <= 0 || !silent || (w.asked > 0 && now_ns - w.t_asked_ns < patience)) continue;
    CommandLong m;
    m.command = CommandLong::kSetMessageInterval;
    m.target_system = autopilot_system_;
    m.target_component = autopilot_component_;
    m.param1 = static_cast<float>(w.id);
    m.param2 = static_cast<float>(1e6 / w.rate_hz);
    send(m, TxClass::kFlight, now_ns);
    ++w.asked;
    w.t_asked_ns = now_ns;
    t_next_request_ns_ = now_ns + kRequestGapNs;
    return;
  }
}

void Endpoint::step(rt::TimeNs now_ns) {
  if (now_ns >= t_next_heartbeat_ns_) {
    t_next_heartbeat_ns_ = now_ns + kHeartbeatPeriodNs;
    Heartbeat m;
    m.type = kTypeOnboardController;
    m.autopilot = kAutopilotInvalid;
    m.system_status = kStateActive;
    send(m, TxClass::kFlight, now_ns);
  }
  if (now_ns >= t_next_timesync_ns_) {
    const bool settled = time_sync_.synchronised(now_ns) || !autopilot_alive(now_ns);
    t_next_timesync_ns_ = now_ns + (settled ? kTimesyncNs : kTimesyncFirstNs);
    send(time_sync_.question(now_ns), TxClass::kFlight, now_ns);
  }
  ask_for_messages(now_ns);
}

void Endpoint::send_text(StatusText::Severity severity, std::string_view text, rt::TimeNs now_ns) {
  StatusText m;
  m.severity = severity;
  std::copy_n(text.begin(), std::min(text.size(), m.text.size()), m.text.begin());
  send(m, TxClass::kFlight, now_ns);
}

bool Endpoint::send_origin(rt::TimeNs now_ns) {
  if (!config_.origin) return false;
  SetGpsGlobalOrigin m;
  m.latitude = degrees_e7(config_.origin->latitude_deg);
  m.longitude = degrees_e7(config_.origin->longitude_deg);
  m.altitude = static_cast<std::int32_t>(std::lround(config_.origin->altitude_m * 1000));
  m.target_system = autopilot_system_;
  m.time_usec = static_cast<std::uint64_t>(now_ns / 1000);
  return send(m, TxClass::kFlight, now_ns);
}

void Endpoint::request_parameter(std::string_view name, rt::TimeNs now_ns) {
  ParamRequestRead m;
  m.target_system = autopilot_system_;
  m.target_component = autopilot_component_;
  std::copy_n(name.begin(), std::min(name.size(), m.param_id.size()), m.param_id.begin());
  send(m, TxClass::kFlight, now_ns);
}

std::optional<ParamValue> Endpoint::take_parameter() {
  const std::optional<ParamValue> out = parameter_;
  parameter_.reset();
  return out;
}

}  // namespace godwit::link::mavlink
