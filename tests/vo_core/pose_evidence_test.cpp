// What speaks for a pose: right ones and wrong ones, of measurements made at random.
#include "vo_core/tracking/pose_evidence.h"

#include <gtest/gtest.h>
#include <random>
#include <vector>

#include "tests/vo_core/test_cameras.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::vo {
namespace pose_evidence_test {

constexpr double kSigmaPx = 0.45;
constexpr double kAlignmentMayMovePx = 4.0;

/// Points before a camera at the origin: `right` of them measured with the stated noise, `by_chance` anywhere within
/// what an alignment may move.
std::vector<PoseMeasurement> measure(const CameraModel& camera, int right, int by_chance, unsigned seed,
                                     FeatureType type = FeatureType::kCorner) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> u(20, camera.width() - 20), v(20, camera.height() - 20), d(1.0, 4.0),
      off(-kAlignmentMayMovePx, kAlignmentMayMovePx);
  std::normal_distribution<double> noise(0.0, kSigmaPx);
  std::vector<PoseMeasurement> out;
  for (int i = 0; i < right + by_chance; ++i) {
    const Vec2 px(u(random), v(random));
    PoseMeasurement m;
    m.p_world = camera.unproject(px) * d(random);
    m.sigma_px = kSigmaPx;
    m.type = type;
    m.gradient = Vec2(0.6, 0.8);
    Vec2 moved(noise(random), noise(random));
    if (i >= right) {
      do moved = Vec2(off(random), off(random));
      while (moved.norm() > kAlignmentMayMovePx);
    }
    m.px = px + moved;
    out.push_back(m);
  }
  return out;
}

double evidence(std::vector<PoseMeasurement> m, int not_found) {
  SE3 T;
  const PoseOptimizerResult fit = optimize_pose(test::euroc(), {}, m, &T);
  return pose_evidence(fit, static_cast<int>(m.size()), not_found);
}

TEST(PoseEvidence, FewThatAgreeMakeAPoseAndManyByChanceDoNot) {
  const TrackerOptions options;
  for (unsigned seed = 0; seed < 20; ++seed) {
    EXPECT_GT(evidence(measure(test::euroc(), 30, 0, seed), 30), options.sure) << seed;
    EXPECT_GT(evidence(measure(test::euroc(), 20, 0, seed), 40), options.held / 2) << seed;
    EXPECT_GT(evidence(measure(test::euroc(), 60, 0, seed, FeatureType::kEdgelet), 30), options.sure) << seed;
    EXPECT_LT(evidence(measure(test::euroc(), 0, 40, seed), 100), options.promising) << seed;
    EXPECT_LT(evidence(measure(test::euroc(), 0, 150, seed), 100), options.promising) << seed;
    EXPECT_LT(evidence(measure(test::euroc(), 0, 150, seed, FeatureType::kEdgelet), 100), options.promising) << seed;
  }
}

TEST(PoseEvidence, WhatIsFoundElsewhereSpeaksAgainst) {
  const double alone = evidence(measure(test::euroc(), 60, 0, 1), 60);
  const double some = evidence(measure(test::euroc(), 60, 20, 1), 60);
  const double many = evidence(measure(test::euroc(), 60, 90, 1), 60);
  EXPECT_LT(some, alone);
  EXPECT_LT(many, some - 50.0);
}

TEST(PoseEvidence, APictureThatHidesMostCountsOnce) {
  const std::vector<PoseMeasurement> m = measure(test::euroc(), 60, 0, 2);
  const double all_found = evidence(m, 0), some = evidence(m, 100), most = evidence(m, 300),
               nearly_all = evidence(m, 2000);
  EXPECT_GT(all_found, some);
  EXPECT_GT(some, most);
  EXPECT_EQ(most, nearly_all);
  EXPECT_GT(nearly_all, TrackerOptions{}.sure) << "sixty that agree are no chance, whatever is dark";
}

TEST(PoseEvidence, WhereThereIsNoPoseNothingIsSaid) {
  EXPECT_EQ(evidence(measure(test::euroc(), 9, 0, 3), 100), 0.0);
  EXPECT_EQ(pose_evidence({}, 0, 0), 0.0);
}

}  // namespace pose_evidence_test
}  // namespace godwit::vo
