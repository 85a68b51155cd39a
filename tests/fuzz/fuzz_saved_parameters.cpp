// A file of saved parameters that anybody may have written. The first byte says what the link has and what the
// configuration asks for. Whatever the text: values stay within their limits, what contradicts the configuration is
// dropped, the node starts, and what is saved reads back as the same.
#include <cstdlib>
#include <memory>
#include <string>

#include "firmware_app/link/link_node.h"
#include "firmware_app/link/saved_parameters.h"
#include "tests/fuzz/strange_bus.h"

namespace {
using namespace godwit;
using namespace godwit::link;

class NoPort final : public BytePort {
 public:
  bool send(std::span<const std::uint8_t>, TxClass) override { return true; }
  void flush() override {}
  std::size_t receive(std::span<std::uint8_t>) override { return 0; }
  int descriptor() const override { return -1; }
  void maintain(rt::TimeNs) override {}
  bool gone() const override { return false; }
};

void check(bool holds) {
  if (!holds) std::abort();
}

std::int64_t& at(ParameterValues* values, Parameter p) {
  return (*values)[static_cast<std::size_t>(p)];
}
}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const LinkMeans means{true, (data[0] & 1U) != 0, (data[0] & 2U) != 0};
  LinkConfig config;
  at(&config.parameters, Parameter::kNodeId) = (data[0] & 4U) != 0 ? 0 : 42;
  at(&config.parameters, Parameter::kRequirePose) = (data[0] & 8U) != 0 ? 1 : 0;
  const std::string text(reinterpret_cast<const char*>(data + 1), size - 1);

  StoredState state;
  state.parameters = config.parameters;
  read_saved_parameters("p.txt", text, &state);
  for (const std::string& warning : state.warnings) check(warning.find("p.txt:") == 0);
  drop_what_does_not_fit(config.parameters, means, &state);
  for (std::size_t i = 0; i < kParameters; ++i) {
    check(state.parameters[i] >= kParameterTable[i].min && state.parameters[i] <= kParameterTable[i].max);
    check(state.has_parameters || state.parameters[i] == config.parameters[i]);
  }
  check(at(&state.parameters, Parameter::kSendOrigin) == 0);

  auto bus = std::make_unique<StrangeBus>();
  bus->fd = means.fd;
  NoPort port;
  Storage storage("");
  auto poses = std::make_unique<rt::TripleBuffer<PoseSample>>();
  auto health = std::make_unique<rt::TripleBuffer<SystemHealth>>();
  auto made = LinkNode::create(
      config, {bus.get(), means.bytes ? &port : nullptr, &storage, poses.get(), health.get(), nullptr, nullptr}, state);
  check(made.ok());  // nothing that was saved grounds the node
  made.value()->step(rt::kNsPerSecond);
  check(made.value()->parameters().values() == state.parameters);

  StoredState again;
  again.parameters = config.parameters;
  read_saved_parameters("again.txt", saved_parameters_text(state.parameters, config.parameters), &again);
  check(again.warnings.empty() && again.parameters == state.parameters);
  return 0;
}
