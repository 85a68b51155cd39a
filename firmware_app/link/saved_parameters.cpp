#include "firmware_app/link/saved_parameters.h"

namespace godwit::link {

void drop_what_does_not_fit(const ParameterValues& defaults, const LinkMeans& means, StoredState* state) {
  const auto value = [&](Parameter p) { return state->parameters[static_cast<std::size_t>(p)]; };
  const auto drop = [&](Parameter p, const char* why) {
    const auto i = static_cast<std::size_t>(p);
    if (state->parameters[i] == defaults[i]) return;
    state->warnings.push_back(std::string(info(p).name) + " " + std::to_string(state->parameters[i]) +
                              ", saved over the bus, is not used: " + why + "; " + std::to_string(defaults[i]) +
                              " of the configuration stands");
    state->parameters[i] = defaults[i];
  };
  constexpr std::int64_t kPx4 = 1;
  if (value(Parameter::kProfile) == kPx4 && !means.bytes) {
    drop(Parameter::kProfile, "PX4 takes no MAVLink through CAN, and there is no MAVLink port");
  }
  if (means.bus && !means.fd) {
    if (value(Parameter::kCanFd) != 0) drop(Parameter::kCanFd, "the interface is not set to CAN FD");
    if (value(Parameter::kTelemetryFd) != 0) drop(Parameter::kTelemetryFd, "the interface is not set to CAN FD");
  }
  if (value(Parameter::kNodeId) == value(Parameter::kAutopilotNode)) {
    drop(Parameter::kNodeId, "it is the autopilot's node id");
    if (value(Parameter::kNodeId) == value(Parameter::kAutopilotNode)) {
      drop(Parameter::kAutopilotNode, "it is our own node id");
    }
  }
}

std::vector<std::string> overrides(const ParameterValues& defaults, const StoredState& state) {
  std::vector<std::string> out;
  for (std::size_t i = 0; i < kParameters; ++i) {
    if (!state.has_parameters || state.parameters[i] == defaults[i]) continue;
    out.push_back(std::string(kParameterTable[i].name) + " " + std::to_string(state.parameters[i]) +
                  ", saved over the bus, overrides " + std::to_string(defaults[i]) + " of the configuration");
  }
  return out;
}

}  // namespace godwit::link
