// A small map with exact truth, for the tests of what adjusts it.
#pragma once

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "tests/vo_core/test_cameras.h"
#include "vo_core/map/map.h"

namespace godwit::vo::test {

// Six keyframes along a line look at 150 points.
struct BundleWorld {
  CameraModel camera = euroc();
  Map map;
  std::vector<Vec3> points;
  std::vector<SE3> poses;

  /// Of ten points so many are edgelets, measured along one direction only; across it they may be off by any amount.
  /// common_px: noise of a point that all views but the first share, as those that are aligned with one patch do.
  explicit BundleWorld(double noise_px, int edgelets_of_ten = 0, unsigned seed = 5, double common_px = 0.0) {
    std::mt19937 random_of_points(seed + 1000);
    std::normal_distribution<double> common(0.0, 1.0);
    std::mt19937 random(seed);
    std::uniform_real_distribution<double> xy(-1.0, 1.0), z(1.5, 4.0);
    std::normal_distribution<double> noise(0.0, noise_px);
    for (int i = 0; i < 150; ++i) {
      const double d = z(random);
      points.emplace_back(xy(random) * 0.6 * d, xy(random) * 0.4 * d, d);
    }
    for (int k = 0; k < 6; ++k) {
      poses.push_back(SE3::exp((Vec6() << -0.1 * k, 0.02 * k, 0.01 * k, 0.0, 0.01 * k, 0.0).finished()));
      Keyframe& kf = map.insert_keyframe(k, static_cast<std::uint32_t>(k + 1));
      kf.T_kf_world = poses.back();
    }
    for (std::size_t i = 0; i < points.size(); ++i) {
      const PointHandle h = map.free_point();
      map.activate_point(h, points[i]);
      const Vec2 shared = common_px * Vec2(common(random_of_points), common(random_of_points));
      for (int k = 0; k < 6; ++k) {
        Vec2 px;
        if (!camera.project(poses[static_cast<std::size_t>(k)] * points[i], &px) || !camera.in_image(px, 5)) continue;
        KeyframeFeature f;
        const Vec2 off = k > 0 ? shared : Vec2(0.0, 0.0);
        f.px = f.px_global = (px + off + Vec2(noise(random), noise(random))).cast<float>();
        f.bearing = camera.unproject(px);
        f.point = h;
        if (static_cast<int>(i % 10) < edgelets_of_ten) {
          f.type = FeatureType::kEdgelet;
          // The world's edge is one and the same; here the views hardly roll, and neither does its normal.
          f.gradient = i % 2 == 0 ? Vec2f(1.0f, 0.0f) : Vec2f(0.8f, 0.6f);
          f.px_global += 3.0f * static_cast<float>(k) * Vec2f(-f.gradient.y(), f.gradient.x());
        }
        map.append_feature(k, f);
      }
    }
  }

  void disturb() {
    std::mt19937 random(6);
    std::normal_distribution<double> t(0.0, 0.01), r(0.0, 0.004), p(0.0, 0.05);
    for (int k = 2; k < 6; ++k)
      map.keyframe(k).T_kf_world =
          SE3::exp((Vec6() << t(random), t(random), t(random), r(random), r(random), r(random)).finished()) *
          map.keyframe(k).T_kf_world;
    for (int i = 0; i < map.point_end(); ++i) map.point(i).p_world += Vec3(p(random), p(random), p(random));
  }

  double pose_error() const {
    // Scale is free: compare directions of the motion and rotations.
    double worst = 0.0;
    for (int k = 1; k < 6; ++k) {
      const SE3& a = map.keyframe(k).T_kf_world;
      worst = std::max(worst, so3_log(a.R * poses[static_cast<std::size_t>(k)].R.transpose()).norm());
      const Vec3 c = map.keyframe(k).position().normalized();
      const Vec3 truth = poses[static_cast<std::size_t>(k)].centre().normalized();
      worst = std::max(worst, std::acos(std::min(1.0, c.dot(truth))));
    }
    return worst;
  }
};

}  // namespace godwit::vo::test
