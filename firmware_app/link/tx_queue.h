// What waits to be sent. Messages leave whole or not at all: when the bus cannot keep up, the oldest pose that has not
// begun gives way to the newest.
#pragma once

#include <array>
#include <cstdint>
#include <memory>

#include "firmware_app/link/dronecan/transfer.h"
#include "hal/can/can_bus.h"

namespace godwit::link {

/// kPose: at most one waits, a newer one replaces it. kFlight: what the autopilot needs (status, tunnel). kService:
/// answers, log texts, telemetry; sent when nothing else waits.
enum class TxClass : std::uint8_t { kPose, kFlight, kService };

struct TxCounters {
  std::uint64_t frames = 0;
  std::uint64_t messages = 0;
  std::uint64_t transfers = 0;
  std::uint64_t poses_replaced = 0;  ///< whole pose messages dropped for a newer one, or because they grew old waiting
  std::uint64_t refused = 0;    ///< whole other messages dropped: the queue was full, or they waited for kMaxWaitNs
  std::uint64_t abandoned = 0;  ///< messages that began and could not be finished within kMaxSendNs
  double bits = 0;              ///< on the wire, with stuffing
};

/// Fixed queue of messages, each one or more transfers or raw frames. One thread, no allocation after construction.
class TxQueue {
 public:
  static constexpr std::size_t kMessageFrames = 64;
  static constexpr std::size_t kMessages = 24;
  static constexpr rt::TimeNs kMaxSendNs = 200 * rt::kNsPerMs;
  static constexpr rt::TimeNs kMaxWaitNs = rt::kNsPerSecond;  ///< for messages other than poses

  explicit TxQueue(double fd_data_rate_factor = 1)
      : slots_(std::make_unique<std::array<Slot, kMessages>>()), fd_factor_(fd_data_rate_factor) {}

  /// Begins a message. False: no room, and it was counted. A pose takes the place of one that waits.
  bool begin(TxClass tx_class, rt::TimeNs now_ns);
  /// Adds a transfer. counter: where the transfer id is taken from when the transfer really leaves (so that dropped
  /// messages leave no gaps); null: transfer.transfer_id stays. False: it did not fit, the message is to be given up.
  bool add(const dronecan::Transfer& transfer, std::uint64_t signature, std::uint8_t* counter);
  bool add_raw(const hal::CanFrame& frame);
  /// Ends the message; an empty or overfull one is dropped. Returns its number, 0 where it was dropped.
  std::uint64_t commit();

  /// Hands frames to the bus until it takes no more, at most max_frames. Returns how many it took.
  std::size_t drain(hal::CanBus& bus, rt::TimeNs now_ns, std::size_t max_frames);
  bool empty() const { return waiting_ == 0; }
  /// Number of the newest pose message whose last frame the bus took, and how many bits it had.
  std::uint64_t last_pose_sent() const { return last_pose_sent_; }
  double last_pose_bits() const { return last_pose_bits_; }
  const TxCounters& counters() const { return counters_; }

 private:
  struct Slot {
    bool used = false;
    TxClass tx_class = TxClass::kService;
    std::uint64_t number = 0;
    rt::TimeNs t_queued_ns = 0;
    std::size_t frames = 0;
    std::size_t sent = 0;
    std::size_t prepared = 0;  // frames that have their transfer id; one more than sent while the bus refuses a frame
    rt::TimeNs t_begun_ns = 0;
    double bits = 0;
    std::array<hal::CanFrame, kMessageFrames> frame{};
    std::array<std::uint8_t*, kMessageFrames> counter{};  // at the first frame of each transfer that takes its id late
  };

  Slot* next_to_send();
  void release(Slot& slot);
  void prepare(Slot* slot);

  std::unique_ptr<std::array<Slot, kMessages>> slots_;
  double fd_factor_;
  dronecan::FrameBuffer scratch_{};
  Slot* building_ = nullptr;
  bool overfull_ = false;
  Slot* sending_ = nullptr;
  std::uint8_t transfer_id_ = 0;  // of the transfer that is leaving
  bool late_transfer_id_ = false;
  std::uint64_t next_number_ = 1;
  std::size_t waiting_ = 0;
  std::uint64_t last_pose_sent_ = 0;
  double last_pose_bits_ = 0;
  TxCounters counters_;
};

}  // namespace godwit::link
