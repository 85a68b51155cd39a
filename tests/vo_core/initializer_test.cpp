#include "vo_core/tracking/initializer.h"

#include <gtest/gtest.h>
#include <memory>
#include <utility>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/vo_core/scene_points.h"
#include "tests/vo_core/synthetic_scene.h"

namespace godwit::vo {
namespace initializer_test {

using namespace test;  // NOLINT: the pictures of this folder's tests

CameraModel camera() {
  return CameraModel::pinhole_radtan(640, 480, 500, 500, 320, 240, {0.1, -0.2, 0.001, -0.001, 0.05}).value();
}

/// Sideways, a little forward, turning.
SE3 pose(int frame) {
  const double f = frame;
  return {so3_exp(Vec3(0.002, -0.004, 0.003) * f), Vec3(-0.035, 0.01, 0.012) * f};
}

/// A picture, its pyramid and its truth.
struct Shot {
  Picture picture;
  Pyramid pyramid;
  SE3 T_cam_world;
  Shot(Picture p, const SE3& T) : picture(std::move(p)), pyramid(picture.view()), T_cam_world(T) {}
};

using Shots = std::vector<std::unique_ptr<Shot>>;

Shots shoot(const SyntheticScene& scene, int n, SE3 (*motion)(int), bool flicker = false, unsigned seed = 0,
            double noise = 2.0) {
  Shots shots;
  for (int k = 0; k < n; ++k) {
    Picture p = scene.render(camera(), motion(k), flicker ? 1.0 - 0.04 * k : 1.0, flicker ? 3.0 * k : 0.0);
    p.add_noise(noise, seed + static_cast<unsigned>(k + 1));
    shots.push_back(std::make_unique<Shot>(std::move(p), motion(k)));
  }
  return shots;
}

const Shots& general_shots() {
  static const Shots shots = shoot(SyntheticScene::general(), 10, pose);
  return shots;
}
const Shots& plane_shots() {
  static const Shots shots = shoot(SyntheticScene::plane(), 10, pose, true);
  return shots;
}

struct Outcome {
  InitReport report;
  std::size_t frames = 0;
};
Outcome run(Initializer* init, const Shots& shots, const rt::MaskPyramidView& mask = {}) {
  Outcome r;
  for (const auto& shot : shots) {
    r.report = init->add_frame(shot->pyramid.view(), mask);
    ++r.frames;
    if (r.report.status == InitStatus::kDone) break;
  }
  return r;
}

void expect_good_map(const Initializer& init, const SyntheticScene& scene, const SE3& T_cur_ref,
                     double direction_deg = 3.0, double rotation_deg = 0.2) {
  EXPECT_LT(scenes::direction_error_deg(init.T_cur_ref(), T_cur_ref), direction_deg);
  EXPECT_LT(scenes::rotation_error_deg(init.T_cur_ref(), T_cur_ref), rotation_deg);
  // Depths against the scene: one scale for all, errors as large as promised.
  std::vector<double> ratio, depth, normalised;
  for (const InitPoint& p : init.points()) {
    ratio.push_back(scene.depth(camera(), {}, p.px_ref.cast<double>()) / p.p_ref.z());
    depth.push_back(p.p_ref.z());
  }
  ASSERT_GE(ratio.size(), 60u);
  std::vector<double> sorted = ratio;
  std::sort(sorted.begin(), sorted.end());
  const double scale = sorted[sorted.size() / 2];
  for (std::size_t i = 0; i < ratio.size(); ++i)
    normalised.push_back(std::abs(ratio[i] / scale - 1.0) /
                         (init.points()[i].depth_sigma / init.points()[i].p_ref.norm()));
  std::sort(normalised.begin(), normalised.end());
  std::sort(depth.begin(), depth.end());
  EXPECT_NEAR(depth[depth.size() / 2], 1.0, 1e-6) << "the median depth is the unit";
  EXPECT_LT(normalised[normalised.size() / 2], 1.5) << "half of the errors lie within 0.67 sigma if sigma is honest";
  EXPECT_LT(normalised[normalised.size() * 9 / 10], 4.0);
}

TEST(Initializer, PlaneGivesHomographyAndTheRightMap) {
  Initializer init(camera(), {});
  const Outcome r = run(&init, plane_shots());
  ASSERT_EQ(r.report.status, InitStatus::kDone);
  EXPECT_EQ(r.report.model, InitModel::kHomography) << "R_H " << r.report.ratio_homography;
  expect_good_map(init, SyntheticScene::plane(), plane_shots()[r.frames - 1]->T_cam_world);
}

TEST(Initializer, GeneralSceneGivesFundamentalAndTheRightMap) {
  Initializer init(camera(), {});
  const Outcome r = run(&init, general_shots());
  ASSERT_EQ(r.report.status, InitStatus::kDone);
  EXPECT_EQ(r.report.model, InitModel::kFundamental) << "R_H " << r.report.ratio_homography;
  expect_good_map(init, SyntheticScene::general(), general_shots()[r.frames - 1]->T_cam_world);
}

/// Away from the slanted plane along its normal, as a helicopter from its pad; a drift aside keeps two minima apart.
SE3 climb(int frame) {
  const Vec3 right = Vec3(1, 0, -0.3).normalized(), normal = right.cross(Vec3(0, 0, 1).cross(right).normalized());
  return {Mat3::Identity(), 0.012 * frame * (normal + Vec3(0.0, 0.06, 0.0))};
}

// Such a picture has two motions that explain it almost alike, the truth between them: each by itself states a tenth of
// how wrong it is. The map waits until they are one, or says how far they are apart.
TEST(Initializer, AClimbFromAPlaneSaysHowUncertainItIs) {
  static const Shots shots = shoot(SyntheticScene::plane(), 40, climb);
  Initializer init(camera(), {});
  const Outcome r = run(&init, shots);
  ASSERT_EQ(r.report.status, InitStatus::kDone);
  expect_good_map(init, SyntheticScene::plane(), shots[r.frames - 1]->T_cam_world, 5.0, 0.4);
}

constexpr int kAhead = 11;
/// Straight at the slanted plane, which looks as if it were not slanted and the camera went towards it aslant; then
/// aside, which tells.
SE3 ahead_then_aside(int frame) {
  const int ahead = std::min(frame, kAhead), aside = frame - ahead;
  return {Mat3::Identity(), Vec3(-0.035 * aside, 0.01 * aside, -0.02 * ahead)};
}

TEST(Initializer, WhereAnotherMotionCostsHardlyMoreTheFirstMapWaitsForOneThatTells) {
  InitializerOptions hasty;
  hasty.max_ambiguity = 1;
  int wrong = 0;
  // At 4 grey levels many patches hardly stand out, and must be kept when they are cut anew.
  for (const auto& [noise, seed] : {std::pair(4.0, 0u), {4.0, 100u}, {10.0, 100u}, {10.0, 200u}}) {
    const Shots shots = shoot(SyntheticScene::plane(), 24, ahead_then_aside, false, seed, noise);
    Initializer init(camera(), {});
    int ambiguous = 0;
    InitReport report;
    std::size_t frames = 0;
    while (frames < shots.size() && report.status != InitStatus::kDone) {
      report = init.add_frame(shots[frames++]->pyramid.view(), {});
      if (report.ambiguity > InitializerOptions{}.max_ambiguity) ++ambiguous;
      if (frames <= kAhead) {
        ASSERT_NE(report.status, InitStatus::kDone) << frames;
      }
      if (frames == kAhead) {
        EXPECT_EQ(report.status, InitStatus::kAmbiguous);
      }
    }
    EXPECT_GE(ambiguous, 2);
    ASSERT_EQ(report.status, InitStatus::kDone);
    EXPECT_LE(report.ambiguity, InitializerOptions{}.max_ambiguity);
    expect_good_map(init, SyntheticScene::plane(), shots[frames - 1]->T_cam_world);
    // Who does not wait takes now this one, now that.
    Initializer without(camera(), hasty);
    const Outcome r = run(&without, shots);
    ASSERT_EQ(r.report.status, InitStatus::kDone);
    EXPECT_LE(r.frames, static_cast<std::size_t>(kAhead));
    wrong += scenes::direction_error_deg(without.T_cur_ref(), shots[r.frames - 1]->T_cam_world) > 10;
  }
  EXPECT_GT(wrong, 0);
}

/// The right half goes its own way, as a truck that fills it does.
Shots half_moving(int n) {
  Shots shots;
  for (int k = 0; k < n; ++k) {
    const SyntheticScene scene = SyntheticScene::general();
    Picture p = scene.render(camera(), pose(k));
    const Picture other = scene.render(camera(), {Mat3::Identity(), Vec3(0.05, -0.01, 0.0) * k});
    for (int y = 0; y < 480; ++y)
      for (int x = 320; x < 640; ++x) p(x, y) = other.view().at(x, y);
    p.add_noise(2.0, static_cast<unsigned>(k + 1));
    shots.push_back(std::make_unique<Shot>(std::move(p), pose(k)));
  }
  return shots;
}

TEST(Initializer, WhereHalfOfThePictureGoesItsOwnWayNoMapBegins) {
  const Shots shots = half_moving(14);
  Initializer init(camera(), {});
  bool seen = false;
  for (const auto& shot : shots) {
    const InitReport report = init.add_frame(shot->pyramid.view(), {});
    ASSERT_NE(report.status, InitStatus::kDone);
    if (report.status != InitStatus::kTwoMotions || report.points == 0) continue;  // not tried anew at each
    seen = true;
    EXPECT_GT(report.second_motion, InitializerOptions{}.max_second_motion);
  }
  EXPECT_TRUE(seen);
  InitializerOptions hasty;
  hasty.max_second_motion = 100;
  Initializer without(camera(), hasty);
  EXPECT_EQ(run(&without, shots).report.status, InitStatus::kDone) << "one of the two, whichever";
}

TEST(Initializer, AViewTooNarrowToTellATurnFromAWayBeginsNoMap) {
  const auto slowly = [](int k) { return SE3(so3_exp(Vec3(0.0, 0.002, 0.0) * k), Vec3(-0.012, 0.004, 0.0) * k); };
  const Shots shots = shoot(SyntheticScene::plane(), 5, slowly);
  Mask mask(640, 480);
  mask.add_rectangle(80, 0, 640, 480);
  InitializerOptions options;
  options.min_parallax_deg = 0.4;
  options.max_ambiguity = 1;
  InitializerOptions hasty = options;
  hasty.max_baseline_uncertainty = 100;
  Initializer init(camera(), options), without(camera(), hasty);
  EXPECT_EQ(run(&init, shots, mask.view()).report.status, InitStatus::kTurnOrWay);
  const Outcome hurried = run(&without, shots, mask.view());
  ASSERT_EQ(hurried.report.status, InitStatus::kDone);
  EXPECT_GT(hurried.report.baseline_uncertainty, InitializerOptions{}.max_baseline_uncertainty);
}

TEST(Initializer, PureRotationIsRefused) {
  for (const SyntheticScene& scene : {SyntheticScene::general(), SyntheticScene::plane()}) {
    const auto shots =
        shoot(scene, 12, [](int k) { return SE3(so3_exp(Vec3(0.006, -0.008, 0.004) * k), Vec3::Zero()); });
    Initializer init(camera(), {});
    const Outcome r = run(&init, shots);
    EXPECT_EQ(r.report.status, InitStatus::kNoParallax);
    EXPECT_GT(r.report.median_disparity_px, 20.0);
    EXPECT_LT(r.report.parallax_px, 0.6);
    EXPECT_TRUE(init.points().empty());
  }
}

TEST(Initializer, NoMotionIsRefused) {
  const auto shots = shoot(SyntheticScene::general(), 4, [](int) { return SE3(); });
  Initializer init(camera(), {});
  const Outcome r = run(&init, shots);
  EXPECT_EQ(r.report.status, InitStatus::kNoMotion);
  EXPECT_LT(r.report.median_disparity_px, 0.5);
}

TEST(Initializer, TracksThatEnterTheMaskAreDropped) {
  Mask mask(640, 480);
  mask.add_rectangle(0, 0, 320, 480);
  Initializer init(camera(), {});
  init.add_frame(general_shots()[0]->pyramid.view(), {});
  const int all = init.add_frame(general_shots()[1]->pyramid.view(), {}).tracks;
  const int rest = init.add_frame(general_shots()[2]->pyramid.view(), mask.view()).tracks;
  EXPECT_LT(rest, all * 3 / 4);
  EXPECT_GT(rest, all / 4);
  for (std::size_t k = 3; k < general_shots().size(); ++k) {
    if (init.add_frame(general_shots()[k]->pyramid.view(), mask.view()).status != InitStatus::kDone) continue;
    for (const InitPoint& p : init.points()) EXPECT_GT(p.px_cur.x(), 319.0f);
    return;
  }
  FAIL() << "no map from the unmasked half";
}

TEST(Initializer, FlatPictureHasTooFewFeaturesAndLostTracksStartAgain) {
  const Picture grey(640, 480, 100);
  const Pyramid flat(grey.view());
  Initializer init(camera(), {});
  EXPECT_EQ(init.add_frame(flat.view(), {}).status, InitStatus::kTooFewFeatures);
  EXPECT_EQ(init.add_frame(general_shots()[0]->pyramid.view(), {}).status, InitStatus::kFirstFrame);
  EXPECT_EQ(init.add_frame(plane_shots()[0]->pyramid.view(), {}).status, InitStatus::kTracksLost);
  EXPECT_EQ(init.add_frame(flat.view(), {}).status, InitStatus::kTooFewFeatures);
  init.reset();
  EXPECT_EQ(run(&init, general_shots()).report.status, InitStatus::kDone) << "nothing of the past may be left";
}

TEST(Initializer, SameFramesSameMapToTheBit) {
  Initializer one(camera(), {}), two(camera(), {});
  run(&one, plane_shots());  // a past that must leave no trace
  one.reset();
  const Outcome a = run(&one, general_shots()), b = run(&two, general_shots());
  ASSERT_EQ(a.frames, b.frames);
  ASSERT_EQ(one.points().size(), two.points().size());
  EXPECT_EQ(one.T_cur_ref().R, two.T_cur_ref().R);
  EXPECT_EQ(one.T_cur_ref().t, two.T_cur_ref().t);
  for (std::size_t i = 0; i < one.points().size(); ++i) {
    EXPECT_EQ(one.points()[i].p_ref, two.points()[i].p_ref);
    EXPECT_EQ(one.points()[i].depth_sigma, two.points()[i].depth_sigma);
  }
}

TEST(Initializer, DoesNotAllocateAfterConstruction) {
  general_shots();
  Initializer init(camera(), {});
  Outcome r;
  const rt::HeapCounts before = rt::rt_heap_counts();
  {
    const rt::RtScope scope;
    r = run(&init, general_shots());
  }
  EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
  EXPECT_EQ(r.report.status, InitStatus::kDone);
}

/// The rows of a rolling shutter's picture are taken one after the other.
SE3 shaking(double frame) {
  return {
      so3_exp(Vec3(0.012 * std::sin(0.7 * frame), -0.010 * (1 - std::cos(0.7 * frame)), 0.01 * std::sin(0.6 * frame))),
      Vec3(-0.03, 0.012, 0.0) * frame};
}

TEST(Initializer, KnowsTheRollingShutter) {
  const SyntheticScene scene = SyntheticScene::plane();
  constexpr double kReadout = 0.8;
  Shots shots;
  for (int k = 0; k < 12; ++k) {
    Picture p = scene.render_rows(camera(), [k](int y) { return shaking(k + kReadout * ((y + 0.5) / 480.0 - 0.5)); });
    shots.push_back(std::make_unique<Shot>(std::move(p), shaking(k)));
  }
  const auto error_deg = [&](double readout) {
    InitializerOptions options;
    options.readout = readout;
    Initializer init(camera(), options);
    const Outcome r = run(&init, shots);
    if (r.report.status != InitStatus::kDone) return 180.0;
    const SE3 truth = shots[r.frames - 1]->T_cam_world * shots[0]->T_cam_world.inverse();
    return scenes::direction_error_deg(init.T_cur_ref(), truth) +
           10 * scenes::rotation_error_deg(init.T_cur_ref(), truth);
  };
  const double knowing = error_deg(kReadout), not_knowing = error_deg(0.0);
  EXPECT_LT(knowing, 5.0);
  EXPECT_LT(knowing, 0.5 * not_knowing);
}

}  // namespace initializer_test
}  // namespace godwit::vo
