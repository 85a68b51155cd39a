// A bus in memory, and the link on it, with time in the test's hands.
#pragma once

#include <gtest/gtest.h>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "firmware_app/link/link_node.h"

namespace godwit::link {

class FakeBus final : public hal::CanBus {
 public:
  FakeBus() {
    sent.reserve(200000);
    inbox.reserve(200000);
  }
  hal::CanSend send(const hal::CanFrame& frame) override {
    if (state_now != hal::CanState::kActive) {
      ++counts.send_failed;
      return hal::CanSend::kDown;
    }
    if (budget == 0) {
      ++counts.send_full;
      return hal::CanSend::kFull;
    }
    --budget;
    ++counts.sent;
    sent.emplace_back(now, frame);
    return hal::CanSend::kSent;
  }
  bool receive(hal::CanFrame* frame) override {
    if (next == inbox.size()) return false;
    *frame = inbox[next++];
    ++counts.received;
    return true;
  }
  rt::Result<void> set_filters(std::span<const hal::CanFilter> given) override {
    filters.assign(given.begin(), given.end());
    return {};
  }
  void maintain(rt::TimeNs) override {}
  hal::CanState state() const override { return state_now; }
  const hal::CanCounters& counters() const override { return counts; }
  int descriptor() const override { return -1; }
  bool supports_fd() const override { return fd; }
  std::uint32_t bit_rate() const override { return 1'000'000; }
  const std::vector<std::string>& advice() const override { return no_advice; }

  std::vector<std::pair<rt::TimeNs, hal::CanFrame>> sent;
  std::vector<hal::CanFrame> inbox;
  std::size_t next = 0;
  std::size_t budget = SIZE_MAX;    ///< frames taken until the queue is full
  std::size_t budget_per_step = 0;  ///< LinkHarness::step() sets budget to it; 0: leaves it
  hal::CanState state_now = hal::CanState::kActive;
  hal::CanCounters counts;
  std::vector<hal::CanFilter> filters;
  std::vector<std::string> no_advice;
  bool fd = true;
  rt::TimeNs now = 0;
};

constexpr std::uint8_t kTestAutopilot = 10;
constexpr std::uint8_t kTestNode = 42;

inline PoseSample good_pose(rt::TimeNs t_capture_ns) {
  PoseSample s;
  s.t_capture_ns = t_capture_ns;
  s.state = PoseState::kTracking;
  s.has_scale = s.has_gravity = true;
  s.measurements = 120;
  s.map_id = 1;
  s.position = {1 + 1e-9 * static_cast<double>(t_capture_ns % 1000003), 2, 3};
  for (std::size_t i = 0; i < 6; ++i) s.covariance[7 * i] = i < 3 ? 0.01 : 0.0004;
  for (std::size_t i = 0; i < 3; ++i) s.velocity_covariance[4 * i] = 0.01;
  return s;
}

/// The link on a FakeBus; run() steps it every millisecond and gives it a pose every 1 / camera_hz, 5 ms old.
class LinkHarness {
 public:
  explicit LinkHarness(const LinkConfig& config = {}, std::string state = "", const StoredState& stored = {},
                       bool between_pictures = false)
      : storage(std::move(state)) {
    LinkPorts ports{&bus, nullptr, &storage, &poses, &health, &inputs, nullptr};
    if (between_pictures) ports.readings = &readings;
    auto made = LinkNode::create(config, ports, stored);
    EXPECT_TRUE(made.ok()) << (made.ok() ? "" : made.error().message);
    if (made.ok()) link = std::move(made).value();
    decoder = std::make_unique<dronecan::Reassembler>([] {
      std::vector<dronecan::TypeInfo> types;
      dronecan::for_each_type([&]<typename T>() { types.push_back(T::kType); });
      return types;
    }());
    decoder->set_node_id(kTestAutopilot);
  }

  void step() {
    bus.now = now;
    if (bus.budget_per_step > 0) bus.budget = bus.budget_per_step;
    link->step(now);
    if (serve_storage) storage.serve();
    now += rt::kNsPerMs;
  }
  void run(double seconds) {
    const rt::TimeNs end = now + static_cast<rt::TimeNs>(seconds * 1e9);
    while (now < end) {
      if (now >= next_frame + 5 * rt::kNsPerMs) {
        if (camera) {
          poses.write(make_pose(next_frame));
          t_last_pose = now;
        }
        next_frame += static_cast<rt::TimeNs>(1e9 / camera_hz);
      }
      step();
    }
  }

