#include "firmware_app/autopilot/aid_watch.h"

#include <fmt/format.h>

namespace godwit::app {
namespace {

/// Refusals that a source which works brings now and then are not told at once.
constexpr rt::TimeNs kPatienceNs = 2 * rt::kNsPerSecond;

std::string refusal(const AidHeard& h) {
  return h.value != 0 ? fmt::format("{} {:.6g}", h.why, h.value) : std::string(h.why);
}

std::string source_words(const AidHeard& h) {
  return h.from_autopilot ? "the autopilot" : fmt::format("node {}", h.source);
}

}  // namespace

const char* aid_words(hal::AidKind kind) {
  constexpr std::array<const char*, hal::kAidKinds> kNames = {"rangefinder", "barometer", "satellites", "attitude"};
  return kNames[static_cast<std::size_t>(kind)];
}

std::vector<AidNews> AidWatch::look(const BusAids& aids, rt::TimeNs now_ns) {
  std::vector<AidNews> out;
  for (std::size_t i = 0; i < kinds_.size(); ++i) {
    const auto kind = static_cast<hal::AidKind>(i);
    const AidHeard h = aids.heard(kind);
    Kind& k = kinds_[i];
    const rt::TimeNs silent_ns = aids.options().silent_ns;
    const bool used = h.t_used_ns != 0 && now_ns - h.t_used_ns <= silent_ns;
    const bool heard = h.t_heard_ns != 0 && now_ns - h.t_heard_ns <= silent_ns;
    if (used && !k.used) {
      out.push_back({false, fmt::format("aids: {} of {} is heard and used", aid_words(kind), source_words(h))});
      k.told_why = nullptr;
    }
    if (!used && k.used && !heard)
      out.push_back({true, fmt::format("aids: {} of {} fell silent", aid_words(kind), source_words(h))});
    k.used = used;
    if (used || !heard) {
      k.t_unused_ns = 0;
    } else if (k.t_unused_ns == 0) {
      k.t_unused_ns = now_ns;
    } else if (now_ns - k.t_unused_ns > kPatienceNs && h.why != k.told_why) {
      k.told_why = h.why;
      out.push_back({true, fmt::format("aids: {} is heard and not used: {}", aid_words(kind), refusal(h))});
    }
  }
  return out;
}

std::vector<std::string> aid_report(const BusAids& aids) {
  std::vector<std::string> out;
  for (int i = 0; i < hal::kAidKinds; ++i) {
    const auto kind = static_cast<hal::AidKind>(i);
    const AidHeard h = aids.heard(kind);
    if (h.t_heard_ns == 0) continue;
    std::string line = fmt::format("aids: {}: {} measurements taken", aid_words(kind), h.used);
    if (h.used > 0) line += " of " + source_words(h);
    if (h.refused > 0) line += fmt::format(", {} not, the last: {}", h.refused, refusal(h));
    out.push_back(line);
  }
  return out;
}

}  // namespace godwit::app
