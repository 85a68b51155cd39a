// From what was heard on the bus to what the tracker may use: which messages are measurements of metres or of the
// vertical, whose, and when they were taken. No fused place, height or heading of the autopilot's: our own pose may be
// in it.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <optional>

#include "firmware_app/config/config.h"
#include "firmware_app/link/link_service.h"
#include "hal/aid/aid.h"

namespace godwit::app {

struct BusAidsOptions {
  std::array<bool, hal::kAidKinds> used = {true, true, true, false};  ///< by hal::AidKind
  int range_sensor = -1;                                              ///< see Config::Aids
  /// What was measured at a time that nobody can tell came so much later. Half of it is what it may be wrong by: at
  /// 3 m/s of climb 3 cm.
  rt::TimeNs delay_ns = 20 * rt::kNsPerMs;
  rt::TimeNs stale_ns = 500 * rt::kNsPerMs;     ///< what is older on arrival is not used
  rt::TimeNs ahead_ns = 20 * rt::kNsPerMs;      ///< nor what lies further in the future: half a bad round trip
  rt::TimeNs silent_ns = 3 * rt::kNsPerSecond;  ///< a source that is silent for so long gives its place to another
  double most_sigma_m = 5;                      ///< a fix that is less sure tells nothing within a way of 30 m
};

/// What was heard of one kind. Copied field by field: figures for people.
struct AidHeard {
  std::uint64_t used = 0, refused = 0;
  const char* why = "";  ///< the last refusal; static text
  double value = 0;      ///< of it, where it has a figure
  bool from_autopilot = false;
  std::uint8_t source = 0;    ///< node, or MAVLink component
  rt::TimeNs t_used_ns = 0;   ///< on arrival; 0: never
  rt::TimeNs t_heard_ns = 0;  ///< the same of any message of the kind
};

/// The reader's side of the link's inputs, for the tracker's thread: no allocation, no lock, no wait, at most the
/// ring's length of work a call.
class BusAids final : public hal::AidSource {
 public:
  /// inputs outlives it.
  BusAids(const BusAidsOptions& options, link::InputRing* inputs) : options_(options), inputs_(inputs) {}

  bool next_until(rt::TimeNs t_ns, hal::AidSample* sample) override;
  /// Any thread.
  AidHeard heard(hal::AidKind kind) const;
  const BusAidsOptions& options() const { return options_; }

 private:
  /// Whom a kind is taken from.
  struct Chosen {
    bool any = false, from_autopilot = false;
    std::uint8_t source = 0, sensor = 0;
    rt::TimeNs t_heard_ns = 0, t_measured_ns = 0;
  };
  /// AidHeard for other threads. Relaxed: figures, each for itself; partner: heard().
  struct Told {
    std::atomic<std::uint64_t> used{0}, refused{0};
    std::atomic<const char*> why{""};
    std::atomic<double> value{0};
    std::atomic<bool> from_autopilot{false};
    std::atomic<std::uint8_t> source{0};
    std::atomic<rt::TimeNs> t_used_ns{0}, t_heard_ns{0};
  };
  /// Why it is not used, and the figure.
  struct Refusal {
    const char* why = nullptr;  ///< null: it is
    double value = 0;
  };

  static std::optional<hal::AidKind> kind_of(const link::AutopilotInput& input);
  bool take(const link::AutopilotInput& input, hal::AidKind kind, hal::AidSample* sample);
  Refusal measured(const link::AutopilotInput& input, hal::AidKind kind, hal::AidSample* sample);
  Refusal place(const link::AutopilotInput& input, hal::AidSample* sample);
  Refusal time_of(const link::AutopilotInput& input, const Chosen& chosen, rt::TimeNs* t_ns) const;
  Refusal choose(const link::AutopilotInput& input, Chosen* chosen) const;

  const BusAidsOptions options_;
  link::InputRing* const inputs_;
  bool held_ = false;  ///< held_sample_ was measured after the last call's picture
  hal::AidSample held_sample_;
  std::array<Chosen, hal::kAidKinds> chosen_;
  bool have_origin_ = false;  ///< of the satellites' local frame: the first fix that was used
  double latitude0_ = 0, longitude0_ = 0, height0_ = 0;
  std::array<Told, hal::kAidKinds> told_;
};

BusAidsOptions bus_aids_options(const Config& config);

/// Has the messages collected that BusAids reads, and the autopilot asked for them and for nothing that nobody reads.
void ask_for_aids(const Config& config, link::LinkSettings* settings);

}  // namespace godwit::app