  template <typename T>
  void send(const T& value, dronecan::Transfer t) {
    std::array<std::uint8_t, dronecan::kMaxPayload> payload;
    t.kind = T::kType.kind;
    t.type_id = T::kType.id;
    t.payload = {payload.data(), dronecan::encode(value, payload, t.fd)};
    dronecan::FrameBuffer frames;
    const std::size_t count = dronecan::to_frames(t, T::kType.signature, &frames);
    bus.inbox.insert(bus.inbox.end(), frames.begin(), frames.begin() + static_cast<std::ptrdiff_t>(count));
  }
  template <typename T>
  void request(const T& value) {
    send(value, {.priority = 24,
                 .source = kTestAutopilot,
                 .destination = kTestNode,
                 .transfer_id = static_cast<std::uint8_t>(request_id++ % 32U),
                 .payload = {}});
  }
  /// A MAVLink message through the tunnel, as an autopilot sends it.
  template <typename M>
  void send_mavlink(const M& message) {
    mavlink::MessageBytes bytes;
    const std::size_t size = mavlink::encode(message, &sender, &bytes);
    for (std::size_t at = 0; at < size; at += dronecan::TunnelTargetted::kMaxBuffer) {
      dronecan::TunnelTargetted tunnel;
      tunnel.protocol = 255;
      tunnel.target_node = kTestNode;
      tunnel.buffer.size = std::min(dronecan::TunnelTargetted::kMaxBuffer, size - at);
      std::copy_n(bytes.begin() + static_cast<std::ptrdiff_t>(at), tunnel.buffer.size, tunnel.buffer.item.begin());
      send(tunnel,
           {.source = kTestAutopilot, .transfer_id = static_cast<std::uint8_t>(tunnel_id++ % 32U), .payload = {}});
    }
  }
  void heartbeat(bool is_armed) {
    mavlink::Heartbeat m;
    m.type = 2;
    m.autopilot = 3;
    m.base_mode = is_armed ? mavlink::Heartbeat::kModeArmed : 0;
    send_mavlink(m);
  }

  /// Everything sent since the last call, decoded.
  void decode_sent() {
    for (; decoded < bus.sent.size(); ++decoded) {
      const auto& [t, frame] = bus.sent[decoded];
      dronecan::Transfer transfer;
      if (!decoder->accept(frame, t, &transfer)) continue;
      take(t, transfer);
    }
  }
  template <typename T>
  void keep(const dronecan::Transfer& transfer, rt::TimeNs t, std::vector<std::pair<rt::TimeNs, T>>* into) {
    T value;
    if (transfer.kind != T::kType.kind || transfer.type_id != T::kType.id) return;
    EXPECT_TRUE(dronecan::decode(transfer.payload, transfer.fd, &value));
    into->emplace_back(t, value);
  }
  void take(rt::TimeNs t, const dronecan::Transfer& transfer) {
    keep(transfer, t, &statuses);
    keep(transfer, t, &get_sets);
    keep(transfer, t, &opcodes);
    keep(transfer, t, &restarts);
    keep(transfer, t, &infos);
    dronecan::TunnelTargetted tunnel;
    if (transfer.kind != dronecan::TransferKind::kMessage || transfer.type_id != dronecan::TunnelTargetted::kType.id)
      return;
    EXPECT_TRUE(dronecan::decode(transfer.payload, transfer.fd, &tunnel));
    parser.feed(tunnel.buffer.view(), [&](const mavlink::RawMessage& raw) {
      if (raw.id == mavlink::Odometry::kId) {
        odometry.emplace_back(t, mavlink::Odometry{});
        mavlink::decode(raw, &odometry.back().second);
      }
      if (raw.id == mavlink::StatusText::kId) {
        mavlink::StatusText m;
        mavlink::decode(raw, &m);
        texts.emplace_back(m.text.data(), strnlen(m.text.data(), m.text.size()));
      }
      if (raw.id == mavlink::Timesync::kId) {
        timesyncs.emplace_back(t, mavlink::Timesync{});
        mavlink::decode(raw, &timesyncs.back().second);
      }
    });
  }

  FakeBus bus;
  Storage storage;
  rt::TripleBuffer<PoseSample> poses;
  rt::TripleBuffer<SystemHealth> health;
  InputRing inputs;
  ReadingRing readings;
  std::unique_ptr<LinkNode> link;
  rt::TimeNs now = 1000 * rt::kNsPerSecond;
  rt::TimeNs next_frame = now;
  rt::TimeNs t_last_pose = 0;  ///< when run() gave the last one
  double camera_hz = 30;
  bool camera = true;
  bool serve_storage = true;
  PoseSample (*make_pose)(rt::TimeNs) = good_pose;
  std::uint8_t request_id = 0, tunnel_id = 0;
  mavlink::Sender sender{7, 1, 0};

  std::unique_ptr<dronecan::Reassembler> decoder;
  mavlink::Parser parser;
  std::size_t decoded = 0;
  std::vector<std::pair<rt::TimeNs, mavlink::Odometry>> odometry;
  std::vector<std::pair<rt::TimeNs, mavlink::Timesync>> timesyncs;
  std::vector<std::pair<rt::TimeNs, dronecan::NodeStatus>> statuses;
  std::vector<std::pair<rt::TimeNs, dronecan::GetSetResponse>> get_sets;
  std::vector<std::pair<rt::TimeNs, dronecan::ExecuteOpcodeResponse>> opcodes;
  std::vector<std::pair<rt::TimeNs, dronecan::RestartNodeResponse>> restarts;
  std::vector<std::pair<rt::TimeNs, dronecan::GetNodeInfoResponse>> infos;
  std::vector<std::string> texts;
};

}  // namespace godwit::link
