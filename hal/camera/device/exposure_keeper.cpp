#include "hal/camera/device/exposure_keeper.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace godwit::hal {
namespace {
/// Where the device does not say how long it exposes: short enough for flight in daylight.
constexpr rt::TimeNs kFirstExposureNs = 4 * rt::kNsPerMs;
}  // namespace

bool ExposureKeeper::saw(const rt::ImageView& grey, rt::TimeNs t_capture_ns) {
  if (plan_.mode != ExposureMode::kAutomatic) return false;
  return seen_.try_push({measure_brightness(grey), t_capture_ns});
}

void ExposureKeeper::turning(double rate_rad_s) {
  const auto rate = static_cast<float>(std::abs(rate_rad_s));
  float before = turn_rad_s_.load(std::memory_order_relaxed);
  // Relaxed: a number alone. Partner: the exchange in turn_rate(); one that comes between load and exchange is the
  // next look's.
  while (rate > before && !turn_rad_s_.compare_exchange_weak(before, rate, std::memory_order_relaxed)) {
  }
}

double ExposureKeeper::turn_rate(rt::TimeNs now_ns) {
  const float rate = turn_rad_s_.exchange(kNoRate, std::memory_order_relaxed);
  if (rate >= 0) {
    rate_rad_s_ = static_cast<double>(rate);
    rate_heard_ns_ = now_ns;
  } else if (now_ns - rate_heard_ns_ > kTurnKnownNs) {
    rate_rad_s_ = 0;
  }
  return rate_rad_s_;
}

void ExposureKeeper::begin(std::unique_ptr<ExposureDevice> device) {
  device_ = std::move(device);
  if (!set_before_) now_ = {device_->exposure_ns().value_or(kFirstExposureNs), device_->gain().value_or(1)};
  if (plan_.mode == ExposureMode::kOff) return;
  Exposure wanted = now_;
  if (plan_.mode == ExposureMode::kFixed) {
    wanted = plan_.fixed;
    if (wanted.exposure_ns == 0) wanted.exposure_ns = now_.exposure_ns;
  }
  now_ = device_->apply(wanted, now_);
  set_before_ = true;
  if (plan_.mode == ExposureMode::kFixed) return;
  ExposureSettings limits = plan_.automatic;
  if (device_->has_exposure()) {
    limits.least_ns = std::max(limits.least_ns, device_->least_ns());
    limits.most_ns = std::max(limits.least_ns, std::min(limits.most_ns, device_->most_ns()));
  } else {
    limits.least_ns = limits.most_ns = now_.exposure_ns;
  }
  limits.most_gain = device_->has_gain() ? std::max(1.0, std::min(limits.most_gain, device_->most_gain())) : 1.0;
  control_.emplace(limits, now_);
  set_ns_ = 0;
  Seen stale;
  while (seen_.try_pop(&stale)) {
  }
}

bool ExposureKeeper::steer(rt::TimeNs now_ns) {
  bool set = false;
  Seen seen;
  while (seen_.try_pop(&seen)) {
    steered_.fetch_add(1, std::memory_order_relaxed);
    if (!device_ || !control_ || seen.t_ns < set_ns_) continue;
    if (!control_->frame(seen.brightness, turn_rate(now_ns))) continue;
    now_ = device_->apply(control_->current(), now_);
    control_->applied(now_);
    set_ns_ = now_ns;
    set = true;
  }
  return set;
}

std::optional<rt::TimeNs> ExposureKeeper::exposure_ns() const {
  if (!device_) return std::nullopt;
  if (plan_.mode != ExposureMode::kOff && device_->has_exposure()) return now_.exposure_ns;
  return device_->exposure_ns();
}

}  // namespace godwit::hal
