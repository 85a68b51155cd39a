#include "vo_core/tracking/sparse_image_align.h"

#include <gtest/gtest.h>
#include <vector>

#include "tests/vo_core/numeric_jacobian.h"
#include "tests/vo_core/synthetic_scene.h"
#include "vo_core/features/align_warp.h"
#include "vo_core/image/pyramid.h"

namespace godwit::vo {
namespace sparse_image_align_test {

struct View {
  test::Picture picture;
  std::vector<std::uint8_t> storage;
  rt::PyramidView pyramid;

  explicit View(test::Picture p) : picture(std::move(p)), storage(pyramid_bytes(320, 240, 4) + 256) {
    pyramid = build_pyramid(picture.view(), 4, test::aligned(&storage), storage.size() - rt::kRowAlignment);
  }
};

struct Fixture {
  CameraModel camera = CameraModel::pinhole_radtan(320, 240, 260, 260, 160, 120, {0.05, -0.02, 0, 0, 0}).value();
  test::SyntheticScene scene = test::SyntheticScene::general();
  SE3 T_ref, T_cur = SE3::exp((Vec6() << 0.015, -0.01, 0.02, 0.01, -0.015, 0.008).finished());
  std::vector<AlignPoint> points;

  Fixture() {
    for (int y = 20; y < 225; y += 18)
      for (int x = 20; x < 305; x += 18) {
        const double z = scene.depth(camera, T_ref, Vec2(x, y));
        const Vec3 f = camera.unproject(Vec2(x, y));
        if (z > 0) points.push_back({Vec2f(static_cast<float>(x), static_cast<float>(y)), f * (z / f.z())});
      }
  }
  SparseAlignOptions options() const {
    SparseAlignOptions o;
    o.max_level = 3;
    o.min_level = 1;
    o.max_iterations = 15;
    return o;
  }
};

// Inverse compositional: the derivatives are those of the reference frame, at no motion.
TEST(SparseImageAlign, DerivativesOfItsWarpAreThoseOfDifferences) {
  const Fixture f;
  for (const double row_time : {0.0, -0.35, 0.35}) {
    for (const AlignPoint& p : f.points) {
      Vec2 px;
      Mat23 Jp;
      ASSERT_TRUE(f.camera.project(p.p_ref, &px, &Jp));
      EXPECT_TRUE(test::agrees(align_jacobian(Jp, p.p_ref, row_time), test::numeric_jacobian<6>([&](const Vec6& x) {
                                 Vec2 there = Vec2::Zero();
                                 EXPECT_TRUE(f.camera.project(align_warp(SE3::exp(x) * p.p_ref, x, row_time), &there));
                                 return there;
                               })))
          << row_time;
    }
  }
}

// The patches' derivatives, put together: of a small motion in any one of the six ways one step leaves
// little (gradients between pixels are not exact).
TEST(SparseImageAlign, OneStepTakesASmallMotionAway) {
  Fixture f;
  const View ref(f.scene.render(f.camera, f.T_ref));
  SparseAlignOptions options = f.options();
  options.min_level = options.max_level = 1;
  options.max_iterations = 1;
  SparseImageAlign align(f.camera, options);
  for (const double readout : {0.0, 0.7}) {
    for (int k = 0; k < 6; ++k) {
      // About a third of a pixel of this level.
      const Vec6 off = (k < 3 ? 0.006 : 0.003) * Vec6::Unit(k);
      const SparseAlignResult r = align.run(ref.pyramid, ref.pyramid, f.points, SE3::exp(off), {}, {readout, 0.5});
      // Each patch has a gain of its own, which takes up part of the motion along its slope.
      EXPECT_LT(r.T_cur_ref.log().norm(), 0.5 * off.norm()) << k << ", readout " << readout;
    }
  }
}

TEST(SparseImageAlign, FindsTheMotionBetweenTwoFrames) {
  Fixture f;
  const View ref(f.scene.render(f.camera, f.T_ref)), cur(f.scene.render(f.camera, f.T_cur));
  SparseImageAlign align(f.camera, f.options());
  const SparseAlignResult r = align.run(ref.pyramid, cur.pyramid, f.points, SE3(), {});
  const Vec6 e = (r.T_cur_ref * f.T_cur.inverse()).log();
  EXPECT_LT(e.head<3>().norm(), 0.004);
  EXPECT_LT(e.tail<3>().norm(), 0.002);
  EXPECT_GT(r.patches, 100);
}

TEST(SparseImageAlign, ADarkerExposureChangesNothing) {
  Fixture f;
  const View ref(f.scene.render(f.camera, f.T_ref)), cur(f.scene.render(f.camera, f.T_cur, 0.7, 20.0));
  SparseImageAlign align(f.camera, f.options());
  const SparseAlignResult r = align.run(ref.pyramid, cur.pyramid, f.points, SE3(), {});
  const Vec6 e = (r.T_cur_ref * f.T_cur.inverse()).log();
  EXPECT_LT(e.head<3>().norm(), 0.006);
  EXPECT_LT(e.tail<3>().norm(), 0.003);
}

// Lamps on the mains behind a rolling shutter: rows are lit by factors of 0.5 to 1.5, in bands that move.
TEST(SparseImageAlign, BandsOfLightChangeNothing) {
  Fixture f;
  const auto lit = [](test::Picture picture, double phase) {
    for (int y = 0; y < picture.view().height; ++y) {
      const double light = 1.0 + 0.5 * std::sin(2.0 * 3.141592653589793 * (2.0 * y / picture.view().height + phase));
      for (int x = 0; x < picture.view().width; ++x)
        picture(x, y) = static_cast<std::uint8_t>(std::lround(0.66 * light * picture(x, y)));
    }
    return picture;
  };
  const View ref(lit(f.scene.render(f.camera, f.T_ref), 0.0)), cur(lit(f.scene.render(f.camera, f.T_cur), 0.33));
  SparseImageAlign align(f.camera, f.options());
  const SparseAlignResult r = align.run(ref.pyramid, cur.pyramid, f.points, SE3(), {});
  const Vec6 e = (r.T_cur_ref * f.T_cur.inverse()).log();
  EXPECT_LT(e.head<3>().norm(), 0.02);
  EXPECT_LT(e.tail<3>().norm(), 0.01);
}

// A step is as long as the picture's gradients say, not the reference's: whatever the exposure, so many steps lead as
// near.
TEST(SparseImageAlign, FewStepsDoAtAnyGain) {
  Fixture f;
  SparseAlignOptions options = f.options();
  options.max_iterations = 4;
  for (const double gain : {0.4, 0.7, 1.0}) {
    const View ref(f.scene.render(f.camera, f.T_ref)), cur(f.scene.render(f.camera, f.T_cur, gain, 20.0));
    SparseImageAlign align(f.camera, options);
    const SparseAlignResult r = align.run(ref.pyramid, cur.pyramid, f.points, SE3(), {});
    const Vec6 e = (r.T_cur_ref * f.T_cur.inverse()).log();
    EXPECT_LT(e.head<3>().norm(), 0.006) << gain;
    EXPECT_LT(e.tail<3>().norm(), 0.003) << gain;
    // And back: from the dim picture to the bright one.
    std::vector<AlignPoint> points;
    for (const AlignPoint& p : f.points) {
      Vec2 px;
      if (f.camera.project(f.T_cur * p.p_ref, &px)) points.push_back({px.cast<float>(), f.T_cur * p.p_ref});
    }
    const SparseAlignResult back = align.run(cur.pyramid, ref.pyramid, points, SE3(), {});
    const Vec6 off = (back.T_cur_ref * f.T_cur).log();
    EXPECT_LT(off.head<3>().norm(), 0.006) << gain;
    EXPECT_LT(off.tail<3>().norm(), 0.003) << gain;
  }
}

// Much more light: a third of the picture is white. What is white has no motion, and does not say that there is none.
TEST(SparseImageAlign, WhatIsBlownOutHoldsNothingBack) {
  Fixture f;
  SparseAlignOptions options = f.options();
  options.max_iterations = 8;
  const View ref(f.scene.render(f.camera, f.T_ref, 0.6)), cur(f.scene.render(f.camera, f.T_cur, 2.2));
  SparseImageAlign align(f.camera, options);
  const SparseAlignResult r = align.run(ref.pyramid, cur.pyramid, f.points, SE3(), {});
  const Vec6 e = (r.T_cur_ref * f.T_cur.inverse()).log();
  EXPECT_LT(e.head<3>().norm(), 0.006);
  EXPECT_LT(e.tail<3>().norm(), 0.003);
}

// A camera that yaws at 1 rad/s, read over 0.7 of the time between its pictures: rows see different parts of the turn.
TEST(SparseImageAlign, AYawBehindARollingShutterIsNoRoll) {
  Fixture f;
  constexpr double kReadout = 0.7;
  const Vec6 motion = (Vec6() << 0.01, 0.0, 0.01, 0.0, 0.033, 0.0).finished();  // between the two pictures
  const auto at = [&](double time) { return SE3::exp(time * motion); };
  const auto row_time = [&](double row) { return (row / 240.0 - 0.5) * kReadout; };
  const View ref(f.scene.render_rows(f.camera, [&](int row) { return at(row_time(row)); }));
  const View cur(f.scene.render_rows(f.camera, [&](int row) { return at(1.0 + row_time(row)); }));
  // Patches lie where the shutter saw them; the points are those of the capture time.
  std::vector<AlignPoint> points;
  for (const AlignPoint& p : f.points) {
    const Vec2 px = p.px.cast<double>();
    const SE3 T = at(row_time(px.y()));
    const Vec3 ray = f.camera.unproject(px);
    const double depth = f.scene.depth(f.camera, T, px);
    if (depth > 0) points.push_back({p.px, T.inverse() * (ray / ray.z() * depth)});
  }
  SparseImageAlign align(f.camera, f.options());
  const SparseAlignResult r = align.run(ref.pyramid, cur.pyramid, points, SE3(), {}, {kReadout, 0.5});
  const Vec6 e = (r.T_cur_ref * at(1.0).inverse()).log();
  EXPECT_LT(e.head<3>().norm(), 0.004);
  EXPECT_LT(e.tail<3>().norm(), 0.002);
  const SparseAlignResult global = align.run(ref.pyramid, cur.pyramid, points, SE3(), {});
  EXPECT_GT((global.T_cur_ref * at(1.0).inverse()).log().tail<3>().norm(), 0.004) << "the shutter is to be seen";
}

TEST(SparseImageAlign, ARotationPriorHoldsTheRotation) {
  Fixture f;
  const View ref(f.scene.render(f.camera, f.T_ref));
  // The same picture twice, and a prior that says that the camera turned: with a tiny sigma the prior wins.
  RotationPrior prior;
  prior.R_cur_ref = so3_exp(Vec3(0, 0.002, 0));
  prior.sigma_rad = 1e-7;
  SparseImageAlign align(f.camera, f.options());
  const SparseAlignResult r = align.run(ref.pyramid, ref.pyramid, f.points, SE3(), prior);
  EXPECT_LT(so3_log(r.T_cur_ref.R.transpose() * prior.R_cur_ref).norm(), 5e-4);
}

TEST(SparseImageAlign, ABlackPictureGivesFiniteNumbers) {
  Fixture f;
  const View ref(f.scene.render(f.camera, f.T_ref)), black(test::Picture(320, 240, 0));
  SparseImageAlign align(f.camera, f.options());
  const SparseAlignResult r = align.run(ref.pyramid, black.pyramid, f.points, SE3(), {});
  EXPECT_TRUE(r.T_cur_ref.t.allFinite());
  EXPECT_TRUE(r.T_cur_ref.R.allFinite());
}

}  // namespace sparse_image_align_test
}  // namespace godwit::vo
