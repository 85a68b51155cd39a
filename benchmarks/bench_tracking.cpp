// The stages of tracking and mapping on made-up data of the size a frame has: 170 features.
#include <benchmark/benchmark.h>
#include <cmath>
#include <cstdint>
#include <memory>
#include <random>
#include <vector>

#include "vo_core/features/feature_align.h"
#include "vo_core/image/pyramid.h"
#include "vo_core/map/bundle_adjuster.h"
#include "vo_core/map/depth_filter.h"
#include "vo_core/tracking/pose_optimizer.h"
#include "vo_core/tracking/sparse_image_align.h"

namespace {

using namespace godwit;  // NOLINT: a program of its own
constexpr int kFeatures = 170;

vo::CameraModel camera() {
  return vo::CameraModel::pinhole_radtan(640, 480, 517.3, 516.5, 318.6, 255.3, {0.26, -0.95, -0.005, 0.003, 1.16})
      .value();
}

/// A picture of waves, and its pyramid.
struct View {
  std::vector<std::uint8_t> pixels, storage;
  rt::PyramidView pyramid;

  explicit View(double shift) : pixels(640 * 480 + 128), storage(vo::pyramid_bytes(640, 480, 5) + 128) {
    for (int y = 0; y < 480; ++y)
      for (int x = 0; x < 640; ++x)
        pixels[static_cast<std::size_t>(y * 640 + x)] = static_cast<std::uint8_t>(
            128 + 50 * std::sin(0.21 * (x - shift) + 0.07 * y) + 50 * std::cos(0.17 * y - 0.05 * (x - shift)));
    void* at = storage.data();
    std::size_t left = storage.size();
    std::align(64, vo::pyramid_bytes(640, 480, 5), at, left);
    pyramid = vo::build_pyramid({pixels.data(), 640, 480, 640}, 5, static_cast<std::uint8_t*>(at), left);
  }
};

void sparse_image_align(benchmark::State& state) {
  const vo::CameraModel cam = camera();
  const View ref(0.0), cur(1.5);
  std::mt19937 random(1);
  std::uniform_real_distribution<float> u(40, 600), v(40, 440);
  std::vector<vo::AlignPoint> points;
  for (int i = 0; i < kFeatures; ++i) {
    const vo::Vec2f px(u(random), v(random));
    points.push_back({px, cam.unproject(px.cast<double>()) * 2.0});
  }
  vo::SparseImageAlign align(cam, {});
  for ([[maybe_unused]] auto _ : state)
    benchmark::DoNotOptimize(align.run(ref.pyramid, cur.pyramid, points, vo::SE3(), {}));
}
BENCHMARK(sparse_image_align)->Unit(benchmark::kMicrosecond);

void align_one_feature(benchmark::State& state) {
  const View ref(0.0), cur(1.5);
  vo::ReferencePatch patch;
  for (int y = 0; y < vo::kPatchBorderSize; ++y)
    for (int x = 0; x < vo::kPatchBorderSize; ++x)
      patch.value[static_cast<std::size_t>(y * vo::kPatchBorderSize + x)] = ref.pyramid.level[0].at(295 + x, 195 + y);
  for ([[maybe_unused]] auto _ : state) {
    vo::Vec2f px(300.0f, 200.0f);
    vo::AlignTemplate prepared;
    benchmark::DoNotOptimize(vo::prepare_align_2d(patch, &prepared));
    benchmark::DoNotOptimize(vo::align(cur.pyramid.level[0], prepared, 8, 4.0f, &px));
  }
}
BENCHMARK(align_one_feature)->Unit(benchmark::kNanosecond);

void optimize_pose(benchmark::State& state) {
  const vo::CameraModel cam = camera();
  std::mt19937 random(2);
  std::uniform_real_distribution<double> u(20, 620), v(20, 460), d(1.0, 4.0);
  std::normal_distribution<double> noise(0.0, 0.4);
  std::vector<vo::PoseMeasurement> m;
  for (int i = 0; i < kFeatures; ++i) {
    const vo::Vec2 px(u(random), v(random));
    vo::PoseMeasurement x;
    x.p_world = cam.unproject(px) * d(random);
    x.px = px + vo::Vec2(noise(random), noise(random));
    m.push_back(x);
  }
  for ([[maybe_unused]] auto _ : state) {
    vo::SE3 T = vo::SE3::exp((vo::Vec6() << 0.01, 0.01, -0.01, 0.002, 0.003, -0.002).finished());
    benchmark::DoNotOptimize(vo::optimize_pose(cam, {}, m, &T));
  }
}
BENCHMARK(optimize_pose)->Unit(benchmark::kMicrosecond);

void update_depth_filter(benchmark::State& state) {
  vo::DepthEstimate e = vo::DepthEstimate::prior(2.0, 0.5);
  for ([[maybe_unused]] auto _ : state) {
    vo::DepthEstimate x = e;
    x.update(0.45, 0.01);
    benchmark::DoNotOptimize(x);
  }
}
BENCHMARK(update_depth_filter)->Unit(benchmark::kNanosecond);

/// Fifteen keyframes that share 600 points.
void bundle_adjustment(benchmark::State& state) {
  const vo::CameraModel cam = camera();
  auto map = std::make_unique<vo::Map>();
  std::mt19937 random(3);
  std::uniform_real_distribution<double> side(-1.0, 1.0), depth(1.5, 4.0);
  std::normal_distribution<double> noise(0.0, 0.3);
  for (int k = 0; k < 15; ++k)
    map->insert_keyframe(k, static_cast<std::uint32_t>(k + 1)).T_kf_world =
        vo::SE3::exp((vo::Vec6() << -0.05 * k, 0.01 * k, 0, 0, 0.005 * k, 0).finished());
  for (int i = 0; i < 600; ++i) {
    const double z = depth(random);
    const vo::Vec3 p(0.6 * side(random) * z, 0.4 * side(random) * z, z);
    const vo::PointHandle h = map->free_point();
    map->activate_point(h, p);
    for (int k = i % 3; k < 15; k += 2) {
      vo::Vec2 px;
      if (!cam.project(map->keyframe(k).T_kf_world * p, &px) || !cam.in_image(px, 5)) continue;
      vo::KeyframeFeature f;
      f.px_global = (px + vo::Vec2(noise(random), noise(random))).cast<float>();
      f.point = h;
      map->append_feature(k, f);
    }
  }
  vo::BundleAdjuster bundle(cam, {});
  for ([[maybe_unused]] auto _ : state) benchmark::DoNotOptimize(bundle.run(map.get(), 14));
}
BENCHMARK(bundle_adjustment)->Unit(benchmark::kMillisecond);

}  // namespace
