#include "hal/camera/v4l2/v4l2_exposure.h"

#include <algorithm>
#include <cmath>
#include <linux/videodev2.h>
#include <tuple>

namespace godwit::hal {
namespace {

/// JetPack's sensor drivers (tegra-v4l2-camera.h): 64 bits; exposure in microseconds, gain in steps from 1 up.
constexpr std::uint32_t kTegraGain = 0x009a2009, kTegraExposure = 0x009a200a;
constexpr rt::TimeNs kAbsoluteUnitNs = 100'000;
constexpr rt::TimeNs kTegraUnitNs = 1000;

/// Time of a line [ns] by the sensor's own word; 0: it does not say.
rt::TimeNs line_ns(const V4l2Controls& controls, int width) {
  const auto blank = controls.find(V4L2_CID_HBLANK), rate = controls.find(V4L2_CID_PIXEL_RATE);
  if (!blank || !rate) return 0;
  const auto pixels = controls.get(*blank), hz = controls.get(*rate);
  if (!pixels || !hz || *hz <= 0 || *pixels < 0) return 0;
  return static_cast<rt::TimeNs>(1e9 * static_cast<double>(width + *pixels) / static_cast<double>(*hz));
}

}  // namespace

V4l2Exposure::V4l2Exposure(const V4l2Controls& controls, const ExposurePlan& plan, int width,
                           std::vector<std::string>* notes)
    : controls_(controls) {
  find_exposure(plan, width, notes);
  find_gain(plan, notes);
  if (plan.mode != ExposureMode::kOff) take_over(notes);
}

void V4l2Exposure::take_over(std::vector<std::string>* notes) const {
  for (const auto& [id, value, what] : {std::tuple{V4L2_CID_EXPOSURE_AUTO, +V4L2_EXPOSURE_MANUAL, "exposure"},
                                        {V4L2_CID_EXPOSURE_AUTO_PRIORITY, 0, "frame rate"},
                                        {V4L2_CID_AUTOGAIN, 0, "gain"}}) {
    const auto control = controls_.find(static_cast<std::uint32_t>(id));
    if (control && !controls_.set(*control, value)) {
      notes->push_back(controls_.path() + ": goes on setting its " + what + " itself");
    }
  }
  if (!has_exposure() && !has_gain()) {
    notes->push_back(controls_.path() +
                     ": neither exposure nor gain can be set here (a CSI sensor's may be those of its "
                     "sub-device)");
  }
}

void V4l2Exposure::find_exposure(const ExposurePlan& plan, int width, std::vector<std::string>* notes) {
  if (!plan.exposure_control.empty()) {
    const auto named = controls_.find(plan.exposure_control);
    if (!named) return notes->push_back(named.error().message);
    exposure_ = named.value();
  }
  for (const std::uint32_t id :
       {std::uint32_t{V4L2_CID_EXPOSURE_ABSOLUTE}, kTegraExposure, std::uint32_t{V4L2_CID_EXPOSURE}}) {
    if (!exposure_) exposure_ = controls_.find(id);
  }
  if (!exposure_) return;
  unit_ns_ = plan.exposure_unit_ns > 0                     ? plan.exposure_unit_ns
             : exposure_->id == V4L2_CID_EXPOSURE_ABSOLUTE ? kAbsoluteUnitNs
             : exposure_->id == kTegraExposure             ? kTegraUnitNs
             : exposure_->id == V4L2_CID_EXPOSURE          ? line_ns(controls_, width)
                                                           : 0;
  if (unit_ns_ > 0 || plan.mode == ExposureMode::kOff) return;
  notes->push_back(controls_.path() +
                   ": how long a step of its exposure control lasts is not known (of lines, one "
                   "line); camera.exposure_unit_us is needed");
}

void V4l2Exposure::find_gain(const ExposurePlan& plan, std::vector<std::string>* notes) {
  if (!plan.gain_control.empty()) {
    const auto named = controls_.find(plan.gain_control);
    if (!named) return notes->push_back(named.error().message);
    gain_ = named.value();
  }
  for (const std::uint32_t id : {std::uint32_t{V4L2_CID_ANALOGUE_GAIN}, std::uint32_t{V4L2_CID_GAIN}, kTegraGain}) {
    if (!gain_) gain_ = controls_.find(id);
  }
  if (!gain_) return;
  gain_step_db_ = plan.gain_step_db;
  // Decibels begin at 0, factors at the value that leaves the signal as it is.
  gain_one_ = plan.gain_one > 0 || gain_step_db_ > 0 ? plan.gain_one : std::max(1.0, static_cast<double>(gain_->low));
}

double V4l2Exposure::gain_of(std::int64_t value) const {
  const auto v = static_cast<double>(value);
  return gain_step_db_ > 0 ? std::pow(10.0, (v - gain_one_) * gain_step_db_ / 20) : v / gain_one_;
}

std::int64_t V4l2Exposure::value_of(double gain) const {
  const double value = gain_step_db_ > 0 ? gain_one_ + 20 * std::log10(gain) / gain_step_db_ : gain * gain_one_;
  return std::clamp(static_cast<std::int64_t>(std::lround(value)), gain_->low, gain_->high);
}

std::optional<rt::TimeNs> V4l2Exposure::exposure_ns() const {
  if (!has_exposure()) return std::nullopt;
  const auto value = controls_.get(*exposure_);
  if (!value || *value <= 0) return std::nullopt;
  return *value * unit_ns_;
}

std::optional<double> V4l2Exposure::gain() const {
  if (!gain_) return std::nullopt;
  const auto value = controls_.get(*gain_);
  if (!value) return std::nullopt;
  return std::max(gain_of(*value), 1e-3);
}

Exposure V4l2Exposure::apply(const Exposure& wanted, const Exposure& now) const {
  Exposure out = now;
  double light = static_cast<double>(wanted.exposure_ns) * wanted.gain;
  if (has_exposure()) {
    const std::int64_t steps = (wanted.exposure_ns / unit_ns_ - exposure_->low) / exposure_->step * exposure_->step;
    const std::int64_t value = std::clamp(exposure_->low + steps, exposure_->low, exposure_->high);
    if (controls_.set(*exposure_, value)) out.exposure_ns = value * unit_ns_;
  }
  if (gain_ && out.exposure_ns > 0) {
    if (!has_exposure()) light = wanted.gain * static_cast<double>(out.exposure_ns);
    const std::int64_t value = value_of(std::max(light / static_cast<double>(out.exposure_ns), 1e-3));
    if (controls_.set(*gain_, value)) out.gain = gain_of(value);
  }
  return out;
}

}  // namespace godwit::hal
