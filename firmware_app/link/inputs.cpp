#include "firmware_app/link/inputs.h"

#include <algorithm>
#include <cmath>

#include "firmware_app/link/dronecan/types.h"
#include "firmware_app/link/mavlink/messages.h"

namespace godwit::link {
namespace {

constexpr double kStandardGravity = 9.80665;
constexpr double kMilli = 1e-3;

bool all_finite(const AutopilotInput& input) {
  return std::all_of(input.value.begin(), input.value.end(), [](double v) { return std::isfinite(v); });
}

template <typename Message>
Message read(const mavlink::RawMessage& raw) {
  Message message;
  mavlink::decode(raw, &message);
  return message;
}

bool fill(const mavlink::RawMessage& raw, AutopilotInput* out) {
  using namespace mavlink;
  switch (raw.id) {
    case AttitudeQuaternion::kId: {
      const auto m = read<AttitudeQuaternion>(raw);
      out->kind = InputKind::kAttitude;
      out->t_source_us = std::uint64_t{m.time_boot_ms} * 1000;
      out->value = {m.q1, m.q2, m.q3, m.q4, m.rollspeed, m.pitchspeed, m.yawspeed};
      const double norm =
          std::hypot(std::hypot(out->value[0], out->value[1]), std::hypot(out->value[2], out->value[3]));
      return std::abs(norm - 1) < 0.05;
    }
    case mavlink::RawImu::kId: {
      const auto m = read<mavlink::RawImu>(raw);
      const double g = kMilli * kStandardGravity;
      out->kind = InputKind::kImu;
      out->sensor = m.id;
      out->t_source_us = m.time_usec;
      out->value = {m.xacc * g, m.yacc * g, m.zacc * g, m.xgyro * kMilli, m.ygyro * kMilli, m.zgyro * kMilli, 0};
      return true;
    }
    case HighresImu::kId: {
      const auto m = read<HighresImu>(raw);
      constexpr unsigned kAccelAndGyro = 0x3F;
      out->kind = InputKind::kImu;
      out->sensor = m.id;
      out->t_source_us = m.time_usec;
      out->value = {m.xacc, m.yacc, m.zacc, m.xgyro, m.ygyro, m.zgyro, 0};
      return (m.fields_updated & kAccelAndGyro) == kAccelAndGyro;
    }
    case DistanceSensor::kId: {
      const auto m = read<DistanceSensor>(raw);
      out->kind = InputKind::kRange;
      out->sensor = m.id;
      out->t_source_us = std::uint64_t{m.time_boot_ms} * 1000;
      out->value = {
          m.current_distance * 0.01, double(m.orientation), m.min_distance * 0.01, m.max_distance * 0.01, 0, 0, 0};
      return m.current_distance >= m.min_distance && m.current_distance <= m.max_distance;
    }
    case LocalPositionNed::kId: {
      const auto m = read<LocalPositionNed>(raw);
      out->kind = InputKind::kLocalPosition;
      out->t_source_us = std::uint64_t{m.time_boot_ms} * 1000;
      out->value = {m.x, m.y, m.z, m.vx, m.vy, m.vz, 0};
      return true;
    }
    case GlobalPositionInt::kId: {
      const auto m = read<GlobalPositionInt>(raw);
      out->kind = InputKind::kGlobalPosition;
      out->t_source_us = std::uint64_t{m.time_boot_ms} * 1000;
      out->value = {m.lat * 1e-7, m.lon * 1e-7, m.alt * kMilli, m.relative_alt * kMilli,
                    m.vx * 0.01,  m.vy * 0.01,  m.vz * 0.01};
      return std::abs(out->value[0]) <= 90 && std::abs(out->value[1]) <= 180;
    }
    default:
      return false;
  }
}

template <typename Message>
bool read(const dronecan::Transfer& transfer, Message* message) {
  return dronecan::decode(transfer.payload, transfer.fd, message);
}

bool fill(const dronecan::Transfer& transfer, AutopilotInput* out) {
  using namespace dronecan;
  switch (transfer.type_id) {
    case RangeMeasurement::kType.id: {
      RangeMeasurement m;
      if (!read(transfer, &m) || m.reading_type != RangeMeasurement::kValidRange || m.range_m < 0) return false;
      out->kind = InputKind::kRange;
      out->sensor = m.sensor_id;
      out->t_source_us = m.timestamp_us;
      out->value = {m.range_m, -1, 0, 0, 0, 0, 0};
      return true;
    }
    case StaticPressure::kType.id: {
      StaticPressure m;
      if (!read(transfer, &m) || m.pressure_pa <= 0) return false;
      out->kind = InputKind::kPressure;
      out->value = {m.pressure_pa, m.variance_pa2, 0, 0, 0, 0, 0};
      return true;
    }
    case dronecan::RawImu::kType.id: {
      dronecan::RawImu m;
      if (!read(transfer, &m)) return false;
      out->kind = InputKind::kImu;
      out->t_source_us = m.timestamp_us;
      out->value = {m.accel[0], m.accel[1], m.accel[2], m.gyro[0], m.gyro[1], m.gyro[2], 0};
      return true;
    }
    case GlobalTimeSync::kType.id: {
      GlobalTimeSync m;
      if (!read(transfer, &m)) return false;
      out->kind = InputKind::kBusTime;
      out->t_source_us = m.previous_transmission_us;
      return true;
    }
    default:
      return false;
  }
}

}  // namespace

bool input_from_mavlink(const mavlink::RawMessage& raw, AutopilotInput* out) {
  *out = AutopilotInput{};
  out->source = raw.component;
  return fill(raw, out) && all_finite(*out);
}

bool input_from_dronecan(const dronecan::Transfer& transfer, AutopilotInput* out) {
  *out = AutopilotInput{};
  out->source = transfer.source;
  return fill(transfer, out) && all_finite(*out);
}

}  // namespace godwit::link
