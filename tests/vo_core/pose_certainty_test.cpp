#include "vo_core/map/pose_certainty.h"

#include <Eigen/Cholesky>
#include <gtest/gtest.h>
#include <memory>
#include <random>

namespace godwit::vo {
namespace pose_certainty_test {

Mat6 some_covariance(unsigned seed, double size) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  Mat6 A;
  for (int i = 0; i < 36; ++i) A(i) = size * normal(random);
  return A * A.transpose() + 0.1 * size * size * Mat6::Identity();
}

SE3 pose(int k) {
  return SE3::exp((Vec6() << 0.3 * k, -0.1 * k, 0.5 + 0.2 * k, 0.1 * k, -0.3, 0.2 * k).finished());
}

struct Flight {
  std::unique_ptr<Map> map = std::make_unique<Map>();
  PoseCertainty certainty;

  // Keyframes 1 to n, 0.2 s apart from 1 s on.
  explicit Flight(int n) {
    for (int k = 0; k < n; ++k) {
      Keyframe& kf = map->insert_keyframe(k, static_cast<std::uint32_t>(k + 1));
      kf.t_capture_ns = rt::kNsPerSecond + k * 200 * rt::kNsPerMs;
      kf.T_kf_world = pose(k);
    }
  }
  RelativePose at(int ms, const SE3& T = pose(9), const Mat6& own = 1e-6 * Mat6::Identity()) const {
    return certainty.relative(*map, T, rt::kNsPerSecond + ms * rt::kNsPerMs, own, Mat6::Zero());
  }
};

TEST(PoseCertainty, TheReferenceIsTheNewestKeyframeOfHalfASecond) {
  Flight f(5);
  EXPECT_EQ(f.at(820).keyframe_id, 2u) << "3 is 0.42 s old";
  EXPECT_EQ(f.at(900).keyframe_id, 3u);
  EXPECT_EQ(f.at(5000).keyframe_id, 5u) << "a camera that hovers";
  EXPECT_EQ(f.at(300).keyframe_id, 1u) << "all are young: the oldest";
  EXPECT_EQ(f.at(0).keyframe_id, 0u) << "the first frame of all has none";
  EXPECT_EQ(f.at(820).t_keyframe_ns, f.map->keyframe(1).t_capture_ns);
  const SE3 expected = (pose(9) * pose(1).inverse()).inverse();
  EXPECT_LT((f.at(820).T_ref_cam.R - expected.R).norm() + (f.at(820).T_ref_cam.t - expected.t).norm(), 1e-12);
}

TEST(PoseCertainty, KeyframesOfKnownShareComeFirst) {
  Flight f(5);
  MapShares shares;
  shares.centre = 5;
  shares.count = 1;
  shares.share[0] = {1, Mat6::Identity()};
  f.certainty.take(shares);
  EXPECT_EQ(f.at(900).keyframe_id, 1u);
  f.certainty.clear();
  EXPECT_EQ(f.at(900).keyframe_id, 3u) << "another map begins: nothing of the old one counts";
}

// Errors drawn as the model has them: of the centre by the map, of the frame by its own noise.
TEST(PoseCertainty, TheMapsShareIsCarriedToTheFrame) {
  Flight f(4);
  const Mat6 M = some_covariance(1, 1e-3), own = some_covariance(2, 5e-4);
  MapShares shares;
  shares.centre = 4;
  shares.count = 1;
  shares.share[0] = {2, M};
  f.certainty.take(shares);
  const SE3 T_cam_world = pose(9);
  const RelativePose told = f.at(2000, T_cam_world, own);
  ASSERT_EQ(told.keyframe_id, 2u);
  std::mt19937 random(4);
  std::normal_distribution<double> normal;
  const Mat6 LM = M.llt().matrixL(), LO = own.llt().matrixL();
  const SE3 T_c_k = T_cam_world * pose(1).inverse(), T_n_k = pose(3) * pose(1).inverse();
  Mat6 seen = Mat6::Zero();
  constexpr int kDraws = 20000;
  for (int n = 0; n < kDraws; ++n) {
    Vec6 a, b;
    for (int i = 0; i < 6; ++i) {
      a(i) = normal(random);
      b(i) = normal(random);
    }
    // The map, and N with it, is displaced against K; C keeps its place in the map but for its own noise.
    const SE3 T_true = SE3::exp(LO * b) * (T_c_k * T_n_k.inverse()) * SE3::exp(LM * a) * T_n_k;
    const Vec6 x = (T_true * told.T_ref_cam).log();
    seen += x * x.transpose() / kDraws;
  }
  const Mat6 ratio = told.covariance.llt().matrixL().solve(seen).eval();
  const Mat6 whitened = told.covariance.llt().matrixL().solve(ratio.transpose()).transpose();
  EXPECT_LT((whitened - Mat6::Identity()).cwiseAbs().maxCoeff(), 0.06);
}

TEST(PoseCertainty, BeforeTheFirstAdjustmentTheKeyframeCountsAsTheFrameDoes) {
  Flight f(2);
  const RelativePose near = f.at(1000, pose(0)), far = f.at(1000, pose(9));
  EXPECT_NEAR(near.covariance(3, 3), 2e-6, 1e-12);
  EXPECT_GT(far.covariance(0, 0), 2e-6) << "its turn moves what is far from it";
}

TEST(PoseCertainty, InTheMapUncertaintyGrowsAlongTheKeyframes) {
  Flight f(5);
  double before = 0.0;
  for (int k = 1; k < 5; ++k) {
    const RelativePose r = f.at(200 * k, pose(k));
    ASSERT_EQ(r.keyframe_id, k > 3 ? 2u : 1u);
    const Mat6 C = f.certainty.in_map(*f.map, r);
    f.certainty.keyframe(k, C);
    if (k == 3) before = C.trace();
    if (k == 4) {
      EXPECT_GT(C.trace(), r.covariance.trace()) << "the reference's own uncertainty is in it";
      EXPECT_GT(C.trace(), before);
    }
  }
  EXPECT_EQ(f.certainty.in_map(*f.map, f.at(100)), f.at(100).covariance) << "the first keyframe is where the world is";
}

}  // namespace pose_certainty_test
}  // namespace godwit::vo
