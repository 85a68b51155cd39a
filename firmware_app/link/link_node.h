// The link as the link thread runs it: poses and health in; DroneCAN node, MAVLink and telemetry out; inputs back.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cstdint>
#include <memory>
#include <string_view>

#include "firmware_app/link/byte_port.h"
#include "firmware_app/link/dronecan/node.h"
#include "firmware_app/link/inputs.h"
#include "firmware_app/link/latency.h"
#include "firmware_app/link/mavlink/endpoint.h"
#include "firmware_app/link/odometry_message.h"
#include "firmware_app/link/parameters.h"
#include "firmware_app/link/pose_departure.h"
#include "firmware_app/link/pose_hold.h"
#include "firmware_app/link/pose_sample.h"
#include "firmware_app/link/storage.h"
#include "firmware_app/link/telemetry.h"
#include "firmware_app/link/tx_queue.h"
#include "hal/can/can_bus.h"
#include "hal/rt/heartbeat.h"
#include "hal/rt/triple_buffer.h"

namespace godwit::link {

/// Why the node is not well: bits of NodeStatus' vendor code.
enum Reason : std::uint16_t {
  kCameraFailed = 1U << 0,
  kImuFailed = 1U << 1,
  kProcessFailed = 1U << 2,
  kPoseStalled = 1U << 3,  ///< no new pose for pose_timeout_ns, or only stale ones
  kNoPose = 1U << 4,       ///< initialising, relocalising or lost
  kNoScale = 1U << 5,
  kNoGravity = 1U << 6,
  kTooHot = 1U << 7,
  kLatencyGrew = 1U << 8,
  kBusTrouble = 1U << 9,    ///< bus-off, gone, or messages dropped in the last second
  kNoAutopilot = 1U << 10,  ///< no HEARTBEAT for 3 s
  kNoTimesync = 1U << 11,
  kDetectorFailed = 1U << 12,
  kSameNodeId = 1U << 14,  ///< another node speaks under our id
  kBadPose = 1U << 13      ///< not finite, huge, or from the future: a fault of ours
};

struct LinkConfig {
  OdometryConfig odometry;
  dronecan::NodeIdentity identity;
  mavlink::EndpointConfig mavlink;
  ParameterValues parameters = fallback_values();
  dronecan::WriteRules write_rules;
  bool imu_required = false;
  /// Silence for longer is an error, told within 100 ms of the last pose: 80, and up to 15 for the way out behind an
  /// ODOMETRY at 1 Mbit/s. A single picture lost at 30 a second (a gap of 67 ms) is none.
  rt::TimeNs pose_timeout_ns = 80 * rt::kNsPerMs;
  /// A pose whose picture is being worked on may take so long. With the two before it the autopilot hears something
  /// every 300 ms, as ArduPilot wants.
  rt::TimeNs late_pose_ns = 150 * rt::kNsPerMs;
  /// A camera that never gave a picture since the start is a failed one, too.
  rt::TimeNs first_pose_timeout_ns = 3 * rt::kNsPerSecond;
  rt::TimeNs max_pose_age_ns = 500 * rt::kNsPerMs;
  float max_temperature_c = 95;
  std::uint32_t assumed_bit_rate = 1'000'000;  ///< for the bus load where the interface does not tell
  double fd_data_rate_factor = 4;
  /// Read after the frames of a pose were handed over, for the latency figures alone; null: step()'s argument stands.
  rt::TimeNs (*clock)() = nullptr;
  /// Threads whose silence is a failure of the process; null: nobody is watched. Outlives the node.
  const rt::Heartbeats* heartbeats = nullptr;
};

/// What the link says of itself to log and display.
struct LinkStatus {
  rt::TimeNs t_ns = 0;
  dronecan::NodeCondition condition;
  std::uint8_t node_id = 0;
  bool armed = false;
  bool autopilot_alive = false;
  std::int8_t quality = -1;
  std::uint8_t reset_counter = 0;
  LatencySummary latency;
  double round_trip_ms = 0;
  bool own_id_heard = false;  ///< another node speaks under our id
  bool synchronised = false;  ///< by TIMESYNC; without it the latency lacks the way to the autopilot
  /// Our own share: from a pose given to the link to its last frame handed to the bus.
  std::size_t own_samples = 0;
  double own_p50_ms = 0;
  double own_p99_ms = 0;
  double own_max_ms = 0;
  double bus_load_percent = 0;  ///< of our own frames over the last second
  std::uint64_t odometry_sent = 0;
  std::uint64_t poses_stale = 0;  ///< given to us late, twice or from the future; never sent as good
  std::uint64_t poses_paced =
      0;  ///< passed over for a newer one: the camera is faster than VIO_RATE, or poses came bunched
  TxCounters tx;
  dronecan::ReassemblyCounters reception;
  hal::CanCounters bus;
  hal::CanState bus_state = hal::CanState::kGone;
  mavlink::EndpointCounters mavlink;
};

/// The link's neighbours; all outlive it. bus or bytes may be null: with bytes MAVLink goes there, else through the
/// tunnel. inputs and status may be null.
struct LinkPorts {
  hal::CanBus* bus = nullptr;
  BytePort* bytes = nullptr;
  Storage* storage = nullptr;
  rt::TripleBuffer<PoseSample>* poses = nullptr;
  rt::TripleBuffer<SystemHealth>* health = nullptr;
  InputRing* inputs = nullptr;
  rt::TripleBuffer<LinkStatus>* status = nullptr;
  DepartureRing* departures = nullptr;  ///< null: nobody measures
};

/// step() belongs to one thread; time is its argument; it does not allocate, lock or block, and its work is bounded.
class LinkNode {
 public:
  /// Reads nothing from disk: `stored` is what Storage::load gave. Error: contradictions in the configuration.
  static rt::Result<std::unique_ptr<LinkNode>> create(const LinkConfig& config, const LinkPorts& ports,
                                                      const StoredState& stored);
  /// Call it when a pose or a frame arrives, and at least every 5 ms.
  void step(rt::TimeNs now_ns);
  /// When the poses that do not come become an error: step() then, so that it is told at once.
  rt::TimeNs t_silence_ns() const {
    const rt::TimeNs t = t_last_pose_ns_ + (any_pose_ ? config_.pose_timeout_ns : config_.first_pose_timeout_ns);
    const rt::TimeNs begun = t_frame_begun_ns_.load(std::memory_order_relaxed);
    return any_pose_ && begun > t_last_pose_ns_ && begun < t ? std::max(t, begun + config_.late_pose_ns) : t;
  }
  /// Tracker thread: a picture is being worked on from now on. Its pose may be late, and that is no silence.
  void frame_begun(rt::TimeNs now_ns) { t_frame_begun_ns_.store(now_ns, std::memory_order_relaxed); }
  /// Any thread: send SET_GPS_GLOBAL_ORIGIN at the next step.
  void request_origin() { origin_requested_.store(true, std::memory_order_relaxed); }
  /// RestartNode was asked for, granted and answered: end the process so that systemd starts it anew.
  bool restart_due() const { return restart_due_; }
  const LinkStatus& status() const { return status_; }
  mavlink::Endpoint& endpoint() { return endpoint_; }
  const dronecan::Node& node() const { return node_; }
  const ParameterSet& parameters() const { return parameters_; }

