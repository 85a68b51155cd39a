// One call of the camera models, over pixels spread on the picture.
#include <benchmark/benchmark.h>
#include <vector>

#include "tests/vo_core/test_cameras.h"

namespace godwit::vo {
namespace {

std::vector<Vec2> pixels(const CameraModel& camera) {
  std::vector<Vec2> list;
  for (int v = 4; v < camera.height(); v += 29) {
    for (int u = 4; u < camera.width(); u += 31) list.emplace_back(u + 0.3, v + 0.7);
  }
  return list;
}

void project(benchmark::State& state, CameraModel (*make)(), bool jacobian) {
  const CameraModel camera = make();
  std::vector<Vec3> points;
  for (const Vec2& px : pixels(camera)) points.push_back(3.0 * camera.unproject(px));
  std::size_t i = 0;
  Vec2 px;
  Mat23 J;
  for ([[maybe_unused]] auto _ : state) {
    benchmark::DoNotOptimize(camera.project(points[i], &px, jacobian ? &J : nullptr));
    benchmark::DoNotOptimize(px.data());
    i = i + 1 == points.size() ? 0 : i + 1;
  }
}

void unproject(benchmark::State& state, CameraModel (*make)()) {
  const CameraModel camera = make();
  const std::vector<Vec2> list = pixels(camera);
  std::size_t i = 0;
  for ([[maybe_unused]] auto _ : state) {
    benchmark::DoNotOptimize(camera.unproject(list[i]));
    i = i + 1 == list.size() ? 0 : i + 1;
  }
}

BENCHMARK_CAPTURE(project, tum_fr1, &test::tum_fr1, false);
BENCHMARK_CAPTURE(project, tum_fr1_jacobian, &test::tum_fr1, true);
BENCHMARK_CAPTURE(project, euroc, &test::euroc, false);
BENCHMARK_CAPTURE(project, fisheye, &test::fisheye, false);
BENCHMARK_CAPTURE(project, fisheye_jacobian, &test::fisheye, true);
BENCHMARK_CAPTURE(unproject, tum_fr1, &test::tum_fr1);
BENCHMARK_CAPTURE(unproject, euroc, &test::euroc);
BENCHMARK_CAPTURE(unproject, fisheye, &test::fisheye);

}  // namespace
}  // namespace godwit::vo
