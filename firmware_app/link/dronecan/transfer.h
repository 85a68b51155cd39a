// DroneCAN transfers as CAN frames, and back. Sources: DroneCAN specification 4.1 (transport layer); the rules on
// acceptance follow its section on transfer reception.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "firmware_app/link/dronecan/type_info.h"
#include "hal/can/can_frame.h"
#include "hal/rt/time.h"

namespace godwit::link::dronecan {

using hal::CanFrame;

constexpr std::uint8_t kMaxNodeId = 127;
constexpr std::size_t kMaxPayload = 384;                               ///< longest of our types: GetNodeInfo's answer
constexpr std::size_t kMaxTransferFrames = (kMaxPayload + 2 + 6) / 7;  ///< on classic CAN
constexpr rt::TimeNs kTransferTimeoutNs = 2 * rt::kNsPerSecond;

/// A whole transfer. The payload belongs to whoever made it.
struct Transfer {
  TransferKind kind = TransferKind::kMessage;
  std::uint16_t type_id = 0;
  std::uint8_t priority = 16;
  std::uint8_t source = 0;       ///< 0: anonymous
  std::uint8_t destination = 0;  ///< services only
  std::uint8_t transfer_id = 0;
  bool fd = false;
  std::span<const std::uint8_t> payload;
};

/// 29-bit identifier of a transfer with a source; for an anonymous one with the discriminator of its payload.
std::uint32_t can_id(const Transfer& transfer);

/// The initial value of a transfer's CRC: the type's signature, least significant byte first.
std::uint16_t signature_crc(std::uint64_t signature);

using FrameBuffer = std::array<CanFrame, kMaxTransferFrames>;

/// Splits a transfer into frames; returns their number. 0 where it cannot be sent: payload above kMaxPayload, an
/// anonymous transfer of more than one frame or of another kind than message. CAN FD: zeros fill the last frame to a
/// length that exists, and are part of the CRC. No allocation.
std::size_t to_frames(const Transfer& transfer, std::uint64_t signature, FrameBuffer* out);

/// How reception went, since the start.
struct ReassemblyCounters {
  std::uint64_t frames = 0;        ///< looked at
  std::uint64_t transfers = 0;     ///< delivered
  std::uint64_t foreign = 0;       ///< 11-bit, for others, of types we do not take: no error
  std::uint64_t malformed = 0;     ///< no tail byte, impossible flags or lengths
  std::uint64_t missed_start = 0;  ///< a later frame without its first one
  std::uint64_t wrong_toggle = 0;  ///< a frame was lost or reordered: transfer given up
  std::uint64_t wrong_transfer_id = 0;
  std::uint64_t bad_crc = 0;
  std::uint64_t too_long = 0;
  std::uint64_t timed_out = 0;  ///< given up because the rest did not come within 2 s
  std::uint64_t aborted = 0;    ///< given up because the sender began anew
  std::uint64_t evicted = 0;    ///< given up because too many transfers were open at once
  std::uint64_t repeated = 0;   ///< repeated frames and transfers, passed over: no error

  std::uint64_t errors() const {
    return malformed + missed_start + wrong_toggle + wrong_transfer_id + bad_crc + too_long + timed_out + aborted +
           evicted;
  }
};

/// Puts transfers together again. Bounded work and no allocation per frame. One thread.
class Reassembler {
 public:
  /// accepted: the types to take; everything else is passed over.
  explicit Reassembler(std::vector<TypeInfo> accepted);

  /// Service transfers are taken only for this node; 0 (no id yet): none.
  void set_node_id(std::uint8_t node_id) { node_id_ = node_id; }
  /// The half-received transfers of this node are never given up for those of others, so that a flood of foreign
  /// senders cannot silence the autopilot.
  void protect_source(std::uint8_t node_id) { protected_source_ = node_id; }

  /// Takes a frame. True where it completed a transfer: *out then holds it, its payload valid until the next call.
  bool accept(const CanFrame& frame, rt::TimeNs now_ns, Transfer* out);

  const ReassemblyCounters& counters() const { return counters_; }
  static constexpr std::size_t kSessions = 64;

 private:
  static constexpr std::size_t kBuffer = kMaxPayload + hal::kFdCanBytes;
  struct Session {
    bool used = false;
    bool open = false;  // first frame seen, last one not yet
    bool fd = false;
    bool toggle = false;           // that the next frame must have
    std::uint8_t transfer_id = 0;  // of the open transfer, or the one expected next
    std::uint8_t last_length = 0;
    std::uint32_t key = 0;
    rt::TimeNs t_last_ns = 0;
    std::size_t size = 0;
    std::array<std::uint8_t, hal::kFdCanBytes> last{};  // newest frame, to know a repetition from a loss
    std::array<std::uint8_t, kBuffer> buffer{};
  };

  const TypeInfo* find_type(TransferKind kind, std::uint16_t id) const;
  Session* find_session(std::uint32_t key, std::uint8_t source);
  bool start(Session& session, const CanFrame& frame, rt::TimeNs now_ns);
  bool append(Session& session, const CanFrame& frame, const TypeInfo& type);
  void give_up(Session& session, std::uint64_t* counter);

  std::vector<TypeInfo> accepted_;
  std::uint8_t node_id_ = 0;
  std::uint8_t protected_source_ = 0;
  ReassemblyCounters counters_;
  std::vector<Session> sessions_;
};

}  // namespace godwit::link::dronecan