  static constexpr int kMaxFramesPerStep = 256;

 private:
  // Splits MAVLink frames into uavcan.tunnel.Targetted, or hands them to the byte port.
  class LinkCarrier final : public mavlink::Carrier {
   public:
    explicit LinkCarrier(LinkNode* link) : link_(link) {}
    bool send(std::span<const std::uint8_t> frame, TxClass tx_class, rt::TimeNs now_ns) override;

   private:
    LinkNode* link_;
  };

  LinkNode(const LinkConfig& config, const LinkPorts& ports, const StoredState& stored);
  void receive(rt::TimeNs now_ns);
  void take_transfer(const dronecan::Transfer& transfer, rt::TimeNs now_ns);
  void take_tunnel(const dronecan::Transfer& transfer, rt::TimeNs now_ns);
  bool send_through_tunnel(std::span<const std::uint8_t> frame, TxClass tx_class, rt::TimeNs now_ns);
  void take_pose(rt::TimeNs now_ns);
  bool pose_is_due(const PoseSample& sample);
  void send_pose(const BodyPose& pose, rt::TimeNs t_capture_ns, rt::TimeNs t_published_ns, rt::TimeNs now_ns);
  void send_telemetry(rt::TimeNs now_ns);
  void tell_state(rt::TimeNs now_ns);
  dronecan::NodeCondition condition(rt::TimeNs now_ns) const;
  void account_sent_pose(rt::TimeNs now_ns);
  void each_second(rt::TimeNs now_ns);
  void tell_latency(rt::TimeNs now_ns);
  bool armed(rt::TimeNs now_ns) const;
  void say(mavlink::StatusText::Severity severity, std::string_view text, rt::TimeNs now_ns);
  void set_bus_filters();
  bool stalled(rt::TimeNs now_ns) const { return now_ns >= t_silence_ns(); }

