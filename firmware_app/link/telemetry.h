// Telemetry on the same bus in plain 11-bit frames, for anything that decodes a DBC (config/godwit.dbc): either seven
// classic frames from a base identifier, or one CAN FD frame of 64 bytes. A sequence number in the first byte of each
// binds the frames of one snapshot together. Little-endian ("Intel") throughout.
#pragma once

#include <array>
#include <cstdint>

#include "firmware_app/link/odometry_message.h"
#include "firmware_app/link/parameters.h"
#include "firmware_app/link/pose_sample.h"
#include "firmware_app/link/tx_queue.h"
#include "hal/can/can_frame.h"

namespace godwit::link {

/// What one snapshot says.
struct TelemetrySnapshot {
  PoseState state = PoseState::kInitialising;
  bool has_scale = false;
  bool has_gravity = false;
  std::uint8_t reset_counter = 0;
  std::uint16_t map_id = 0;
  rt::TimeNs t_capture_ns = 0;
  rt::TimeNs age_ns = 0;  ///< since capture, when the snapshot was taken
  float temperature_c = 0;
  bool throttled = false;  ///< the machine slows its processors down
  BodyPose pose;
};

constexpr std::size_t kTelemetryFrames = 7;
/// Offset of the FD frame's identifier from the base.
constexpr std::uint32_t kTelemetryFdOffset = 8;

/// STATUS, TIME, POSITION_XY, POSITION_Z, VELOCITY, ATTITUDE, SIGMA with identifiers base to base + 6.
std::array<hal::CanFrame, kTelemetryFrames> telemetry_frames(const TelemetrySnapshot& snapshot, std::uint8_t sequence,
                                                             std::uint32_t base_id);
/// The same as one CAN FD frame with identifier base + 8.
hal::CanFrame telemetry_fd_frame(const TelemetrySnapshot& snapshot, std::uint8_t sequence, std::uint32_t base_id);

/// Sends snapshots as VIO_TEL_RATE, _BASE and _FD say. One thread; no allocation.
class TelemetrySender {
 public:
  /// True where a snapshot is due, which send() is then to be given.
  bool due(const ParameterSet& parameters, rt::TimeNs now_ns);
  void send(const TelemetrySnapshot& snapshot, const ParameterSet& parameters, TxQueue* queue, rt::TimeNs now_ns);

 private:
  std::uint8_t sequence_ = 0;
  rt::TimeNs t_next_ns_ = 0;
};

}  // namespace godwit::link
