#include "hal/camera/device/exposure_control.h"

#include <algorithm>
#include <cmath>

namespace godwit::hal {
namespace {
constexpr int kEvery = 8;
constexpr int kWhite = 250;
/// So much of the picture may be white before its mean says too little. A sky seldom fills more.
constexpr double kClipped = 0.5;
/// More than half of it white: how bright it is nobody knows, but a factor of this leads from 8 times too bright to
/// where it can be measured (141 instead of 100), and from just clipped not into the dark.
constexpr double kBlindStep = 5.66;
/// A limit that the turn moves by less is not worth a setting.
constexpr double kLimitMoved = 1.2;
}  // namespace

Brightness measure_brightness(const rt::ImageView& grey) {
  std::int64_t sum = 0, clipped = 0, count = 0;
  for (int y = kEvery / 2; y < grey.height; y += kEvery) {
    const std::uint8_t* const row = grey.row(y);
    for (int x = kEvery / 2; x < grey.width; x += kEvery) {
      sum += row[x];
      clipped += row[x] >= kWhite ? 1 : 0;
      ++count;
    }
  }
  if (count == 0) return {};
  return {static_cast<double>(sum) / static_cast<double>(count),
          static_cast<double>(clipped) / static_cast<double>(count)};
}

rt::TimeNs ExposureControl::limit_ns(double turn_rad_s) const {
  const double smear_px_s = settings_.focal_px * std::abs(turn_rad_s);
  const double most = static_cast<double>(settings_.most_ns);
  const double blur = smear_px_s > 0 ? settings_.blur_px / smear_px_s * 1e9 : most;
  return std::max(settings_.least_ns, static_cast<rt::TimeNs>(std::min(blur, most)));
}

double ExposureControl::correction(const Brightness& seen) const {
  if (seen.clipped_share > kClipped) return 1 / kBlindStep;
  const double wanted = settings_.target_mean / std::max(seen.mean, 1.0);
  if (std::abs(wanted - 1) < kDeadBand) return 1;
  return std::clamp(wanted, 1.0 / 16, 16.0);
}

Exposure ExposureControl::split(double light_ns, double turn_rad_s) const {
  const double least = static_cast<double>(settings_.least_ns), limit = static_cast<double>(limit_ns(turn_rad_s));
  const double exposure = std::clamp(light_ns, least, limit);
  return {static_cast<rt::TimeNs>(exposure), std::clamp(light_ns / exposure, 1.0, settings_.most_gain)};
}

bool ExposureControl::frame(const Brightness& seen, double turn_rad_s) {
  const double light = static_cast<double>(now_.exposure_ns) * now_.gain;
  double factor = 1;
  if (wait_ > 0) {
    --wait_;
  } else {
    factor = correction(seen);
  }
  const double limit = static_cast<double>(limit_ns(turn_rad_s));
  const double exposure = static_cast<double>(now_.exposure_ns);
  // The light stays, only its share changes: that needs no waiting.
  const bool too_long = exposure > limit * kLimitMoved;
  const bool room = now_.gain > 1 && exposure * kLimitMoved < limit;
  if (factor == 1 && !too_long && !room) return false;
  const Exposure next = split(light * factor, turn_rad_s);
  if (next.exposure_ns == now_.exposure_ns && next.gain == now_.gain) return false;
  now_ = next;
  // One more: the setting is made by another thread, and may just miss a frame.
  if (factor != 1) wait_ = kMostDelay + 1;
  return true;
}

}  // namespace godwit::hal
