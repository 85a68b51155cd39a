// The whole link under a bus of strangers, the tunnel above all: the input is a list of payloads, each sent as a good
// transfer of a chosen type by one of several nodes, two of them at a time or one after the other, so that what lies
// behind the checksums is reached. Whatever comes, parameters stay within their limits and only who may sets them,
// another node is not taken for the autopilot, and what leaves as a pose is the pose that was put in.
#include <algorithm>
#include <cstdlib>
#include <memory>
#include <vector>

#include "firmware_app/link/link_node.h"
#include "tests/fuzz/strange_bus.h"

namespace {
using namespace godwit;
using namespace godwit::link;

constexpr std::array<dronecan::TypeInfo, 11> kTypes{dronecan::TunnelTargetted::kType,
                                                    dronecan::GetSetRequest::kType,
                                                    dronecan::ExecuteOpcodeRequest::kType,
                                                    dronecan::RestartNodeRequest::kType,
                                                    dronecan::ArmingStatus::kType,
                                                    dronecan::RangeMeasurement::kType,
                                                    dronecan::RawImu::kType,
                                                    dronecan::StaticPressure::kType,
                                                    dronecan::GlobalTimeSync::kType,
                                                    dronecan::BeginFirmwareUpdateRequest::kType,
                                                    dronecan::NodeStatus::kType};

// The autopilot, two nodes that may write or not, one that has our id, the last and the first that there may be.
constexpr std::array<std::uint8_t, 6> kNodes{10, 100, 77, 42, 125, 1};
constexpr std::uint8_t kAutopilot = 10, kWriter = 100, kOurs = 42;

/// Frames of several senders, as a bus brings them: in the order of each, mixed.
void mix(const std::vector<hal::CanFrame>& a, const std::vector<hal::CanFrame>& b, std::vector<hal::CanFrame>* out) {
  for (std::size_t i = 0; i < std::max(a.size(), b.size()); ++i) {
    if (i < a.size()) out->push_back(a[i]);
    if (i < b.size()) out->push_back(b[i]);
  }
}
}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  auto bus = std::make_unique<StrangeBus>();
  Storage storage("");
  auto poses = std::make_unique<rt::TripleBuffer<PoseSample>>();
  auto health = std::make_unique<rt::TripleBuffer<SystemHealth>>();
  auto inputs = std::make_unique<InputRing>();
  LinkConfig config;
  config.write_rules.only_nodes = {kAutopilot, kWriter};
  auto made =
      LinkNode::create(config, {bus.get(), nullptr, &storage, poses.get(), health.get(), inputs.get(), nullptr}, {});
  if (!made.ok()) std::abort();
  LinkNode& link = *made.value();
  rt::TimeNs now = rt::kNsPerSecond;
  std::uint8_t transfer_id = 0;
  std::vector<hal::CanFrame> held;  // of a transfer that is sent together with the next
  std::uint8_t held_source = 0;     // 0: none
  bool own_id_spoke = false, autopilot_spoke = false, restart_asked = false;
  dronecan::FrameBuffer frames;
  // A few hundred transfers reach every state; longer inputs would only run slower.
  for (int sent = 0; sent < 300 && size >= 3; ++sent) {
    const dronecan::TypeInfo& type = kTypes[(data[0] & 0x1FU) % kTypes.size()];
    const std::size_t take = std::min<std::size_t>({size - 3, data[2], dronecan::kMaxPayload});
    dronecan::Transfer t;
    t.kind = type.kind;
    t.type_id = type.id;
    t.source = kNodes[data[1] % kNodes.size()];
    t.destination = kOurs;
    t.fd = (data[0] & 0x40U) != 0;
    t.transfer_id = static_cast<std::uint8_t>(transfer_id++ % 32);
    t.payload = {data + 3, take};
    const bool hold = (data[0] & 0x20U) != 0 && held_source == 0;
    const std::size_t count = dronecan::to_frames(t, type.signature, &frames);
    const std::vector<hal::CanFrame> own(frames.begin(), frames.begin() + static_cast<std::ptrdiff_t>(count));
    own_id_spoke = own_id_spoke || (t.source == kOurs && type.id == dronecan::NodeStatus::kType.id);
    autopilot_spoke = autopilot_spoke || (t.source == kAutopilot && type.id == dronecan::TunnelTargetted::kType.id);
    data += 3 + take;
    size -= 3 + take;
    if (hold) {
      held = own;
      held_source = t.source;
      continue;
    }
    bus->frames.clear();
    bus->next = 0;
    mix(own, held, &bus->frames);
    const bool may_write =
        t.source == kAutopilot || t.source == kWriter || held_source == kAutopilot || held_source == kWriter;
    held.clear();
    held_source = 0;
    const ParameterValues before = link.parameters().values();
    const bool restart_before = link.restart_due();
    now += 7 * rt::kNsPerMs;
    PoseSample sample;
    sample.t_capture_ns = now - rt::kNsPerMs;
    sample.state = PoseState::kTracking;
    poses->write(sample);
    link.step(now);
    storage.serve();
    // Only who may, sets something; a restart takes 200 ms to come due, so that it is asked for before.
    if (!may_write && link.parameters().values() != before) std::abort();
    restart_asked = restart_asked || may_write;
    if (link.restart_due() && !restart_before && !restart_asked) std::abort();
    if (!own_id_spoke && link.status().own_id_heard) std::abort();
    if (!autopilot_spoke && (link.status().autopilot_alive || link.endpoint().t_attitude_ns() != 0)) std::abort();
    AutopilotInput input;
    while (inputs->try_pop(&input)) {
      for (const double v : input.value) {
        if (!(v - v == 0)) std::abort();
      }
    }
    for (std::size_t i = 0; i < kParameters; ++i) {
      const std::int64_t value = link.parameters().get(static_cast<Parameter>(i));
      if (value < kParameterTable[i].min || value > kParameterTable[i].max) std::abort();
    }
    if (link.status().quality >= 0 || link.status().reset_counter != 0)
      std::abort();  // it was given no scale, no reset
  }
  return 0;
}
