#include "firmware_app/link/saved_parameters.h"

#include <charconv>
#include <sstream>
#include <system_error>

namespace godwit::link {

void read_saved_parameters(const std::string& path, const std::string& text, StoredState* state) {
  std::istringstream in(text);
  std::string line;
  for (int number = 1; std::getline(in, line); ++number) {
    if (line.empty() || line[0] == '#') continue;
    const auto wrong = [&](const std::string& why) {
      std::string& told = state->warnings.emplace_back(path);
      told.append(":")
          .append(std::to_string(number))
          .append(": ")
          .append(why)
          .append("; the configuration's value stands");
    };
    std::istringstream words(line);
    std::string name, text_value, rest;
    words >> name >> text_value;
    std::int64_t value = 0;
    const char* const end_of_text = text_value.data() + text_value.size();
    const auto [end, failure] = std::from_chars(text_value.data(), end_of_text, value);
    if (text_value.empty() || failure != std::errc() || end != end_of_text || words >> rest) {
      wrong("expected NAME and a whole number");
      continue;
    }
    const Parameter p = ParameterSet::find(name);
    if (p == Parameter::kCount) continue;
    if (value < info(p).min || value > info(p).max) {
      wrong(name + " must be " + std::to_string(info(p).min) + " to " + std::to_string(info(p).max));
      continue;
    }
    state->parameters[static_cast<std::size_t>(p)] = value;
    state->has_parameters = true;
  }
}

std::string saved_parameters_text(const ParameterValues& parameters, const ParameterValues& defaults) {
  std::string text = "# godwit: parameters saved over the bus; they override the configuration\n";
  for (std::size_t i = 0; i < kParameters; ++i) {
    if (parameters[i] == defaults[i]) continue;
    text += std::string(kParameterTable[i].name) + " " + std::to_string(parameters[i]) + "\n";
  }
  return text;
}

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
  // Else the origin would be sent at each start.
  drop(Parameter::kSendOrigin, "it is an order, not a setting");
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
