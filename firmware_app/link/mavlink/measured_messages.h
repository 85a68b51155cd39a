// The MAVLink messages with what the autopilot measured: fields in wire order (by size, largest first, then as defined;
// extension fields behind), named as in MAVLink's common.xml. A test compares each with pymavlink, bit for bit.
#pragma once

#include <array>
#include <cstdint>

#include "firmware_app/link/mavlink/message_info.h"

namespace godwit::link::mavlink {

struct RawImu : MessageInfo<27, 144, 29> {
  static constexpr const char* kName = "RAW_IMU";
  std::uint64_t time_usec = 0;
  std::int16_t xacc = 0, yacc = 0, zacc = 0;     ///< [mG]
  std::int16_t xgyro = 0, ygyro = 0, zgyro = 0;  ///< [mrad/s]
  std::int16_t xmag = 0, ymag = 0, zmag = 0;     ///< [mgauss]
  std::uint8_t id = 0;
  std::int16_t temperature = 0;
  static void visit(auto& v, auto& s) {
    v.field("time_usec", s.time_usec);
    v.field("xacc", s.xacc);
    v.field("yacc", s.yacc);
    v.field("zacc", s.zacc);
    v.field("xgyro", s.xgyro);
    v.field("ygyro", s.ygyro);
    v.field("zgyro", s.zgyro);
    v.field("xmag", s.xmag);
    v.field("ymag", s.ymag);
    v.field("zmag", s.zmag);
    v.field("id", s.id);
    v.field("temperature", s.temperature);
  }
};

/// What the receiver itself has, not the autopilot's estimate.
struct GpsRawInt : MessageInfo<24, 24, 52> {
  static constexpr const char* kName = "GPS_RAW_INT";
  std::uint64_t time_usec = 0;     ///< since boot, or a date
  std::int32_t lat = 0, lon = 0;   ///< [1e-7 degree]
  std::int32_t alt = 0;            ///< above the sea [mm]
  std::uint16_t eph = 0, epv = 0;  ///< dilutions times 100
  std::uint16_t vel = 0, cog = 0;  ///< [cm/s], [0.01 degree]
  std::uint8_t fix_type = 0, satellites_visible = 0;
  std::int32_t alt_ellipsoid = 0;      ///< [mm]
  std::uint32_t h_acc = 0, v_acc = 0;  ///< one sigma, 0: not told [mm]
  std::uint32_t vel_acc = 0;           ///< [mm/s]
  std::uint32_t hdg_acc = 0;           ///< [1e-5 degree]
  std::uint16_t yaw = 0;               ///< [0.01 degree]
  static void visit(auto& v, auto& s) {
    v.field("time_usec", s.time_usec);
    v.field("lat", s.lat);
    v.field("lon", s.lon);
    v.field("alt", s.alt);
    v.field("eph", s.eph);
    v.field("epv", s.epv);
    v.field("vel", s.vel);
    v.field("cog", s.cog);
    v.field("fix_type", s.fix_type);
    v.field("satellites_visible", s.satellites_visible);
    v.field("alt_ellipsoid", s.alt_ellipsoid);
    v.field("h_acc", s.h_acc);
    v.field("v_acc", s.v_acc);
    v.field("vel_acc", s.vel_acc);
    v.field("hdg_acc", s.hdg_acc);
    v.field("yaw", s.yaw);
  }
};

struct ScaledPressure : MessageInfo<29, 115, 16> {
  static constexpr const char* kName = "SCALED_PRESSURE";
  std::uint32_t time_boot_ms = 0;
  float press_abs = 0, press_diff = 0;                       ///< [hPa]
  std::int16_t temperature = 0, temperature_press_diff = 0;  ///< [0.01 degrees C]
  static void visit(auto& v, auto& s) {
    v.field("time_boot_ms", s.time_boot_ms);
    v.field("press_abs", s.press_abs);
    v.field("press_diff", s.press_diff);
    v.field("temperature", s.temperature);
    v.field("temperature_press_diff", s.temperature_press_diff);
  }
};

struct AttitudeQuaternion : MessageInfo<31, 246, 48> {
  static constexpr const char* kName = "ATTITUDE_QUATERNION";
  std::uint32_t time_boot_ms = 0;
  float q1 = 0, q2 = 0, q3 = 0, q4 = 0;  ///< w x y z, body FRD to NED
  float rollspeed = 0, pitchspeed = 0, yawspeed = 0;
  std::array<float, 4> repr_offset_q{};
  static void visit(auto& v, auto& s) {
    v.field("time_boot_ms", s.time_boot_ms);
    v.field("q1", s.q1);
    v.field("q2", s.q2);
    v.field("q3", s.q3);
    v.field("q4", s.q4);
    v.field("rollspeed", s.rollspeed);
    v.field("pitchspeed", s.pitchspeed);
    v.field("yawspeed", s.yawspeed);
    v.field("repr_offset_q", s.repr_offset_q);
  }
};

struct LocalPositionNed : MessageInfo<32, 185, 28> {
  static constexpr const char* kName = "LOCAL_POSITION_NED";
  std::uint32_t time_boot_ms = 0;
  float x = 0, y = 0, z = 0, vx = 0, vy = 0, vz = 0;
  static void visit(auto& v, auto& s) {
    v.field("time_boot_ms", s.time_boot_ms);
    v.field("x", s.x);
    v.field("y", s.y);
    v.field("z", s.z);
    v.field("vx", s.vx);
    v.field("vy", s.vy);
    v.field("vz", s.vz);
  }
};

struct GlobalPositionInt : MessageInfo<33, 104, 28> {
  static constexpr const char* kName = "GLOBAL_POSITION_INT";
  std::uint32_t time_boot_ms = 0;
  std::int32_t lat = 0, lon = 0;           ///< [1e-7 degree]
  std::int32_t alt = 0, relative_alt = 0;  ///< [mm]
  std::int16_t vx = 0, vy = 0, vz = 0;     ///< [cm/s]
  std::uint16_t hdg = 0;                   ///< [0.01 degree]
  static void visit(auto& v, auto& s) {
    v.field("time_boot_ms", s.time_boot_ms);
    v.field("lat", s.lat);
    v.field("lon", s.lon);
    v.field("alt", s.alt);
    v.field("relative_alt", s.relative_alt);
    v.field("vx", s.vx);
    v.field("vy", s.vy);
    v.field("vz", s.vz);
    v.field("hdg", s.hdg);
  }
};

struct HighresImu : MessageInfo<105, 93, 63> {
  static constexpr const char* kName = "HIGHRES_IMU";
  std::uint64_t time_usec = 0;
  float xacc = 0, yacc = 0, zacc = 0;     ///< [m/s^2]
  float xgyro = 0, ygyro = 0, zgyro = 0;  ///< [rad/s]
  float xmag = 0, ymag = 0, zmag = 0;     ///< [gauss]
  float abs_pressure = 0, diff_pressure = 0, pressure_alt = 0, temperature = 0;
  std::uint16_t fields_updated = 0;
  std::uint8_t id = 0;
  static void visit(auto& v, auto& s) {
    v.field("time_usec", s.time_usec);
    v.field("xacc", s.xacc);
    v.field("yacc", s.yacc);
    v.field("zacc", s.zacc);
    v.field("xgyro", s.xgyro);
    v.field("ygyro", s.ygyro);
    v.field("zgyro", s.zgyro);
    v.field("xmag", s.xmag);
    v.field("ymag", s.ymag);
    v.field("zmag", s.zmag);
    v.field("abs_pressure", s.abs_pressure);
    v.field("diff_pressure", s.diff_pressure);
    v.field("pressure_alt", s.pressure_alt);
    v.field("temperature", s.temperature);
    v.field("fields_updated", s.fields_updated);
    v.field("id", s.id);
  }
};

struct ScaledImu2 : MessageInfo<116, 76, 24> {
  static constexpr const char* kName = "SCALED_IMU2";
  std::uint32_t time_boot_ms = 0;
  std::int16_t xacc = 0, yacc = 0, zacc = 0, xgyro = 0, ygyro = 0, zgyro = 0, xmag = 0, ymag = 0, zmag = 0;
  std::int16_t temperature = 0;
  static void visit(auto& v, auto& s) {
    v.field("time_boot_ms", s.time_boot_ms);
    v.field("xacc", s.xacc);
    v.field("yacc", s.yacc);
    v.field("zacc", s.zacc);
    v.field("xgyro", s.xgyro);
    v.field("ygyro", s.ygyro);
    v.field("zgyro", s.zgyro);
    v.field("xmag", s.xmag);
    v.field("ymag", s.ymag);
    v.field("zmag", s.zmag);
    v.field("temperature", s.temperature);
  }
};

struct DistanceSensor : MessageInfo<132, 85, 39> {
  static constexpr const char* kName = "DISTANCE_SENSOR";
  std::uint32_t time_boot_ms = 0;
  std::uint16_t min_distance = 0, max_distance = 0, current_distance = 0;  ///< [cm]
  std::uint8_t type = 0, id = 0, orientation = 0, covariance = 0;
  float horizontal_fov = 0, vertical_fov = 0;
  std::array<float, 4> quaternion{};
  std::uint8_t signal_quality = 0;
  static void visit(auto& v, auto& s) {
    v.field("time_boot_ms", s.time_boot_ms);
    v.field("min_distance", s.min_distance);
    v.field("max_distance", s.max_distance);
    v.field("current_distance", s.current_distance);
    v.field("type", s.type);
    v.field("id", s.id);
    v.field("orientation", s.orientation);
    v.field("covariance", s.covariance);
    v.field("horizontal_fov", s.horizontal_fov);
    v.field("vertical_fov", s.vertical_fov);
    v.field("quaternion", s.quaternion);
    v.field("signal_quality", s.signal_quality);
  }
};

}  // namespace godwit::link::mavlink
