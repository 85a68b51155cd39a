// What shakes a camera by what a gyroscope elsewhere, low-passed and late, says of it: found from rendered residuals
// whose truth is known.
#include "vo_core/tracking/shake_fit.h"

#include <cmath>
#include <gtest/gtest.h>
#include <numbers>
#include <random>
#include <vector>

#include "tests/vo_core/test_cameras.h"

namespace godwit::vo {
namespace shake_fit_test {

constexpr double kReadoutS = 0.015, kHz = 85, kAmplitude = 2e-3, kNoisePx = 0.2;
const RollingShutter kShutter{kReadoutS, 0.5};

/// What the gyroscope says of a picture whose middle row is read then: about all three axes, each with a phase of its
/// own.
MeasuredShake measured(double t_s) {
  MeasuredShake out;
  out.known = true;
  out.t_ns = std::llround(t_s * 1e9);
  const double rate = 2 * std::numbers::pi * kHz;
  for (int k = 0; k < RowTurns::kRows; ++k) {
    const double t = t_s + kReadoutS * (static_cast<double>(k) / (RowTurns::kRows - 1) - 0.5);
    for (int axis = 0; axis < 3; ++axis) {
      out.turn.at[k](axis) = static_cast<float>(kAmplitude * std::sin(rate * t + axis));
      out.rate.at[k](axis) = static_cast<float>(kAmplitude * rate * std::cos(rate * t + axis));
    }
  }
  return out;
}

/// How the camera turns then.
ReadoutMotion truth(const MeasuredShake& m, double gain, double rate_s) {
  ReadoutMotion out;
  out.shakes = true;
  for (int k = 0; k < RowTurns::kRows; ++k)
    out.shake.at[k] = static_cast<float>(gain) * m.turn.at[k] + static_cast<float>(rate_s) * m.rate.at[k];
  return out;
}

/// Pictures with a map, as the tracker has them.
struct WithMap {
  /// The pose is fitted to what the picture shows, freed of what is known of the shake; then the shake is learned from.
  void see(double t_s, double gain, double rate_s, ShakeFit* fit) {
    const MeasuredShake m = measured(t_s);
    const ReadoutMotion true_motion = truth(m, gain, rate_s);
    ReadoutMotion known;
    fit->fill(m, &known);
    std::vector<PoseMeasurement> all;
    std::uniform_real_distribution<double> u(40, 600), v(40, 440), depth(5, 40);
    std::normal_distribution<double> noise(0, kNoisePx);
    for (int i = 0; i < 150; ++i) {
      PoseMeasurement one;
      one.p_world = camera.unproject({u(random), v(random)}) * depth(random);
      Vec2 px;
      Mat23 J;
      EXPECT_TRUE(camera.project(one.p_world, &px, &J));
      const Vec2 seen = px + rolling_displacement(kShutter, camera.height(), one.p_world, J, px.y(), true_motion) +
                        Vec2(noise(random), noise(random));
      one.px = global_pixel(kShutter, camera, seen.cast<float>(), one.p_world, known).cast<double>();
      one.sigma_px = kNoisePx;
      all.push_back(one);
    }
    SE3 T;
    const PoseOptimizerResult p = optimize_pose(camera, {}, all, &T);
    ASSERT_TRUE(p.ok);
    fit->learn(camera, all, T, p.weight_scale, 1.0, m, known);
  }
  const CameraModel camera = test::tum_fr1();
  std::mt19937 random{7};
};

TEST(ShakeFit, UntilPicturesShowItBothSitOnOneRigidBody) {
  const ShakeFit fit;
  const MeasuredShake m = measured(0.3);
  ReadoutMotion motion;
  fit.fill(m, &motion);
  EXPECT_TRUE(motion.shakes);
  EXPECT_EQ(motion.shake.at, m.turn.at);
  fit.fill({}, &motion);
  EXPECT_FALSE(motion.shakes) << "nothing was measured";
}

TEST(ShakeFit, PosesResidualsShowGainAndDelay) {
  // As it is; behind a low-pass that leaves six tenths and is 2.5 ms late; the camera on a mount that shakes by itself
  // not at all.
  for (const auto& [gain, rate_s] : {std::pair(1.0, 0.0), std::pair(0.4, 3e-3), std::pair(0.0, 0.0)}) {
    ShakeFit fit;
    WithMap flight;
    for (int k = 0; k < 30; ++k) flight.see(k / 30.0 + 0.001 * (k % 7), gain, rate_s, &fit);
    EXPECT_NEAR(fit.gain(), gain, 0.02);
    EXPECT_NEAR(fit.rate_s(), rate_s, 5e-5);
  }
}

TEST(ShakeFit, WhatTheyShowNowAndThenIsForgotten) {
  ShakeFit fit;
  WithMap flight;
  for (int k = 0; k < 100; ++k) flight.see(k / 30.0, 1.0, 0.0, &fit);
  for (int k = 100; k < 1100; ++k) flight.see(k / 30.0, 0.5, 1e-3, &fit);
  EXPECT_NEAR(fit.gain(), 0.5, 0.08) << "half a minute after its mount broke";
  EXPECT_NEAR(fit.rate_s(), 1e-3, 1.6e-4);
}

/// Tracks of three views whose camera turns and goes evenly, some things moving and some tracks lost on an edge.
std::vector<InitialTracks::InThreeViews> tracks(double t_s, double gain, double rate_s,
                                                std::array<MeasuredShake, 3>* shakes, std::mt19937* random,
                                                double dropped = 0, const Vec3& way = Vec3(0.02, 0, 0.03)) {
  std::uniform_real_distribution<double> across(-0.5, 0.5), down(-0.4, 0.4), depth(5, 40), jump(-0.02, 0.02);
  std::normal_distribution<double> noise(0, kNoisePx / 450);
  const auto age = [&](std::size_t i) { return static_cast<double>(i) + (i == 2 ? dropped : 0.0); };  // [pictures]
  for (std::size_t i = 0; i < 3; ++i) (*shakes)[i] = measured(t_s - age(i) / 30);
  std::vector<InitialTracks::InThreeViews> out;
  for (int k = 0; k < 150; ++k) {
    const Vec3 p = Vec3(across(*random), down(*random), 1.0) * depth(*random);
    InitialTracks::InThreeViews one;
    for (std::size_t i = 0; i < 3; ++i) {
      const Vec3 ray = so3_exp(-age(i) * Vec3(2e-3, -3e-3, 4e-3)) * (p - age(i) * way);
      const Vec2 steady = ray.head<2>() / ray.z();
      one.row[i] = 0.5 + steady.y();
      const Vec3 seen = ray + truth((*shakes)[i], gain, rate_s).shake.turn(one.row[i]).cross(ray);
      one.xy[i] = seen.head<2>() / seen.z() + Vec2(noise(*random), noise(*random));
      if (k % 10 == 0) one.xy[i] += Vec2(jump(*random), jump(*random));
    }
    out.push_back(one);
  }
  return out;
}

TEST(ShakeFit, TracksWithoutAMapShowThemToo) {
  for (const auto& [gain, rate_s] : {std::pair(1.0, 0.0), std::pair(0.4, 3e-3), std::pair(0.0, 0.0)}) {
    ShakeFit fit;
    std::mt19937 random(3);
    std::array<MeasuredShake, 3> shakes;
    for (int k = 0; k < 10; ++k) {
      const double t = 1 + k / 30.0;
      const auto seen = tracks(t, gain, rate_s, &shakes, &random);
      fit.learn(seen, shakes);
    }
    EXPECT_NEAR(fit.gain(), gain, 0.03);
    EXPECT_NEAR(fit.rate_s(), rate_s, 6e-5);
    // And a view that was freed of another shake is off by what that makes.
    ReadoutMotion before;
    ShakeFit().fill(shakes[0], &before);
    const double apart = std::hypot(1 - gain, rate_s * 2 * std::numbers::pi * kHz) * kAmplitude * std::sqrt(1.5);
    EXPECT_NEAR(fit.off(shakes[0], before), apart, 0.2 * apart + 1e-4);
    EXPECT_EQ(fit.off({}, before), 0) << "nothing was measured";
  }
}

TEST(ShakeFit, PicturesThatWereDroppedBetweenAreNoShake) {
  ShakeFit fit;
  std::mt19937 random(3);
  std::array<MeasuredShake, 3> shakes;
  for (int k = 0; k < 10; ++k) {
    const auto seen = tracks(1 + k / 30.0, 0.4, 3e-3, &shakes, &random, 2, Vec3(0.2, 0, 0.1));
    fit.learn(seen, shakes);
  }
  EXPECT_NEAR(fit.gain(), 0.4, 0.03);
  EXPECT_NEAR(fit.rate_s(), 3e-3, 6e-5);
}

TEST(ShakeFit, NothingIsLearnedOfWhatWasNotMeasured) {
  ShakeFit fit;
  std::mt19937 random(3);
  std::array<MeasuredShake, 3> shakes;
  auto seen = tracks(1, 0.4, 3e-3, &shakes, &random);
  shakes[2].known = false;
  fit.learn(seen, shakes);
  EXPECT_EQ(fit.gain(), 1);
  shakes[2].known = true;
  fit.learn(std::span(seen).first(10), shakes);
  EXPECT_EQ(fit.gain(), 1) << "too few";
  seen[0].xy[0].x() = std::nan("");
  fit.learn(seen, shakes);
  EXPECT_TRUE(std::isfinite(fit.gain()));
}

}  // namespace shake_fit_test
}  // namespace godwit::vo
