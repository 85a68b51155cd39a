#include "hal/camera/device/exposure_control.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <gtest/gtest.h>
#include <vector>

namespace godwit::hal::exposure_control_test {
namespace {

/// A linear sensor with 8 bits: a scene of patches whose brightness spans a factor of 16, a control that comes through
/// `delay` frames late, and exposure in steps of rows.
class Sensor {
 public:
  Sensor(int delay, Exposure start) : pending_(static_cast<std::size_t>(delay), start), now_(start) {}
  void set(const Exposure& e) { wanted_ = e; }
  Brightness picture(double scene) {
    // What was set after the last picture comes through in this one, or later.
    if (wanted_.exposure_ns != 0) last_ = wanted_;
    pending_.push_back(last_.exposure_ns != 0 ? last_ : now_);
    now_ = pending_.front();
    pending_.pop_front();
    double sum = 0, white = 0;
    constexpr int kPatches = 64;
    for (int i = 0; i < kPatches; ++i) {
      const double reflectance = std::pow(16.0, i / (kPatches - 1.0)) / 5.5;  // mean about 1
      const double rows = std::floor(static_cast<double>(now_.exposure_ns) / 15'000);
      const double v = std::min(255.0, scene * reflectance * rows * now_.gain);
      sum += v;
      white += v >= 250 ? 1 : 0;
    }
    return {sum / kPatches, white / kPatches};
  }
  const Exposure& now() const { return now_; }

 private:
  std::deque<Exposure> pending_;
  Exposure now_, wanted_{}, last_{};
};

TEST(ExposureControl, SettlesWithinTenFramesAfterAFactorOfEightAndDoesNotSwing) {
  for (int delay = 0; delay <= ExposureControl::kMostDelay; ++delay) {
    for (const double step : {8.0, 1 / 8.0, 2.0, 0.5}) {
      const Exposure start{4 * rt::kNsPerMs, 1};
      ExposureControl control({}, start);
      Sensor sensor(delay, start);
      double scene = 0.4;
      std::vector<double> means;
      int changes_late = 0;
      for (int i = 0; i < 90; ++i) {
        if (i == 30) scene *= step;
        const Brightness seen = sensor.picture(scene);
        if (control.frame(seen, 0)) {
          sensor.set(control.current());
          if (i >= 60 || (i >= 20 && i < 30)) ++changes_late;
        }
        means.push_back(seen.mean);
      }
      for (std::size_t i = 41; i < 90; ++i) {
        EXPECT_NEAR(means[i], 100, 100 * ExposureControl::kDeadBand + 3)
            << "delay " << delay << " step " << step << " " << i;
      }
      EXPECT_EQ(changes_late, 0) << "it hunts: delay " << delay << " step " << step;
      // No swing: what was too bright does not become too dark on the way, nor the reverse.
      for (std::size_t i = 31; i < 60; ++i) {
        if (step > 1) {
          EXPECT_GT(means[i], 80) << delay << " " << step;
        }
        if (step < 1) {
          EXPECT_LT(means[i], 125) << delay << " " << step;
        }
      }
    }
  }
}

TEST(ExposureControl, ATurnShortensTheExposureAndGainMakesUpForIt) {
  ExposureSettings settings;
  settings.blur_px = 1;
  settings.focal_px = 500;
  ExposureControl control(settings, {10 * rt::kNsPerMs, 1});
  EXPECT_EQ(control.limit_ns(0), settings.most_ns);
  EXPECT_EQ(control.limit_ns(-1), 2 * rt::kNsPerMs);
  ASSERT_TRUE(control.frame({100, 0}, 1.0));
  EXPECT_EQ(control.current().exposure_ns, 2 * rt::kNsPerMs);
  EXPECT_DOUBLE_EQ(control.current().gain, 5);
  EXPECT_FALSE(control.frame({100, 0}, 1.1)) << "a limit that moves by a tenth is not followed";
  ASSERT_TRUE(control.frame({100, 0}, 0.0)) << "and back when it ends";
  EXPECT_DOUBLE_EQ(control.current().gain, 1);
  EXPECT_EQ(control.current().exposure_ns, 10 * rt::kNsPerMs);
  // Too fast for all the gain there is: blur comes before brightness.
  ASSERT_TRUE(control.frame({100, 0}, 50));
  EXPECT_EQ(control.current().exposure_ns, 40'000);
  EXPECT_EQ(control.current().gain, settings.most_gain);
}

TEST(ExposureControl, DarknessEndsAtTheLimitsAndStaysThere) {
  ExposureControl control({}, {4 * rt::kNsPerMs, 1});
  int changes = 0;
  for (int i = 0; i < 100; ++i) changes += control.frame({0, 0}, 0) ? 1 : 0;
  EXPECT_LE(changes, 3);
  EXPECT_EQ(control.current().exposure_ns, ExposureSettings().most_ns);
  EXPECT_EQ(control.current().gain, ExposureSettings().most_gain);
  for (int i = 0; i < 100; ++i) control.frame({255, 1}, 0);
  EXPECT_EQ(control.current().exposure_ns, ExposureSettings().least_ns);
  EXPECT_EQ(control.current().gain, 1);
}

TEST(ExposureControl, MeasuresMeanAndWhite) {
  std::vector<std::uint8_t> pixels(64 * 48, 40);
  std::fill(pixels.begin(), pixels.begin() + 64 * 24, 255);
  const Brightness b = measure_brightness({pixels.data(), 64, 48, 64});
  EXPECT_DOUBLE_EQ(b.mean, 147.5);
  EXPECT_DOUBLE_EQ(b.clipped_share, 0.5);
}

}  // namespace
}  // namespace godwit::hal::exposure_control_test
