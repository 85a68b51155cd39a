#include "hal/imu/sample_clock.h"

#include <algorithm>

namespace godwit::hal {
namespace {
/// Gain on the step's length of a correction of the phase. A second-order loop with phase gain 1 outside the looks and
/// 0 between them: 0.02 settles 1 % within a few hundred samples and lets a look that came late move it by little.
constexpr double kStepGain = 0.02;
}  // namespace

void SampleClock::start(rt::TimeNs step_ns) {
  *this = {};
  nominal_ns_ = step_ns_ = static_cast<double>(step_ns);
}

rt::TimeNs SampleClock::take(int count, rt::TimeNs after_ns, rt::TimeNs before_ns) {
  // A first look that came late found its sample old; the second one then seems to follow at once.
  const rt::TimeNs oldest_allowed = any_ ? newest_ns_ + step_ns() / 2 : 0;
  rt::TimeNs newest = before_ns;
  if (any_) {
    const rt::TimeNs expected = newest_ns_ + static_cast<rt::TimeNs>(step_ns_ * count);
    newest = std::clamp(expected, std::min(after_ns, before_ns), before_ns);
    // A look that came late widens what it allows, it does not move the estimate: only what contradicts it does.
    const double correction = static_cast<double>(newest - expected) / count;
    step_ns_ =
        std::clamp(step_ns_ + kStepGain * correction, nominal_ns_ * (1 - kMostOff), nominal_ns_ * (1 + kMostOff));
  }
  any_ = true;
  const rt::TimeNs span = step_ns() * (count - 1);
  const rt::TimeNs oldest = std::max(newest - span, oldest_allowed);
  newest_ns_ = oldest + span;
  return oldest;
}

}  // namespace godwit::hal
