// The DroneCAN data types of sensors and of the vehicle. Field names and order are those of the DSDL definitions
// (dronecan/DSDL); a test recomputes each signature and length from their text.
#pragma once

#include <array>
#include <cstdint>

#include "firmware_app/link/dronecan/codec.h"
#include "firmware_app/link/dronecan/type_info.h"

namespace godwit::link::dronecan {

struct RangeMeasurement {
  static constexpr TypeInfo kType{"uavcan.equipment.range_sensor.Measurement", TransferKind::kMessage, 1050,
                                  0x68FFFE70FC771952, 15};
  static constexpr std::uint8_t kValidRange = 1;
  std::uint64_t timestamp_us = 0;
  std::uint8_t sensor_id = 0;
  std::array<std::int8_t, 3> roll_pitch_yaw{};  ///< [pi / 12 rad]
  bool orientation_defined = false;
  float field_of_view_rad = 0;
  std::uint8_t sensor_type = 0;
  std::uint8_t reading_type = 0;
  float range_m = 0;
  static void visit(auto& v, auto& s) {
    v.number("timestamp", s.timestamp_us, 56, Cast::kTruncated);
    v.number("sensor_id", s.sensor_id, 8);
    for (auto& angle : s.roll_pitch_yaw) v.number("fixed_axis_roll_pitch_yaw", angle, 5);
    v.boolean("orientation_defined", s.orientation_defined);
    v.half("field_of_view", s.field_of_view_rad);
    v.number("sensor_type", s.sensor_type, 5);
    v.number("reading_type", s.reading_type, 3);
    v.half("range", s.range_m);
  }
};

struct FlowMeasurement {
  static constexpr TypeInfo kType{"com.hex.equipment.flow.Measurement", TransferKind::kMessage, 20200,
                                  0x6A908866BCB49C18, 21};
  float interval_s = 0;
  std::array<float, 2> gyro_integral{};
  std::array<float, 2> flow_integral{};
  std::uint8_t quality = 0;
  static void visit(auto& v, auto& s) {
    v.single("integration_interval", s.interval_s);
    for (auto& x : s.gyro_integral) v.single("rate_gyro_integral", x);
    for (auto& x : s.flow_integral) v.single("flow_integral", x);
    v.number("quality", s.quality, 8);
  }
};

struct RawImu {
  static constexpr TypeInfo kType{"uavcan.equipment.ahrs.RawIMU", TransferKind::kMessage, 1003, 0x8280632C40E574B5,
                                  120};
  std::uint64_t timestamp_us = 0;
  float interval_s = 0;
  std::array<float, 3> gyro{};            ///< latest [rad/s], front-right-down
  std::array<float, 3> gyro_integral{};   ///< [rad]
  std::array<float, 3> accel{};           ///< latest [m/s^2], front-right-down
  std::array<float, 3> accel_integral{};  ///< [m/s]
  List<float, 36> covariance;
  static void visit(auto& v, auto& s) {
    v.number("timestamp", s.timestamp_us, 56, Cast::kTruncated);
    v.single("integration_interval", s.interval_s);
    for (auto& x : s.gyro) v.half("rate_gyro_latest", x);
    for (auto& x : s.gyro_integral) v.single("rate_gyro_integral", x);
    for (auto& x : s.accel) v.half("accelerometer_latest", x);
    for (auto& x : s.accel_integral) v.single("accelerometer_integral", x);
    v.list("covariance", s.covariance, Tail::kYes, 16, [](auto& w, auto& x) { w.half("covariance", x); });
  }
};

struct AhrsSolution {
  static constexpr TypeInfo kType{"uavcan.equipment.ahrs.Solution", TransferKind::kMessage, 1000, 0x72A63A3C6F41FA9B,
                                  84};
  std::uint64_t timestamp_us = 0;
  std::array<float, 4> orientation_xyzw{};
  List<float, 9> orientation_covariance;
  std::array<float, 3> angular_velocity{};
  List<float, 9> angular_velocity_covariance;
  std::array<float, 3> linear_acceleration{};
  List<float, 9> linear_acceleration_covariance;
  static void visit(auto& v, auto& s) {
    v.number("timestamp", s.timestamp_us, 56, Cast::kTruncated);
    for (auto& x : s.orientation_xyzw) v.half("orientation_xyzw", x);
    v.padding(4);
    v.list("orientation_covariance", s.orientation_covariance, Tail::kNo, 16,
           [](auto& w, auto& x) { w.half("orientation_covariance", x); });
    for (auto& x : s.angular_velocity) v.half("angular_velocity", x);
    v.padding(4);
    v.list("angular_velocity_covariance", s.angular_velocity_covariance, Tail::kNo, 16,
           [](auto& w, auto& x) { w.half("angular_velocity_covariance", x); });
    for (auto& x : s.linear_acceleration) v.half("linear_acceleration", x);
    v.list("linear_acceleration_covariance", s.linear_acceleration_covariance, Tail::kYes, 16,
           [](auto& w, auto& x) { w.half("linear_acceleration_covariance", x); });
  }
};

struct StaticPressure {
  static constexpr TypeInfo kType{"uavcan.equipment.air_data.StaticPressure", TransferKind::kMessage, 1028,
                                  0xCDC7C43412BDC89A, 6};
  float pressure_pa = 0;
  float variance_pa2 = 0;
  static void visit(auto& v, auto& s) {
    v.single("static_pressure", s.pressure_pa);
    v.half("static_pressure_variance", s.variance_pa2);
  }
};

/// The first part of uavcan.equipment.gnss.Fix2: what is behind it (an optional place in earth-centred axes) is let be,
/// so it can be read and not sent.
struct GnssFix2 {
  static constexpr TypeInfo kType{"uavcan.equipment.gnss.Fix2", TransferKind::kMessage, 1063, 0xCA41E7000F37435F, 222};
  static constexpr std::uint8_t k3dFix = 3;
  std::uint64_t timestamp_us = 0, gnss_timestamp_us = 0;
  std::uint8_t gnss_time_standard = 0, num_leap_seconds = 0;
  std::int64_t longitude_deg_1e8 = 0, latitude_deg_1e8 = 0;
  std::int32_t height_ellipsoid_mm = 0, height_msl_mm = 0;
  std::array<float, 3> ned_velocity{};  ///< [m/s]
  std::uint8_t sats_used = 0, status = 0, mode = 0, sub_mode = 0;
  List<float, 36> covariance;  ///< of (position [m^2], velocity), NED: diagonal, upper triangle or all of it
  float pdop = 0;
  static void visit(auto& v, auto& s) {
    v.number("timestamp", s.timestamp_us, 56, Cast::kTruncated);
    v.number("gnss_timestamp", s.gnss_timestamp_us, 56, Cast::kTruncated);
    v.number("gnss_time_standard", s.gnss_time_standard, 3);
    v.padding(13);
    v.number("num_leap_seconds", s.num_leap_seconds, 8);
    v.number("longitude_deg_1e8", s.longitude_deg_1e8, 37);
    v.number("latitude_deg_1e8", s.latitude_deg_1e8, 37);
    v.number("height_ellipsoid_mm", s.height_ellipsoid_mm, 27);
    v.number("height_msl_mm", s.height_msl_mm, 27);
    for (auto& x : s.ned_velocity) v.single("ned_velocity", x);
    v.number("sats_used", s.sats_used, 6);
    v.number("status", s.status, 2);
    v.number("mode", s.mode, 4);
    v.number("sub_mode", s.sub_mode, 6);
    v.list("covariance", s.covariance, Tail::kNo, 16, [](auto& w, auto& x) { w.half("covariance", x); });
    v.half("pdop", s.pdop);
  }
};

struct GlobalTimeSync {
  static constexpr TypeInfo kType{"uavcan.protocol.GlobalTimeSync", TransferKind::kMessage, 4, 0x20271116A793C2DB, 7};
  std::uint64_t previous_transmission_us = 0;
  static void visit(auto& v, auto& s) {
    v.number("previous_transmission_timestamp_usec", s.previous_transmission_us, 56, Cast::kTruncated);
  }
};

struct ArmingStatus {
  static constexpr TypeInfo kType{"uavcan.equipment.safety.ArmingStatus", TransferKind::kMessage, 1100,
                                  0x8700F375556A8003, 1};
  static constexpr std::uint8_t kFullyArmed = 255;
  std::uint8_t status = 0;
  static void visit(auto& v, auto& s) { v.number("status", s.status, 8); }
};

}  // namespace godwit::link::dronecan
