#include "vo_core/features/klt_tracker.h"

#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>
#include <random>

#include "tests/vo_core/synthetic_scene.h"

namespace godwit::vo {
namespace klt_tracker_test {

using namespace test;  // NOLINT: the pictures of this folder's tests

constexpr float kNoise = 1.0f;  ///< of the pictures' grey levels; they have none

/// The texture moved by (dx, dy) px: a feature at p is found at p + d.
Picture moved(double dx, double dy, double gain = 1.0, double offset = 0.0) {
  Picture picture(320, 240, 0);
  for (int y = 0; y < 240; ++y)
    for (int x = 0; x < 320; ++x)
      picture(x, y) = static_cast<std::uint8_t>(
          std::clamp(std::lround(gain * 220.0 * texture((x - dx) / 12.0, (y - dy) / 12.0, 5) + offset), 0L, 255L));
  return picture;
}

std::vector<Vec2f> grid() {
  std::vector<Vec2f> px;
  for (int y = 50; y <= 190; y += 20)
    for (int x = 50; x <= 270; x += 20) px.emplace_back(static_cast<float>(x), static_cast<float>(y));
  return px;
}

double median_error(const KltTracker& tracker, const Vec2f& d) {
  std::vector<double> e;
  for (const KltTrack& t : tracker.tracks())
    if (t.alive) e.push_back(static_cast<double>((t.px - t.px_ref - d).norm()));
  std::sort(e.begin(), e.end());
  return e.empty() ? 1e9 : e[e.size() / 2];
}

TEST(KltTracker, FindsSubPixelShiftsOfEverySize) {
  const Picture first = moved(0, 0);
  const Pyramid reference(first.view());
  KltTracker tracker({});
  for (const Vec2f& d : {Vec2f(0.3f, -0.7f), Vec2f(4.25f, 3.5f), Vec2f(-9.6f, 5.1f)}) {
    const int alive = tracker.set_reference(reference.view(), grid(), kNoise);
    ASSERT_GT(alive, 80);
    const Picture second = moved(static_cast<double>(d.x()), static_cast<double>(d.y()));
    EXPECT_GT(tracker.track(Pyramid(second.view()).view()), alive * 9 / 10) << d.transpose();
    EXPECT_LT(median_error(tracker, d), 0.06) << d.transpose();
  }
}

TEST(KltTracker, BrightnessGainAndOffsetDoNotMoveTheTracks) {
  const Picture first = moved(0, 0);
  KltTracker tracker({});
  const Pyramid reference(first.view());
  const int alive = tracker.set_reference(reference.view(), grid(), kNoise);
  const Picture second = moved(2.4, -1.3, 0.7, 40.0);
  EXPECT_GT(tracker.track(Pyramid(second.view()).view()), alive * 9 / 10);
  EXPECT_LT(median_error(tracker, Vec2f(2.4f, -1.3f)), 0.08);
}

// A step is as long as the picture's gradients say: in a picture more than twice as bright steps of the reference's
// length go to and fro.
TEST(KltTracker, TracksComeThroughWhenTheLightDoubles) {
  const Picture first = moved(0, 0, 0.35, 10.0);
  KltTracker tracker({});
  const Pyramid reference(first.view());
  const int alive = tracker.set_reference(reference.view(), grid(), kNoise);
  ASSERT_GT(alive, 80);
  const Picture second = moved(2.4, -1.3, 1.0, 10.0);
  EXPECT_GT(tracker.track(Pyramid(second.view()).view()), alive * 9 / 10);
  EXPECT_LT(median_error(tracker, Vec2f(2.4f, -1.3f)), 0.1);
}

// Snow: a texture no stronger than the grey noise. On coarser levels, where noise averages out, it stands out.
TEST(KltTracker, FaintTextureIsFollowedOnALevelWhereItStandsOutFromTheNoise) {
  const auto noisy = [](Picture picture, unsigned seed) {
    std::mt19937 rng(seed);
    std::normal_distribution<double> noise(0.0, 2.5);
    for (int y = 0; y < 240; ++y)
      for (int x = 0; x < 320; ++x)
        picture(x, y) = static_cast<std::uint8_t>(std::clamp(std::lround(picture(x, y) + noise(rng)), 0L, 255L));
    return picture;
  };
  const Picture first = noisy(moved(0, 0, 0.12, 120.0), 1);
  KltTracker tracker({});
  const Pyramid reference(first.view());
  const int alive = tracker.set_reference(reference.view(), grid(), 2.5f);
  EXPECT_GT(alive, 60);
  int coarse = 0;
  for (const KltTrack& t : tracker.tracks()) coarse += t.alive && t.level > 0;
  EXPECT_GT(coarse, alive / 2);
  const Picture second = noisy(moved(2.4, -1.3, 0.12, 120.0), 2);
  EXPECT_GT(tracker.track(Pyramid(second.view()).view()), alive * 3 / 4);
  EXPECT_LT(median_error(tracker, Vec2f(2.4f, -1.3f)), 0.4);
}

// In a picture that grows each place has a motion of its own, and a patch follows what is in it, wherever that is.
TEST(KltTracker, AMotionIsThatOfThePlaceWhereTheGradientsAre) {
  constexpr double kZoom = 1.04;
  const Vec2f aside(5.0f, 4.0f), middle(160.0f, 120.0f);
  const auto zoomed = [&](double zoom) {
    Picture picture(320, 240, 0);
    for (int y = 0; y < 240; ++y) {
      for (int x = 0; x < 320; ++x) {
        const double u = 160.0 + (x - 160.0) / zoom, v = 120.0 + (y - 120.0) / zoom;
        // A blob beside each node of the grid of 20 px, on grey.
        const double du = std::remainder(u - 50.0 - 5.0, 20.0), dv = std::remainder(v - 50.0 - 4.0, 20.0);
        picture(x, y) = static_cast<std::uint8_t>(std::lround(90.0 + 120.0 * std::exp(-(du * du + dv * dv) / 6.0)));
      }
    }
    return picture;
  };
  const Picture first = zoomed(1.0), second = zoomed(kZoom);
  KltTracker tracker({});
  std::vector<Vec2f> px;
  for (const Vec2f& p : grid())
    if ((p - middle).norm() < 60.0f) px.push_back(p);
  const Pyramid reference(first.view());
  ASSERT_GT(tracker.set_reference(reference.view(), px, kNoise), 10);
  ASSERT_GT(tracker.track(Pyramid(second.view()).view()), 10);
  for (const KltTrack& t : tracker.tracks()) {
    if (!t.alive) continue;
    EXPECT_LT((t.centre_ref - aside).norm(), 1.0f);
    const Vec2f from = t.px_ref + t.centre_ref, to = middle + static_cast<float>(kZoom) * (from - middle);
    EXPECT_LT((t.px + t.centre - to).norm(), 0.06f) << from.transpose();
  }
}

// A turning camera moves and blurs its picture: a patch that is blurred along the way comes closer by small steps, and
// where it was is far from where it is.
TEST(KltTracker, FollowsAPictureThatGoesOnFastAndBlurred) {
  const auto turned = [](int frame, double px_a_frame) {
    constexpr int kExposures = 8;
    std::vector<int> sum(320 * 240, 0);
    Picture mean(320, 240, 0);
    for (int k = 0; k < kExposures; ++k) {
      Picture part = moved(px_a_frame * (frame + 0.4 * k / kExposures), 0);
      for (int i = 0; i < 320 * 240; ++i) sum[i] += part(i % 320, i / 320);
    }
    for (int i = 0; i < 320 * 240; ++i) mean(i % 320, i / 320) = static_cast<std::uint8_t>(sum[i] / kExposures);
    return mean;
  };
  std::vector<Vec2f> px;
  for (const Vec2f& p : grid())
    if (p.x() < 200) px.push_back(p);
  for (const double way : {18.0, 26.0}) {
    KltTracker tracker({});
    const Picture first = turned(0, way);
    const Pyramid reference(first.view());
    const int all = tracker.set_reference(reference.view(), px, kNoise);
    ASSERT_GT(all, 50);
    for (int frame = 1; frame <= 3; ++frame) {
      const Picture next = turned(frame, way);
      EXPECT_GT(tracker.track(Pyramid(next.view()).view()), all * 9 / 10) << way << " px a frame, frame " << frame;
    }
    EXPECT_LT(median_error(tracker, Vec2f(static_cast<float>(3 * way), 0.0f)), 0.1);
  }
}

// A climb, and a turn about the optical axis: what the patches show has become smaller, or stands aslant.
TEST(KltTracker, PatchesGrowAndTurnWithThePicture) {
  const Vec2f middle(160.0f, 120.0f);
  const auto seen = [&](const Eigen::Matrix2f& warp) {
    const Eigen::Matrix2f back = warp.inverse();
    Picture picture(320, 240, 0);
    for (int y = 0; y < 240; ++y) {
      for (int x = 0; x < 320; ++x) {
        const Vec2f p = back * (Vec2f(static_cast<float>(x), static_cast<float>(y)) - middle);
        picture(x, y) = static_cast<std::uint8_t>(
            std::lround(220.0 * texture(static_cast<double>(p.x()) / 12.0, static_cast<double>(p.y()) / 12.0, 5)));
      }
    }
    return picture;
  };
  struct Change {
    float zoom, turn_rad;  ///< a frame
  };
  for (const Change& change : {Change{0.98f, 0.0f}, Change{1.02f, 0.0f}, Change{1.0f, 0.03f}, Change{0.99f, -0.02f}}) {
    KltTracker tracker({});
    Eigen::Matrix2f warp = Eigen::Matrix2f::Identity();
    const Eigen::Matrix2f step = change.zoom * Eigen::Rotation2Df(change.turn_rad).toRotationMatrix();
    const Picture first = seen(warp);
    const Pyramid reference(first.view());
    std::vector<Vec2f> px;
    for (const Vec2f& p : grid())
      if ((p - middle).norm() < 75.0f) px.push_back(p);
    const int all = tracker.set_reference(reference.view(), px, kNoise);
    ASSERT_GT(all, 30);
    int alive = 0;
    for (int frame = 1; frame <= 16; ++frame) {
      warp = step * warp;
      const Picture next = seen(warp);
      alive = tracker.track(Pyramid(next.view()).view());
    }
    EXPECT_GT(alive, all * 9 / 10) << change.zoom << " " << change.turn_rad;
    std::vector<float> off;
    for (const KltTrack& t : tracker.tracks()) {
      if (!t.alive) continue;
      const Vec2f from = t.px_ref + t.centre_ref;
      off.push_back((t.px + t.centre - (middle + warp * (from - middle))).norm());
      EXPECT_LT((t.warp - warp).norm(), 0.06f) << change.zoom << " " << change.turn_rad;
    }
    ASSERT_FALSE(off.empty());
    std::sort(off.begin(), off.end());
    EXPECT_LT(off[off.size() / 2], 0.06f) << change.zoom << " " << change.turn_rad;
    EXPECT_LT(off[off.size() * 9 / 10], 0.15f) << change.zoom << " " << change.turn_rad;
  }
}

TEST(KltTracker, DoesNotDriftOverManyFrames) {
  const Picture first = moved(0, 0);
  KltTracker tracker({});
  const Pyramid reference(first.view());
  tracker.set_reference(reference.view(), grid(), kNoise);
  for (int k = 1; k <= 40; ++k) {
    const Picture next = moved(0.37 * k, -0.21 * k);
    tracker.track(Pyramid(next.view()).view());
  }
  EXPECT_LT(median_error(tracker, Vec2f(14.8f, -8.4f)), 0.06);
}

TEST(KltTracker, OtherContentAndEmptyPicturesKillTheTracks) {
  const Picture first = moved(0, 0), grey(320, 240, 128), other = rectangles(320, 240, 300, 9);
  KltTracker tracker({});
  const Pyramid reference(first.view());
  const int alive = tracker.set_reference(reference.view(), grid(), kNoise);
  EXPECT_LT(tracker.track(Pyramid(other.view()).view()), alive / 20);
  EXPECT_EQ(tracker.track(Pyramid(grey.view()).view()), 0);
  EXPECT_EQ(tracker.track(Pyramid(first.view()).view()), 0) << "a dead track must not come back";
}

TEST(KltTracker, FlatPatchesAndPatchesOutsideAreNeverAlive) {
  const Picture grey(320, 240, 128), first = moved(0, 0);
  KltTracker tracker({});
  const Pyramid grey_pyramid(grey.view());
  EXPECT_EQ(tracker.set_reference(grey_pyramid.view(), grid(), kNoise), 0);
  const std::vector<Vec2f> outside{{2, 100}, {318, 100}, {100, 2}, {100, 238}, {-50, -50}, {1e9f, 5}, {NAN, 50}};
  const Pyramid reference(first.view());
  EXPECT_EQ(tracker.set_reference(reference.view(), outside, kNoise), 0);
}

TEST(KltTracker, TakesNoMoreThanItsCapacity) {
  const Picture first = moved(0, 0);
  KltTracker tracker({});
  const std::vector<Vec2f> many(KltTracker::kMaxTracks + 50, Vec2f(100, 100));
  const Pyramid reference(first.view());
  tracker.set_reference(reference.view(), many, kNoise);
  EXPECT_EQ(tracker.tracks().size(), static_cast<std::size_t>(KltTracker::kMaxTracks));
}

}  // namespace klt_tracker_test
}  // namespace godwit::vo
