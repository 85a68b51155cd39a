// The whole link under a bus of strangers, the tunnel above all: the input is a list of payloads, each sent as a good
// transfer of a chosen type, so that what lies behind the checksums is reached. Whatever comes, parameters stay within
// their limits, and what leaves as a pose is the pose that was put in.
#include <cstdlib>
#include <memory>

#include "firmware_app/link/link_node.h"

namespace {
using namespace godwit;
using namespace godwit::link;

class StrangeBus final : public hal::CanBus {
 public:
  hal::CanSend send(const hal::CanFrame&) override { return hal::CanSend::kSent; }
  bool receive(hal::CanFrame* frame) override {
    if (next == count) return false;
    *frame = frames[next++];
    return true;
  }
  rt::Result<void> set_filters(std::span<const hal::CanFilter>) override { return {}; }
  void maintain(rt::TimeNs) override {}
  hal::CanState state() const override { return hal::CanState::kActive; }
  const hal::CanCounters& counters() const override { return counts; }
  int descriptor() const override { return -1; }
  bool supports_fd() const override { return true; }
  std::uint32_t bit_rate() const override { return 0; }
  const std::vector<std::string>& advice() const override { return none; }
  dronecan::FrameBuffer frames{};
  std::size_t next = 0, count = 0;
  hal::CanCounters counts;
  std::vector<std::string> none;
};

constexpr std::array<dronecan::TypeInfo, 10> kTypes{dronecan::TunnelTargetted::kType,
                                                    dronecan::GetSetRequest::kType,
                                                    dronecan::ExecuteOpcodeRequest::kType,
                                                    dronecan::RestartNodeRequest::kType,
                                                    dronecan::ArmingStatus::kType,
                                                    dronecan::RangeMeasurement::kType,
                                                    dronecan::RawImu::kType,
                                                    dronecan::StaticPressure::kType,
                                                    dronecan::GlobalTimeSync::kType,
                                                    dronecan::BeginFirmwareUpdateRequest::kType};
}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  auto bus = std::make_unique<StrangeBus>();
  Storage storage("");
  auto poses = std::make_unique<rt::TripleBuffer<PoseSample>>();
  auto health = std::make_unique<rt::TripleBuffer<SystemHealth>>();
  auto inputs = std::make_unique<InputRing>();
  auto made =
      LinkNode::create({}, {bus.get(), nullptr, &storage, poses.get(), health.get(), inputs.get(), nullptr}, {});
  if (!made.ok()) std::abort();
  LinkNode& link = *made.value();
  rt::TimeNs now = rt::kNsPerSecond;
  std::uint8_t transfer_id = 0;
  // A few hundred transfers reach every state; longer inputs would only run slower.
  for (int sent = 0; sent < 300 && size >= 2; ++sent) {
    const dronecan::TypeInfo& type = kTypes[data[0] % kTypes.size()];
    const std::size_t take = std::min<std::size_t>({size - 2, data[1], dronecan::kMaxPayload});
    dronecan::Transfer t;
    t.kind = type.kind;
    t.type_id = type.id;
    t.source = (data[0] & 0x80U) != 0 ? 77 : 10;
    t.destination = 42;
    t.fd = (data[0] & 0x40U) != 0;
    t.transfer_id = static_cast<std::uint8_t>(transfer_id++ % 32);
    t.payload = {data + 2, take};
    bus->count = dronecan::to_frames(t, type.signature, &bus->frames);
    bus->next = 0;
    now += 7 * rt::kNsPerMs;
    PoseSample sample;
    sample.t_capture_ns = now - rt::kNsPerMs;
    sample.state = PoseState::kTracking;
    poses->write(sample);
    link.step(now);
    storage.serve();
    data += 2 + take;
    size -= 2 + take;
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
