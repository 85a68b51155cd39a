#include "vo_core/tracking/frame_noise.h"

#include <Eigen/Cholesky>
#include <array>
#include <cmath>
#include <functional>
#include <gtest/gtest.h>
#include <random>
#include <vector>

#include "tests/vo_core/test_cameras.h"

namespace godwit::vo {
namespace frame_noise_test {

using Noise = std::function<Vec2(std::mt19937&, const Vec2& px)>;

/// Mean squared error of optimised poses over their stated covariance, a degree of freedom. begin: once a picture.
double nees(
    const Noise& noise, bool rolling = false, const std::function<void(std::mt19937&)>& begin = [](std::mt19937&) {},
    int edgelets_of_ten = 0) {
  const CameraModel camera = test::euroc();
  std::mt19937 random(11);
  std::uniform_real_distribution<double> u(20, camera.width() - 20), v(20, camera.height() - 20), d(1.0, 4.0);
  FrameNoise frame_noise(rolling);
  double sum = 0.0;
  constexpr int kPictures = 250, kWarmUp = 30;
  for (int n = 0; n < kPictures; ++n) {
    begin(random);
    const SE3 truth = SE3::exp((Vec6() << 0.2, -0.1, 0.3, 0.05, -0.08, 0.02).finished());
    std::vector<PoseMeasurement> measured;
    for (int i = 0; i < 160; ++i) {
      PoseMeasurement m;
      const Vec2 px(u(random), v(random));
      m.p_world = truth.inverse() * (camera.unproject(px) * d(random));
      m.px = px + noise(random, px);
      if (i % 10 < edgelets_of_ten) {
        // Along its edge it may lie anywhere.
        m.type = FeatureType::kEdgelet;
        m.gradient = Vec2(std::cos(0.7 * i), std::sin(0.7 * i));
        m.px += 5.0 * Vec2(-m.gradient.y(), m.gradient.x());
      }
      m.sigma_px *= std::sqrt(1.0 + frame_noise.shake());
      measured.push_back(m);
    }
    SE3 T = truth;
    const PoseOptimizerResult r = optimize_pose(camera, {}, measured, &T);
    EXPECT_TRUE(r.ok);
    const FrameCovariance own = frame_noise.covariance(camera, measured, T, r.weight_scale);
    const Mat6 C = own.noise + own.strayed;
    if (!rolling) {
      EXPECT_EQ(own.strayed, Mat6::Zero());
    }
    const Vec6 x = (truth * T.inverse()).log();
    if (n >= kWarmUp) sum += x.dot(C.ldlt().solve(x)) / 6.0 / (kPictures - kWarmUp);
  }
  return sum;
}

TEST(FrameNoise, OfWhiteNoiseIsTrue) {
  std::normal_distribution<double> normal;
  for (const double sigma : {0.1, 0.4, 0.8})
    EXPECT_NEAR(nees([&](std::mt19937& r, const Vec2&) { return Vec2(sigma * normal(r), sigma * normal(r)); }), 1.0,
                0.2)
        << sigma;
}

TEST(FrameNoise, OfEdgeletsIsTrue) {
  std::normal_distribution<double> normal;
  for (const int edgelets : {5, 9})
    EXPECT_NEAR(nees([&](std::mt19937& r, const Vec2&) { return Vec2(0.4 * normal(r), 0.4 * normal(r)); }, false,
                     [](std::mt19937&) {}, edgelets),
                1.0, 0.25)
        << edgelets;
}

// Patches on edges of things, of thin branches: most are good, some are far off.
TEST(FrameNoise, OfLongTailsIsTrue) {
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> share(0.0, 1.0);
  const double told = nees([&](std::mt19937& r, const Vec2&) {
    const double sigma = share(r) < 0.15 ? 0.7 : 0.1;
    return Vec2(sigma * normal(r), sigma * normal(r));
  });
  EXPECT_NEAR(told, 1.0, 0.25);
}

// A camera that shakes while its shutter reads: every row is displaced against the one read at the capture time, in the
// middle, and neighbours alike.
TEST(FrameNoise, OfACameraThatShakesWithinTheReadoutIsNearlyTrue) {
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> turn(0.0, 2.0 * M_PI);
  double phase_x = 0.0, phase_y = 0.0;
  const auto shake = [&](std::mt19937& r, const Vec2& px) {
    const double row = 2.0 * M_PI * 1.3 * px.y() / 480.0;
    const double middle = 2.0 * M_PI * 1.3 * 0.5;
    return Vec2(0.6 * (std::sin(row + phase_x) - std::sin(middle + phase_x)) + 0.1 * normal(r),
                0.6 * (std::sin(row + phase_y) - std::sin(middle + phase_y)) + 0.1 * normal(r));
  };
  const double told = nees(shake, true, [&](std::mt19937& r) {
    phase_x = turn(r);
    phase_y = turn(r);
  });
  EXPECT_GT(told, 0.4);
  EXPECT_LT(told, 2.5);
  // Without what the camera may have strayed until the capture time more is promised than is kept.
  phase_x = phase_y = 0.0;
  const double as_global = nees(shake, false, [&](std::mt19937& r) {
    phase_x = turn(r);
    phase_y = turn(r);
  });
  EXPECT_GT(as_global, 1.3 * told);
}

// A propeller out of balance, 85 Hz and 0.9 px: poses were taken for wrong, and lost, by a noise that nobody had
// stated.
TEST(FrameNoise, AShakingCameraIsAsNoisyAsItIsSaidToBe) {
  const CameraModel camera = test::euroc();
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> u(20, camera.width() - 20), v(20, camera.height() - 20), d(1.0, 4.0),
      turn(0.0, 2.0 * M_PI);
  const SE3 truth = SE3::exp((Vec6() << 0.2, -0.1, 0.3, 0.05, -0.08, 0.02).finished());
  const auto misfit = [&](double amplitude, bool rolling, double* shake) {
    FrameNoise frame_noise(rolling);
    double sum = 0.0;
    constexpr int kPictures = 100, kWarmUp = 40;
    for (int n = 0; n < kPictures; ++n) {
      const double phase_x = turn(random), phase_y = turn(random);
      std::vector<PoseMeasurement> measured;
      for (int i = 0; i < 160; ++i) {
        PoseMeasurement m;
        const Vec2 px(u(random), v(random));
        const double row = 2.0 * M_PI * 85.0 * 0.020 * px.y() / camera.height();
        m.p_world = truth.inverse() * (camera.unproject(px) * d(random));
        m.px = px + amplitude * Vec2(std::sin(row + phase_x), std::sin(row + phase_y)) +
               0.45 * Vec2(normal(random), normal(random));
        m.sigma_px = 0.45 * std::sqrt(1.0 + frame_noise.shake());
        measured.push_back(m);
      }
      SE3 T = truth;
      const PoseOptimizerResult r = optimize_pose(camera, {}, measured, &T);
      frame_noise.covariance(camera, measured, T, r.weight_scale);
      if (n >= kWarmUp) sum += r.chi_square / r.freedom / (kPictures - kWarmUp);
    }
    *shake = frame_noise.shake();
    return sum;
  };
  double shake = 0.0;
  EXPECT_NEAR(misfit(0.9, true, &shake), 1.0, 0.3);
  EXPECT_NEAR(shake, 0.5 * 0.9 * 0.9 / (0.45 * 0.45), 0.8);
  EXPECT_GT(misfit(0.9, false, &shake), 1.6) << "with a global shutter it is something else";
  EXPECT_EQ(shake, 0.0);
  EXPECT_NEAR(misfit(0.0, true, &shake), 1.0, 0.15);
  EXPECT_LT(shake, 0.1);
}

// Whole patches of the picture off together, as a lens that bends differently or a wrong depth makes them.
TEST(FrameNoise, OfNeighboursThatErrTogetherIsNearlyTrue) {
  std::normal_distribution<double> normal;
  std::array<Vec2, 64> patch;
  const auto together = [&](std::mt19937& r, const Vec2& px) {
    const int cell = static_cast<int>(px.y() / 60.0) * 8 + static_cast<int>(px.x() / 94.0);
    return Vec2(patch[static_cast<std::size_t>(cell)] + Vec2(0.2 * normal(r), 0.2 * normal(r)));
  };
  const double told = nees(together, false, [&](std::mt19937& r) {
    for (Vec2& p : patch) p = Vec2(0.2 * normal(r), 0.2 * normal(r));
  });
  EXPECT_GT(told, 0.7);
  EXPECT_LT(told, 1.4);
}

TEST(FrameNoise, WithoutMeasurementsNothingIsKnown) {
  FrameNoise noise(false);
  EXPECT_EQ(noise.covariance(test::euroc(), {}, SE3(), 1.0).noise, Mat6::Identity());
}

}  // namespace frame_noise_test
}  // namespace godwit::vo
