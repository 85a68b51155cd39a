// The link as the link thread runs it: poses and health in; DroneCAN node, MAVLink and telemetry out; inputs back. It
// only binds its parts together: when poses leave (pose_pacing), what is sent without one (pose_hold), when silence is
// an error (pose_watch), how the node is (condition), what is said in words (status_texts), what sending costs
// (bus_account).
#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include "firmware_app/link/arming_watch.h"
#include "firmware_app/link/bus_account.h"
#include "firmware_app/link/bus_filters.h"
#include "firmware_app/link/byte_port.h"
#include "firmware_app/link/condition.h"
#include "firmware_app/link/dronecan_node.h"
#include "firmware_app/link/inputs.h"
#include "firmware_app/link/latency.h"
#include "firmware_app/link/mavlink_carrier.h"
#include "firmware_app/link/mavlink_endpoint.h"
#include "firmware_app/link/odometry_message.h"
#include "firmware_app/link/parameters.h"
#include "firmware_app/link/pose_carrier.h"
#include "firmware_app/link/pose_departure.h"
#include "firmware_app/link/pose_hold.h"
#include "firmware_app/link/pose_pacing.h"
#include "firmware_app/link/pose_sample.h"
#include "firmware_app/link/pose_watch.h"
#include "firmware_app/link/reset_counter.h"
#include "firmware_app/link/status_texts.h"
#include "firmware_app/link/storage.h"
#include "firmware_app/link/telemetry.h"
#include "firmware_app/link/tx_queue.h"
#include "hal/can/can_bus.h"
#include "hal/rt/heartbeat.h"
#include "hal/rt/triple_buffer.h"

namespace godwit::link {

struct LinkConfig {
  OdometryConfig odometry;
  dronecan::NodeIdentity identity;
  mavlink::EndpointConfig mavlink;
  ParameterValues parameters = fallback_values();
  dronecan::WriteRules write_rules;
  bool imu_required = false;
  PosePatience patience;
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
  bool own_id_heard = false;  ///< another node speaks under our id, or did within kNodeGoneNs
  bool synchronised = false;  ///< by TIMESYNC; without it the latency lacks the way to the autopilot
  /// Our own share: from a pose given to the link to its last frame handed to the bus.
  std::size_t own_samples = 0;
  double own_p50_ms = 0;
  double own_p99_ms = 0;
  double own_max_ms = 0;
  bool has_bus = false;
  double bus_load_percent = 0;  ///< of our own frames over the last second
  std::uint64_t odometry_sent = 0;
  std::uint64_t poses_stale = 0;  ///< given to us late, twice or from the future; never sent as good
  /// Passed over for a newer one: the camera is faster than VIO_RATE, or poses came bunched.
  std::uint64_t poses_paced = 0;
  std::uint64_t poses_carried = 0;      ///< sent for a time at which there was no picture
  std::uint64_t readings_missed = 0;    ///< of the inertial sensor, for carrying alone
  std::uint64_t pictures_repeated = 0;  ///< the one before, bit for bit: nothing was sent for them
  TxCounters tx;
  dronecan::ReassemblyCounters reception;
  hal::CanCounters bus;
  hal::CanState bus_state = hal::CanState::kGone;
  bool port_gone = false;  ///< the MAVLink port is not there; it is looked for
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
  /// Poses go out for the newest reading's time, between pictures, too; null: at pictures alone, for theirs.
  ReadingRing* readings = nullptr;
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
  rt::TimeNs t_silence_ns() const { return watch_.t_silence_ns(); }
  /// Tracker thread: a picture is being worked on from now on. Its pose may be late, and that is no silence.
  void frame_begun(rt::TimeNs now_ns) { watch_.frame_begun(now_ns); }
  /// Tracker thread: it was the picture before once more, and the odometry's state stands. The autopilot hears nothing.
  void picture_repeated(rt::TimeNs now_ns) { watch_.picture_repeated(now_ns); }
  /// RestartNode was asked for, granted and answered: end the process so that systemd starts it anew.
  bool restart_due() const { return restart_due_; }
  const LinkStatus& status() const { return status_; }
  mavlink::Endpoint& endpoint() { return endpoint_; }
  const dronecan::Node& node() const { return node_; }
  const ParameterSet& parameters() const { return parameters_; }

  static constexpr int kMaxFramesPerStep = 256;
  /// A node that has not spoken for so long is none (UAVCAN's NodeStatus.OFFLINE_TIMEOUT_MS).
  static constexpr rt::TimeNs kNodeGoneNs = 3 * rt::kNsPerSecond;

 private:
  LinkNode(const LinkConfig& config, const LinkPorts& ports, const StoredState& stored);
  void receive(rt::TimeNs now_ns);
  void take_transfer(const dronecan::Transfer& transfer, rt::TimeNs now_ns);
  void take_sample(const PoseSample& sample, rt::TimeNs now_ns);
  void offer(const PoseSample& sample, rt::TimeNs now_ns);
  void carry_on(rt::TimeNs now_ns);
  void move_poses(rt::TimeNs now_ns);
  void send_pose(rt::TimeNs t_stamp_ns, rt::TimeNs t_published_ns, rt::TimeNs now_ns);
  void send_origin(rt::TimeNs now_ns);
  void send_telemetry(rt::TimeNs now_ns);
  void say(const std::optional<StatusLine>& line, rt::TimeNs now_ns);
  Reasons reasons(rt::TimeNs now_ns) const;
  void account_sent_pose(rt::TimeNs now_ns);
  void each_second(rt::TimeNs now_ns);
  void fill_status(rt::TimeNs now_ns);
  bool armed(rt::TimeNs now_ns) const;
  rt::TimeNs period_ns() const { return rt::kNsPerSecond / parameters_.get(Parameter::kRate); }

  LinkConfig config_;
  LinkPorts ports_;
  ParameterSet parameters_;
  TxQueue queue_;
  dronecan::Reassembler reassembler_;
  dronecan::Node node_;
  MavlinkCarrier carrier_;
  mavlink::Endpoint endpoint_;
  BusFilters filters_;
  ArmingWatch arming_;
  PoseWatch watch_;
  PosePacing pacing_;
  PoseHold hold_;  // what is sent for the newest sample
  ResetCounter resets_;
  StatusTexts texts_;
  TelemetrySender telemetry_;
  BusAccount account_;

  std::unique_ptr<PoseCarrier> between_;  // null: nothing goes out between pictures
  PoseSample sample_;                     // the newest one taken
  rt::TimeNs t_held_ns_ = 0;              // the time that hold_'s pose refers to
  rt::TimeNs t_given_ns_ = 0;             // when it was given to us; 0: it was carried on
  SystemHealth health_;
  bool started_ = false;
  bool bad_pose_ = false;
  bool pose_waits_ = false;  // hold_'s pose is due and not sent yet
  rt::TimeNs t_next_second_ns_ = 0;
  bool restart_due_ = false;
  rt::TimeNs t_own_id_ns_ = 0;  // when another node spoke under our id; 0: never
  LinkStatus status_;
};

}  // namespace godwit::link
