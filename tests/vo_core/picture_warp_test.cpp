#include "vo_core/features/picture_warp.h"

#include <cmath>
#include <gtest/gtest.h>
#include <random>
#include <vector>

namespace godwit::vo {
namespace picture_warp_test {

constexpr int kWidth = 640, kHeight = 480;

/// A plane seen aslant after a turn, a step and a climb.
Vec2f go(const Vec2f& px) {
  const Vec2 p((static_cast<double>(px.x()) - 320.0) / 500.0, (static_cast<double>(px.y()) - 240.0) / 500.0);
  Mat3 H;
  H << 0.93, -0.08, 0.05, 0.07, 0.9, -0.03, 0.06, -0.1, 1.0;
  const Vec3 q = H * p.homogeneous();
  return (500.0 * q.hnormalized() + Vec2(320.0, 240.0)).cast<float>();
}

struct Tracks {
  std::vector<Vec2f> from, to;
};

Tracks tracks(int n, double noise_px, double moving_share, double width = kWidth, double height = kHeight) {
  std::mt19937 rng(7);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  std::normal_distribution<double> noise(0.0, noise_px);
  Tracks t;
  for (int i = 0; i < n; ++i) {
    const Vec2f p = Vec2(unit(rng) * width, unit(rng) * height).cast<float>();
    Vec2f q = go(p) + Vec2(noise(rng), noise(rng)).cast<float>();
    if (unit(rng) < moving_share) q += Vec2f(30.0f, 5.0f);
    t.from.push_back(p);
    t.to.push_back(q);
  }
  return t;
}

TEST(PictureWarp, FindsTheHomographyAmongMovers) {
  const Tracks t = tracks(300, 0.1, 0.3);
  PictureWarp warp(kWidth, kHeight);
  ASSERT_TRUE(warp.fit(t.from, t.to));
  for (const Vec2f& p : {Vec2f(40, 40), Vec2f(600, 60), Vec2f(320, 240), Vec2f(50, 440), Vec2f(590, 430)}) {
    EXPECT_LT((warp(p) - go(p)).norm(), 0.3f) << p.transpose();
    Eigen::Matrix2f numeric;
    for (int axis = 0; axis < 2; ++axis) {
      const Vec2f step = 4.0f * Vec2f::Unit(axis);
      numeric.col(axis) = (go(p + step) - go(p - step)) / 8.0f;
    }
    EXPECT_LT((warp.derivative(p) - numeric).norm(), 0.01f) << p.transpose();
  }
}

TEST(PictureWarp, TooFewTracksLeaveItAsItWas) {
  PictureWarp warp(kWidth, kHeight);
  Tracks t = tracks(PictureWarp::kMinTracks - 1, 0.1, 0.0);
  EXPECT_FALSE(warp.fit(t.from, t.to));
  EXPECT_LT((warp(Vec2f(50, 60)) - Vec2f(50, 60)).norm(), 1e-3f);
  t = tracks(PictureWarp::kMinTracks, 0.1, 0.0);
  EXPECT_TRUE(warp.fit(t.from, t.to));
  const Vec2f was = warp(Vec2f(50, 60));
  t.to[3].x() = NAN;
  EXPECT_FALSE(warp.fit(t.from, t.to));
  EXPECT_EQ(warp(Vec2f(50, 60)), was);
}

// Tracks of one corner must not blow up the opposite one.
TEST(PictureWarp, WhereNoTracksAreThePictureNeitherGrowsNorTurnsMuch) {
  const Tracks t = tracks(60, 0.3, 0.0, 40.0, 40.0);
  PictureWarp warp(kWidth, kHeight);
  ASSERT_TRUE(warp.fit(t.from, t.to));
  EXPECT_LT((warp.derivative(Vec2f(600, 440)) - Eigen::Matrix2f::Identity()).norm(), 0.8f);  // without a prior 1.1
  EXPECT_LT((warp(Vec2f(20, 20)) - go(Vec2f(20, 20))).norm(), 0.3f);
}

}  // namespace picture_warp_test
}  // namespace godwit::vo
