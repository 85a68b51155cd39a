// The initialisation's stages on made-up tracks of the size it meets: 400 tracks, eight views, a tenth of outliers.
#include <benchmark/benchmark.h>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "hal/rt/image.h"
#include "vo_core/features/klt_tracker.h"
#include "vo_core/geometry/rotation_fit.h"
#include "vo_core/geometry/two_view_geometry.h"
#include "vo_core/image/pyramid.h"
#include "vo_core/map/multi_view_refine.h"

namespace {

using namespace godwit;  // NOLINT: a program of its own
constexpr double kFocal = 500.0;
constexpr int kTracks = 400;
constexpr int kViews = vo::MultiViewRefiner::kMaxViews;

/// Points at depths 2 to 5, a sideways motion in kViews steps.
struct Tracks {
  std::vector<vo::Vec2> first;
  std::vector<std::vector<vo::Vec2>> views;
  vo::MultiViewState start;

  Tracks() {
    std::mt19937 random(1);
    std::uniform_real_distribution<double> side(-0.55, 0.55), depth(2.0, 5.0), coin(0.0, 1.0);
    std::normal_distribution<double> noise(0.0, 0.3 / kFocal);
    views.resize(kViews);
    for (int i = 0; i < kTracks; ++i) {
      const double z = depth(random);
      const vo::Vec3 p(side(random) * z, 0.75 * side(random) * z, z);
      first.emplace_back(p.x() / z, p.y() / z);
      for (int k = 0; k < kViews; ++k) {
        const double f = static_cast<double>(k + 1) / kViews;
        const vo::SE3 T(vo::so3_exp(f * vo::Vec3(0.02, -0.03, 0.01)), f * vo::Vec3(0.2, 0.03, 0.02));
        const vo::Vec3 q = T * p;
        vo::Vec2 xy(q.x() / q.z() + noise(random), q.y() / q.z() + noise(random));
        if (coin(random) < 0.1) xy = vo::Vec2(side(random), side(random));
        views[static_cast<std::size_t>(k)].push_back(xy);
        start.T_view_ref[static_cast<std::size_t>(k)] = {T.R, vo::so3_exp(vo::Vec3(0.05, 0.05, 0)) * T.t / 0.203};
      }
      start.inverse_depth[static_cast<std::size_t>(i)] = 0.203 / 3.0;
    }
  }
};

void fit_rotation(benchmark::State& state) {
  const Tracks t;
  std::vector<double> scratch(kTracks);
  for ([[maybe_unused]] auto _ : state) {
    vo::Mat3 R = vo::Mat3::Identity();
    benchmark::DoNotOptimize(vo::fit_rotation(t.first, t.views.back(), kFocal, scratch, &R));
  }
}
BENCHMARK(fit_rotation)->Unit(benchmark::kMicrosecond);

void two_view_geometry(benchmark::State& state) {
  const Tracks t;
  std::vector<vo::Vec2> a = t.first, b = t.views.back();
  for (auto& p : a) p *= kFocal;
  for (auto& p : b) p *= kFocal;
  vo::TwoViewGeometry geometry({});
  for ([[maybe_unused]] auto _ : state) benchmark::DoNotOptimize(geometry.estimate(a, b, kFocal));
}
BENCHMARK(two_view_geometry)->Unit(benchmark::kMicrosecond);

void multi_view_refine_4_steps(benchmark::State& state) {
  const Tracks t;
  vo::MultiViewRefiner refiner;
  refiner.begin(t.first, kFocal, 0.15);
  for (const auto& view : t.views) refiner.add_view(view);
  for ([[maybe_unused]] auto _ : state) {
    vo::MultiViewState s = t.start;
    benchmark::DoNotOptimize(refiner.refine(4, &s));
  }
}
BENCHMARK(multi_view_refine_4_steps)->Unit(benchmark::kMicrosecond);

/// A picture of bumps with its pyramid.
struct Picture {
  static constexpr int kWidth = 640, kHeight = 480;
  std::vector<std::uint8_t> storage;
  rt::PyramidView pyramid;

  explicit Picture(double dx) : storage(2 * kWidth * kHeight + 4096) {
    const auto at = reinterpret_cast<std::uintptr_t>(storage.data()) % rt::kRowAlignment;
    std::uint8_t* base = storage.data() + (rt::kRowAlignment - at) % rt::kRowAlignment;
    for (int y = 0; y < kHeight; ++y)
      for (int x = 0; x < kWidth; ++x)
        base[y * kWidth + x] = static_cast<std::uint8_t>(128 + 50 * std::sin((x - dx) * 0.31) * std::cos(y * 0.27) +
                                                         50 * std::sin((x - dx) * 0.07 + 0.09 * y));
    const std::size_t bytes = vo::pyramid_bytes(kWidth, kHeight, rt::kPyramidLevels);
    pyramid = vo::build_pyramid({base, kWidth, kHeight, kWidth}, rt::kPyramidLevels, base + kWidth * kHeight, bytes);
  }
};

void klt_track(benchmark::State& state) {
  const Picture first(0), left(3.3), right(-2.6);
  std::vector<vo::Vec2f> px;
  px.reserve(kTracks);
  for (int i = 0; i < kTracks; ++i) px.push_back(vo::Vec2(40 + 28 * (i % 20), 40 + 20 * (i / 20)).cast<float>());
  vo::KltTracker tracker({});
  int alive = tracker.set_reference(first.pyramid, px, 1.0f);
  bool flip = false;
  for ([[maybe_unused]] auto _ : state) {
    alive = tracker.track((flip = !flip) ? left.pyramid : right.pyramid);
    benchmark::DoNotOptimize(alive);
  }
  state.counters["alive"] = alive;
}
BENCHMARK(klt_track)->Unit(benchmark::kMicrosecond);

}  // namespace
