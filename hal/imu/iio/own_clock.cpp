#include "hal/imu/iio/own_clock.h"

#include <algorithm>
#include <cstdlib>

namespace godwit::hal {

OwnClock::Verdict OwnClock::take(rt::TimeNs stamp_ns, rt::TimeNs arrival_ns, rt::TimeNs* t_ns) {
  const auto strange = [](rt::TimeNs delay_ns) { return delay_ns < -kFutureNs || delay_ns > kOldNs; };
  if (strange(arrival_ns - stamp_ns - offset_ns_) && !strange(arrival_ns - stamp_ns)) {
    follows_ = false;  // CLOCK_MONOTONIC after all, as after another driver has taken the device
    offset_ns_ = 0;
  }
  if (strange(arrival_ns - stamp_ns - offset_ns_)) {
    const rt::TimeNs off_ns = arrival_ns - stamp_ns;
    if (strange_ == 0 || std::abs(off_ns - strange_least_ns_) > kSameNs) {
      strange_ = 0;
      strange_least_ns_ = off_ns;
      strange_stamp_ns_ = stamp_ns;
      strange_arrival_ns_ = arrival_ns;
    }
    strange_least_ns_ = std::min(strange_least_ns_, off_ns);
    if (++strange_ < kEnough) return Verdict::kStrange;
    strange_ = 0;
    if (stamp_ns - strange_stamp_ns_ < (arrival_ns - strange_arrival_ns_) / 2) return Verdict::kStrange;  // it stands
    follows_ = true;
    offset_ns_ = strange_least_ns_;
    window_end_ns_ = 0;
    return Verdict::kFollowed;
  }
  strange_ = 0;
  if (follows_) {
    if (window_end_ns_ != 0 && arrival_ns >= window_end_ns_) {
      offset_ns_ += std::min(window_least_ns_, kSlewNs);
      window_end_ns_ = 0;
    }
    // None is younger than its arrival, whatever the seconds before said.
    offset_ns_ += std::min<rt::TimeNs>(0, arrival_ns - stamp_ns - offset_ns_);
    const rt::TimeNs left_ns = arrival_ns - stamp_ns - offset_ns_;
    if (window_end_ns_ == 0) {
      window_end_ns_ = arrival_ns + kWindowNs;
      window_least_ns_ = left_ns;
    }
    window_least_ns_ = std::min(window_least_ns_, left_ns);
  }
  *t_ns = stamp_ns + offset_ns_;
  return Verdict::kGood;
}

}  // namespace godwit::hal