  LinkConfig config_;
  LinkPorts ports_;
  ParameterSet parameters_;
  TxQueue queue_;
  dronecan::Reassembler reassembler_;
  dronecan::Node node_;
  LinkCarrier carrier_;
  mavlink::Endpoint endpoint_;
  LatencyMonitor latency_;
  TimeWindow own_time_;
  std::atomic<bool> origin_requested_{false};  // partner: step(); a flag alone, so relaxed order will do

  PoseSample sample_;  // the newest one taken
  PoseHold hold_;      // what is sent for it
  BodyPose body_;      // the same, as it waits or was sent last
  SystemHealth health_;
  bool started_ = false;
  bool any_pose_ = false;
  bool bad_pose_ = false;
  bool pose_waits_ = false;        // body_ is due and not sent yet
  rt::TimeNs t_last_pose_ns_ = 0;  // arrival of the newest good sample
  rt::TimeNs t_next_due_ns_ = 0;   // capture time from which the next pose is sent
  rt::TimeNs t_last_odometry_ns_ = 0;
  std::uint8_t reset_counter_ = 0;
  std::uint8_t reset_reserved_ = 0;

  std::uint8_t filters_for_node_ = 0;
  std::uint8_t tunnel_transfer_id_ = 0;
  std::uint64_t last_carried_ = 0;  // number of the message the carrier queued last
  std::uint64_t pose_number_ = 0;   // of the pose whose sending is awaited
  struct SentPose {
    rt::TimeNs t_capture_ns = 0;
    rt::TimeNs t_published_ns = 0;  // 0: not known, or it is none of a frame
    std::int8_t quality = -1;
  };
  SentPose sample_sent_;  // the last one given to queue or port
  bool pose_under_way_ = false;
  std::uint8_t telemetry_sequence_ = 0;
  rt::TimeNs t_next_telemetry_ns_ = 0;
  rt::TimeNs t_next_second_ns_ = 0;
  double bits_before_ = 0;
  std::uint64_t drops_before_ = 0;
  bool bus_trouble_ = false;
  std::atomic<rt::TimeNs> t_frame_begun_ns_{0};  // tracker -> step(); relaxed, a time alone
  rt::TimeNs t_last_stamp_ns_ = 0;               // of the ODOMETRY sent last
  bool arming_status_armed_ = false;
  rt::TimeNs t_arming_status_ns_ = 0;
  PoseState told_state_ = PoseState::kInitialising;
  bool told_metric_ = false;
  rt::TimeNs t_told_ns_ = 0;
  bool told_growth_ = false;
  rt::TimeNs t_next_latency_text_ns_ = 0;
  bool restart_due_ = false;
  LinkStatus status_;
};

}  // namespace godwit::link
