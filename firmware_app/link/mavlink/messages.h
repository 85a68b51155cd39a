// The MAVLink messages godwit sends or takes, those with what the autopilot measured in a file of their own: fields in
// wire order (by size, largest first, then as defined; extension fields behind), named as in MAVLink's common.xml. A
// test compares each with pymavlink, bit for bit.
#pragma once

#include <array>
#include <cstdint>

#include "firmware_app/link/mavlink/measured_messages.h"  // IWYU pragma: export
#include "firmware_app/link/mavlink/message_info.h"

namespace godwit::link::mavlink {

struct Heartbeat : MessageInfo<0, 50, 9> {
  static constexpr const char* kName = "HEARTBEAT";
  static constexpr std::uint8_t kModeArmed = 128;
  static constexpr std::uint8_t kTypeSubmarine = 12;
  std::uint32_t custom_mode = 0;
  std::uint8_t type = 0;
  std::uint8_t autopilot = 0;
  std::uint8_t base_mode = 0;
  std::uint8_t system_status = 0;
  std::uint8_t mavlink_version = 3;
  static void visit(auto& v, auto& s) {
    v.field("custom_mode", s.custom_mode);
    v.field("type", s.type);
    v.field("autopilot", s.autopilot);
    v.field("base_mode", s.base_mode);
    v.field("system_status", s.system_status);
    v.field("mavlink_version", s.mavlink_version);
  }
};

struct ParamRequestRead : MessageInfo<20, 214, 20> {
  static constexpr const char* kName = "PARAM_REQUEST_READ";
  std::int16_t param_index = -1;
  std::uint8_t target_system = 0;
  std::uint8_t target_component = 0;
  std::array<char, 16> param_id{};
  static void visit(auto& v, auto& s) {
    v.field("param_index", s.param_index);
    v.field("target_system", s.target_system);
    v.field("target_component", s.target_component);
    v.field("param_id", s.param_id);
  }
};

struct ParamValue : MessageInfo<22, 220, 25> {
  static constexpr const char* kName = "PARAM_VALUE";
  float param_value = 0;
  std::uint16_t param_count = 0;
  std::uint16_t param_index = 0;
  std::array<char, 16> param_id{};
  std::uint8_t param_type = 0;
  static void visit(auto& v, auto& s) {
    v.field("param_value", s.param_value);
    v.field("param_count", s.param_count);
    v.field("param_index", s.param_index);
    v.field("param_id", s.param_id);
    v.field("param_type", s.param_type);
  }
};

struct SetGpsGlobalOrigin : MessageInfo<48, 41, 21> {
  static constexpr const char* kName = "SET_GPS_GLOBAL_ORIGIN";
  std::int32_t latitude = 0, longitude = 0;  ///< [1e-7 degree]
  std::int32_t altitude = 0;                 ///< [mm]
  std::uint8_t target_system = 0;
  std::uint64_t time_usec = 0;
  static void visit(auto& v, auto& s) {
    v.field("latitude", s.latitude);
    v.field("longitude", s.longitude);
    v.field("altitude", s.altitude);
    v.field("target_system", s.target_system);
    v.field("time_usec", s.time_usec);
  }
};

struct GpsGlobalOrigin : MessageInfo<49, 39, 20> {
  static constexpr const char* kName = "GPS_GLOBAL_ORIGIN";
  std::int32_t latitude = 0, longitude = 0, altitude = 0;
  std::uint64_t time_usec = 0;
  static void visit(auto& v, auto& s) {
    v.field("latitude", s.latitude);
    v.field("longitude", s.longitude);
    v.field("altitude", s.altitude);
    v.field("time_usec", s.time_usec);
  }
};

struct CommandLong : MessageInfo<76, 152, 33> {
  static constexpr const char* kName = "COMMAND_LONG";
  static constexpr std::uint16_t kSetMessageInterval = 511;
  float param1 = 0, param2 = 0, param3 = 0, param4 = 0, param5 = 0, param6 = 0, param7 = 0;
  std::uint16_t command = 0;
  std::uint8_t target_system = 0, target_component = 0, confirmation = 0;
  static void visit(auto& v, auto& s) {
    v.field("param1", s.param1);
    v.field("param2", s.param2);
    v.field("param3", s.param3);
    v.field("param4", s.param4);
    v.field("param5", s.param5);
    v.field("param6", s.param6);
    v.field("param7", s.param7);
    v.field("command", s.command);
    v.field("target_system", s.target_system);
    v.field("target_component", s.target_component);
    v.field("confirmation", s.confirmation);
  }
};

struct CommandAck : MessageInfo<77, 143, 10> {
  static constexpr const char* kName = "COMMAND_ACK";
  std::uint16_t command = 0;
  std::uint8_t result = 0;
  std::uint8_t progress = 0;
  std::int32_t result_param2 = 0;
  std::uint8_t target_system = 0, target_component = 0;
  static void visit(auto& v, auto& s) {
    v.field("command", s.command);
    v.field("result", s.result);
    v.field("progress", s.progress);
    v.field("result_param2", s.result_param2);
    v.field("target_system", s.target_system);
    v.field("target_component", s.target_component);
  }
};

struct VisionPositionEstimate : MessageInfo<102, 158, 117> {
  static constexpr const char* kName = "VISION_POSITION_ESTIMATE";
  std::uint64_t usec = 0;
  float x = 0, y = 0, z = 0, roll = 0, pitch = 0, yaw = 0;
  std::array<float, 21> covariance{};
  std::uint8_t reset_counter = 0;
  static void visit(auto& v, auto& s) {
    v.field("usec", s.usec);
    v.field("x", s.x);
    v.field("y", s.y);
    v.field("z", s.z);
    v.field("roll", s.roll);
    v.field("pitch", s.pitch);
    v.field("yaw", s.yaw);
    v.field("covariance", s.covariance);
    v.field("reset_counter", s.reset_counter);
  }
};

struct VisionSpeedEstimate : MessageInfo<103, 208, 57> {
  static constexpr const char* kName = "VISION_SPEED_ESTIMATE";
  std::uint64_t usec = 0;
  float x = 0, y = 0, z = 0;
  std::array<float, 9> covariance{};
  std::uint8_t reset_counter = 0;
  static void visit(auto& v, auto& s) {
    v.field("usec", s.usec);
    v.field("x", s.x);
    v.field("y", s.y);
    v.field("z", s.z);
    v.field("covariance", s.covariance);
    v.field("reset_counter", s.reset_counter);
  }
};

struct Timesync : MessageInfo<111, 34, 18> {
  static constexpr const char* kName = "TIMESYNC";
  std::int64_t tc1 = 0;                                  ///< 0 in a question, the answerer's time [ns] in an answer
  std::int64_t ts1 = 0;                                  ///< the asker's time [ns]
  std::uint8_t target_system = 0, target_component = 0;  ///< newer than some autopilots: left 0, which leaves them out
  static void visit(auto& v, auto& s) {
    v.field("tc1", s.tc1);
    v.field("ts1", s.ts1);
    v.field("target_system", s.target_system);
    v.field("target_component", s.target_component);
  }
};

struct StatusText : MessageInfo<253, 83, 54> {
  static constexpr const char* kName = "STATUSTEXT";
  enum Severity : std::uint8_t { kError = 3, kWarning = 4, kNotice = 5, kInfo = 6 };
  std::uint8_t severity = 0;
  std::array<char, 50> text{};
  std::uint16_t id = 0;
  std::uint8_t chunk_seq = 0;
  static void visit(auto& v, auto& s) {
    v.field("severity", s.severity);
    v.field("text", s.text);
    v.field("id", s.id);
    v.field("chunk_seq", s.chunk_seq);
  }
};

struct Odometry : MessageInfo<331, 91, 233> {
  static constexpr const char* kName = "ODOMETRY";
  std::uint64_t time_usec = 0;
  float x = 0, y = 0, z = 0;
  std::array<float, 4> q{1, 0, 0, 0};  ///< w x y z
  float vx = 0, vy = 0, vz = 0;
  float rollspeed = 0, pitchspeed = 0, yawspeed = 0;
  std::array<float, 21> pose_covariance{};  ///< upper triangle by rows: x y z roll pitch yaw
  std::array<float, 21> velocity_covariance{};
  std::uint8_t frame_id = 0, child_frame_id = 0;
  std::uint8_t reset_counter = 0;
  std::uint8_t estimator_type = 0;
  std::int8_t quality = 0;
  static void visit(auto& v, auto& s) {
    v.field("time_usec", s.time_usec);
    v.field("x", s.x);
    v.field("y", s.y);
    v.field("z", s.z);
    v.field("q", s.q);
    v.field("vx", s.vx);
    v.field("vy", s.vy);
    v.field("vz", s.vz);
    v.field("rollspeed", s.rollspeed);
    v.field("pitchspeed", s.pitchspeed);
    v.field("yawspeed", s.yawspeed);
    v.field("pose_covariance", s.pose_covariance);
    v.field("velocity_covariance", s.velocity_covariance);
    v.field("frame_id", s.frame_id);
    v.field("child_frame_id", s.child_frame_id);
    v.field("reset_counter", s.reset_counter);
    v.field("estimator_type", s.estimator_type);
    v.field("quality", s.quality);
  }
};

/// Calls `f.template operator()<Message>()` for every message.
template <typename F>
void for_each_message(F&& f) {
  f.template operator()<Heartbeat>();
  f.template operator()<ParamRequestRead>();
  f.template operator()<ParamValue>();
  f.template operator()<GpsRawInt>();
  f.template operator()<RawImu>();
  f.template operator()<ScaledPressure>();
  f.template operator()<AttitudeQuaternion>();
  f.template operator()<LocalPositionNed>();
  f.template operator()<GlobalPositionInt>();
  f.template operator()<SetGpsGlobalOrigin>();
  f.template operator()<GpsGlobalOrigin>();
  f.template operator()<CommandLong>();
  f.template operator()<CommandAck>();
  f.template operator()<VisionPositionEstimate>();
  f.template operator()<VisionSpeedEstimate>();
  f.template operator()<HighresImu>();
  f.template operator()<Timesync>();
  f.template operator()<ScaledImu2>();
  f.template operator()<DistanceSensor>();
  f.template operator()<StatusText>();
  f.template operator()<Odometry>();
}

}  // namespace godwit::link::mavlink
