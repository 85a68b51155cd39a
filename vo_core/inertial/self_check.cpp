#include "vo_core/inertial/self_check.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {

void SelfCheck::reset() {
  ones_ = {};
}

void SelfCheck::forget_older(CheckedBy by, rt::TimeNs t_ns) {
  One& one = ones_[static_cast<std::size_t>(by)];
  if (one.t_ns < t_ns) one = {};
}

SelfCheck::One& SelfCheck::remember(CheckedBy by, double squared, int degrees, rt::TimeNs t_ns) {
  One& one = ones_[static_cast<std::size_t>(by)];
  const double each = degrees > 0 && squared >= 0 ? std::min(squared / degrees, options_.most) : options_.most;
  const double dt = one.weight > 0 ? std::max(0.0, rt::to_seconds(t_ns - one.t_ns)) : 0;
  const double keep = std::exp(-dt / rt::to_seconds(options_.memory_ns));
  one.sum = keep * one.sum + each;
  one.weight = keep * one.weight + 1;
  one.t_ns = t_ns;
  return one;
}

bool SelfCheck::add(CheckedBy by, double squared, int degrees, rt::TimeNs t_ns) {
  constexpr const char* kReasons[] = {"vision and inertial sensor disagree: innovation squared [0.1]",
                                      "vision and barometer disagree: innovation squared [0.1]",
                                      "vision and rangefinder disagree: innovation squared [0.1]",
                                      "vision and satellites disagree: innovation squared [0.1]"};
  One& one = remember(by, squared, degrees, t_ns);
  if (!(mean(by) > options_.lost)) {
    one.t_beyond_ns = 0;
    return false;
  }
  if (one.t_beyond_ns == 0) one.t_beyond_ns = t_ns;
  if (t_ns - one.t_beyond_ns < options_.patience_ns) return false;
  reason_ = kReasons[static_cast<std::size_t>(by)];
  value_ = mean(by);
  reset();
  // Who was just found wrong is the same as before: what begins anew has to earn its trust.
  one = {options_.few * options_.lost, options_.few, t_ns, 0};
  return true;
}

double SelfCheck::mean(CheckedBy by) const {
  const One& one = ones_[static_cast<std::size_t>(by)];
  return one.weight >= options_.few ? one.sum / one.weight : 1;
}

double SelfCheck::trust() const {
  double worst = 1;
  for (std::size_t i = 0; i < kCheckers; ++i) worst = std::max(worst, mean(static_cast<CheckedBy>(i)));
  const double from = std::sqrt(options_.doubt), to = std::sqrt(options_.lost);
  const double share = std::clamp((std::sqrt(worst) - from) / (to - from), 0.0, 1.0);
  return 1 - share * (1 - options_.least_trust);
}

}  // namespace godwit::vo
