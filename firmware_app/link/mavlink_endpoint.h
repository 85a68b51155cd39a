// Our end of a MAVLink connection to one autopilot, whatever carries the bytes: the DroneCAN tunnel, UDP or a serial
// port.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

#include "firmware_app/link/inputs.h"
#include "firmware_app/link/latency.h"
#include "firmware_app/link/mavlink/codec.h"
#include "firmware_app/link/mavlink/messages.h"
#include "firmware_app/link/tx_queue.h"

namespace godwit::link::mavlink {

/// Carries whole MAVLink frames to the autopilot. False: dropped whole. Returns quickly, does not allocate.
class Carrier {
 public:
  virtual ~Carrier() = default;
  virtual bool send(std::span<const std::uint8_t> frame, TxClass tx_class, rt::TimeNs now_ns) = 0;
};

struct GlobalOrigin {
  double latitude_deg = 0;
  double longitude_deg = 0;
  double altitude_m = 0;
};

struct EndpointConfig {
  std::uint8_t system = 0;  ///< our system id; 0: that of the autopilot, 1 until it is heard
  std::optional<GlobalOrigin> origin;
  /// Rates [Hz] asked of the autopilot by SET_MESSAGE_INTERVAL, 0: not asked for.
  double attitude_hz = 10;
  double imu_hz = 0;
  double range_hz = 5;
  double local_position_hz = 5;
  double global_position_hz = 2;
  double pressure_hz = 0;
  double satellites_hz = 0;  ///< what the receiver has (GPS_RAW_INT), not the autopilot's estimate
};

struct EndpointCounters {
  std::uint64_t sent = 0;
  std::uint64_t not_sent = 0;  ///< the carrier had no room
  std::uint64_t inputs = 0;
  std::uint64_t inputs_dropped = 0;      ///< the pipeline did not keep up
  std::uint64_t foreign_heartbeats = 0;  ///< of another autopilot than the one this is locked on to; ignored
  std::uint8_t foreign_system = 0;       ///< the last of them
  std::uint8_t foreign_component = 0;
  std::uint64_t bad_answers = 0;  ///< TIMESYNC answers to questions we never asked
};

/// One thread; time is an argument; no allocation after construction.
class Endpoint {
 public:
  /// inputs may be null.
  Endpoint(const EndpointConfig& config, Carrier* carrier, InputRing* inputs);

  /// Bytes that arrived.
  void receive(std::span<const std::uint8_t> bytes, rt::TimeNs now_ns);
  /// HEARTBEAT, TIMESYNC, requests for messages.
  void step(rt::TimeNs now_ns);
  /// False: dropped whole by the carrier.
  bool send_odometry(const Odometry& message, rt::TimeNs now_ns);
  /// Cut at 50 characters.
  void send_text(StatusText::Severity severity, std::string_view text, rt::TimeNs now_ns);
  /// SET_GPS_GLOBAL_ORIGIN with the configured origin; false where none is configured.
  bool send_origin(rt::TimeNs now_ns);
  void request_parameter(std::string_view name, rt::TimeNs now_ns);
  /// The newest PARAM_VALUE not yet taken.
  std::optional<ParamValue> take_parameter();
  /// The newest ATTITUDE_QUATERNION; t_attitude_ns: when it came, 0 never.
  const AttitudeQuaternion& attitude() const { return attitude_; }
  rt::TimeNs t_attitude_ns() const { return t_attitude_ns_; }

  bool autopilot_alive(rt::TimeNs now_ns) const;
  /// The autopilot is the first system whose component 1 sent a HEARTBEAT as one, for as long as this lives.
  /// The last HEARTBEAT of the autopilot said armed; t_heartbeat_ns: when that was, 0 never.
  bool armed() const { return armed_; }
  rt::TimeNs t_heartbeat_ns() const { return t_heartbeat_ns_; }
  std::uint8_t vehicle_type() const { return vehicle_type_; }  ///< MAV_TYPE of its HEARTBEAT; 0: none came
  const TimeSync& time_sync() const { return time_sync_; }
  const EndpointCounters& counters() const { return counters_; }

 private:
  struct Wanted {
    std::uint32_t id = 0;
    double rate_hz = 0;
    rt::TimeNs t_arrived_ns = 0;
    rt::TimeNs t_asked_ns = 0;
    int asked = 0;
  };

  template <typename Message>
  bool send(const Message& message, TxClass tx_class, rt::TimeNs now_ns);
  void take(const RawMessage& raw, rt::TimeNs now_ns);
  void take_input(const RawMessage& raw, rt::TimeNs now_ns);
  void ask_for_messages(rt::TimeNs now_ns);

  EndpointConfig config_;
  Carrier* carrier_;
  InputRing* inputs_;
  Parser parser_;
  Sender sender_;
  TimeSync time_sync_;
  std::uint8_t autopilot_system_ = 0;
  std::uint8_t autopilot_component_ = 1;
  std::uint8_t vehicle_type_ = 0;
  bool armed_ = false;
  rt::TimeNs t_heartbeat_ns_ = 0;
  rt::TimeNs t_next_heartbeat_ns_ = 0;
  rt::TimeNs t_next_timesync_ns_ = 0;
  rt::TimeNs t_next_request_ns_ = 0;
  std::array<Wanted, 8> wanted_{};
  std::size_t next_wanted_ = 0;
  AttitudeQuaternion attitude_;
  rt::TimeNs t_attitude_ns_ = 0;
  std::optional<ParamValue> parameter_;
  EndpointCounters counters_;
};

}  // namespace godwit::link::mavlink
