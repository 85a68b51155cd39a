#include "firmware_app/link/inputs.h"

#include <algorithm>
#include <cmath>

#include "firmware_app/link/dronecan/types.h"
#include "firmware_app/link/mavlink/messages.h"

namespace godwit::link {
namespace {

constexpr double kStandardGravity = 9.80665;
constexpr double kMilli = 1e-3;
/// Microseconds since boot are fewer: larger ones are a date, on a clock that nobody compares with ours.
constexpr std::uint64_t kDateUs = 1'000'000'000'000'000;
/// A sigma or variance that is not told.
constexpr double kUnknown = 0;
/// A velocity less sure than this tells nothing [m/s].
constexpr double kMostSpeedSigma = 10;

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
    case ScaledPressure::kId: {
      const auto m = read<ScaledPressure>(raw);
      constexpr double kHectopascal = 100;
      out->kind = InputKind::kPressure;
      out->t_source_us = std::uint64_t{m.time_boot_ms} * 1000;
      out->value = {m.press_abs * kHectopascal, kUnknown, 0, 0, 0, 0, 0};
      return m.press_abs > 0;
    }
    case GpsRawInt::kId: {
      const auto m = read<GpsRawInt>(raw);
      out->kind = InputKind::kSatellites;
      out->t_source_us = m.time_usec < kDateUs ? m.time_usec : 0;
      constexpr std::uint16_t kNotTold = 65535;
      const bool moves = m.vel != kNotTold && m.cog != kNotTold && m.vel_acc != 0;
      const double speed = moves ? m.vel * 0.01 : 0, course = moves ? m.cog * 0.01 * M_PI / 180 : 0;
      out->value = {m.lat * 1e-7,
                    m.lon * 1e-7,
                    m.alt * kMilli,
                    double(m.fix_type),
                    m.h_acc * kMilli,
                    m.v_acc * kMilli,
                    speed * std::sin(course),
                    speed * std::cos(course),
                    moves ? m.vel_acc * kMilli : 0};
      return std::abs(out->value[0]) <= 90 && std::abs(out->value[1]) <= 180;
    }
    default:
      return false;
  }
}

/// Where a range sensor on the bus says that it looks: only straight down is told from the rest.
double looks(const dronecan::RangeMeasurement& m) {
  if (!m.orientation_defined) return kLooksUnknown;
  // Roll, pitch, yaw in steps of 15 degrees; a pitch of -90 is down, whatever the others turn it by.
  return m.roll_pitch_yaw[1] >= -7 && m.roll_pitch_yaw[1] <= -5 ? kLooksDown : kLooksElsewhere;
}

/// The larger of the sigmas of a place, level and up, and of a level velocity, from a covariance of 6 (position,
/// velocity): its diagonal alone, its upper triangle, or the whole. 0: not told.
std::array<double, 3> fix_sigmas(const dronecan::GnssFix2& m) {
  std::array<std::size_t, 5> at{};
  if (m.covariance.size == 6) {
    at = {0, 1, 2, 3, 4};
  } else if (m.covariance.size == 21) {
    at = {0, 6, 11, 15, 18};
  } else if (m.covariance.size == 36) {
    at = {0, 7, 14, 21, 28};
  } else {
    return {kUnknown, kUnknown, kUnknown};
  }
  const auto variance = [&](std::size_t i) { return std::max(0.0, double(m.covariance.item[at[i]])); };
  return {std::sqrt(std::max(variance(0), variance(1))), std::sqrt(variance(2)),
          std::sqrt(std::max(variance(3), variance(4)))};
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
      out->value = {m.range_m, looks(m), 0, 0, 0, 0, 0};
      return true;
    }
    case StaticPressure::kType.id: {
      StaticPressure m;
      if (!read(transfer, &m) || m.pressure_pa <= 0) return false;
      out->kind = InputKind::kPressure;
      out->value = {m.pressure_pa, m.variance_pa2, 0, 0, 0, 0, 0};
      return true;
    }
    case GnssFix2::kType.id: {
      GnssFix2 m;
      if (!read(transfer, &m)) return false;
      out->kind = InputKind::kSatellites;
      const std::array<double, 3> sigma = fix_sigmas(m);
      const double fix = m.status == GnssFix2::k3dFix ? kFix3d : 0;
      out->value = {static_cast<double>(m.latitude_deg_1e8) * 1e-8,
                    static_cast<double>(m.longitude_deg_1e8) * 1e-8,
                    m.height_msl_mm * kMilli,
                    fix,
                    sigma[0],
                    sigma[1],
                    m.ned_velocity[1],
                    m.ned_velocity[0],
                    sigma[2]};
      // Half precision's infinity, or no velocity: the place counts all the same.
      if (!std::isfinite(out->value[6]) || !std::isfinite(out->value[7]) || !(sigma[2] < kMostSpeedSigma))
        out->value[6] = out->value[7] = out->value[8] = 0;
      return std::abs(out->value[0]) <= 90 && std::abs(out->value[1]) <= 180;
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
  out->from_autopilot = true;
  out->source = raw.component;
  return fill(raw, out) && all_finite(*out);
}

bool input_from_dronecan(const dronecan::Transfer& transfer, AutopilotInput* out) {
  *out = AutopilotInput{};
  out->source = transfer.source;
  return fill(transfer, out) && all_finite(*out);
}

}  // namespace godwit::link
