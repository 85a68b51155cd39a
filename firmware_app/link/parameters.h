// The parameters that a ground station may read and set over the bus (uavcan.protocol.param.GetSet), each with its
// limits. Nothing else of the configuration can be reached from the bus.
#pragma once

#include <array>
#include <cstdint>
#include <string_view>

namespace godwit::link {

enum class Parameter : std::uint8_t {
  kRate,
  kNodeId,
  kSystemId,
  kProfile,
  kAutopilotNode,
  kSerialIndex,
  kBaudRate,
  kCanFd,
  kTelemetryRate,
  kTelemetryBase,
  kTelemetryFd,
  kRequirePose,
  kSendOrigin,
  kCount
};
constexpr std::size_t kParameters = static_cast<std::size_t>(Parameter::kCount);

enum class ParameterType : std::uint8_t { kInteger, kBoolean };

struct ParameterInfo {
  const char* name;
  ParameterType type;
  std::int64_t min;
  std::int64_t max;
  std::int64_t fallback;  ///< default where the configuration says nothing
  bool restart;           ///< takes effect after a restart only
  const char* what;
};

/// In the order of Parameter, which is the index on the bus. Names have at most 16 characters, as ground stations
/// expect.
inline constexpr std::array<ParameterInfo, kParameters> kParameterTable{{
    {"VIO_RATE", ParameterType::kInteger, 20, 40, 30, false, "ODOMETRY messages a second"},
    {"VIO_NODE_ID", ParameterType::kInteger, 0, 125, 42, true, "DroneCAN node id, 0: ask an allocator"},
    {"VIO_SYSID", ParameterType::kInteger, 0, 255, 0, true, "MAVLink system id, 0: that of the autopilot"},
    {"VIO_PROFILE", ParameterType::kInteger, 0, 1, 0, true, "0 ardupilot, 1 px4"},
    {"VIO_AP_NODE", ParameterType::kInteger, 1, 125, 10, true, "DroneCAN node id of the autopilot"},
    {"VIO_SER_IDX", ParameterType::kInteger, 0, 15, 0, true, "serial id in the tunnel, CAN_D1_UC_S1_IDX"},
    {"VIO_BAUD", ParameterType::kInteger, 9600, 12500000, 921600, true, "baud rate the tunnel names"},
    {"VIO_CANFD", ParameterType::kBoolean, 0, 1, 0, true, "send CAN FD frames"},
    {"VIO_TEL_RATE", ParameterType::kInteger, 0, 50, 10, false, "telemetry snapshots a second, 0: none"},
    {"VIO_TEL_BASE", ParameterType::kInteger, 0, 0x7F0, 0x300, true, "first 11-bit id of the telemetry frames"},
    {"VIO_TEL_FD", ParameterType::kBoolean, 0, 1, 0, true, "telemetry as one CAN FD frame"},
    {"VIO_REQ_POSE", ParameterType::kBoolean, 0, 1, 0, false, "refuse arming (node health) without a pose"},
    {"VIO_SET_ORIGIN", ParameterType::kBoolean, 0, 1, 0, false, "write 1: send SET_GPS_GLOBAL_ORIGIN once"},
}};

constexpr const ParameterInfo& info(Parameter p) {
  return kParameterTable[static_cast<std::size_t>(p)];
}

using ParameterValues = std::array<std::int64_t, kParameters>;

/// The values of kParameterTable's defaults.
constexpr ParameterValues fallback_values() {
  ParameterValues values{};
  for (std::size_t i = 0; i < kParameters; ++i) values[i] = kParameterTable[i].fallback;
  return values;
}

/// Values in force. A value outside its limits never gets in. One thread, no allocation.
class ParameterSet {
 public:
  /// defaults: what the configuration says; now: what was saved. Values outside their limits give way to the fallback.
  ParameterSet(const ParameterValues& defaults, const ParameterValues& now);
  std::int64_t get(Parameter p) const { return values_[static_cast<std::size_t>(p)]; }
  std::int64_t default_of(Parameter p) const { return defaults_[static_cast<std::size_t>(p)]; }
  /// False where the value is outside its limits; then nothing changed.
  bool set(Parameter p, std::int64_t value);
  void restore_defaults() { values_ = defaults_; }
  const ParameterValues& values() const { return values_; }
  /// kCount where there is none of this name.
  static Parameter find(std::string_view name);

 private:
  ParameterValues defaults_;
  ParameterValues values_;
};

}  // namespace godwit::link
