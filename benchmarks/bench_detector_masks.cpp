// What the detector's boxes cost the tracker thread in every frame: carrying them and masking them at every level.
#include <benchmark/benchmark.h>
#include <cstdint>
#include <vector>

#include "detector/box_carrier.h"
#include "detector/box_mask.h"

namespace {

using namespace godwit::detector;

/// Eight walkers, 400 features: each frame is carried and masked at five levels of 640x480.
void carry_and_mask(benchmark::State& state) {
  BoxList boxes;
  for (int i = 0; i < 8; ++i) {
    const float x = 20.F + 70.F * static_cast<float>(i);
    boxes.push({x, 120.F, x + 60.F, 400.F, 0.8F, 0});
  }
  std::vector<FeatureMotion> features(400);
  for (std::size_t i = 0; i < features.size(); ++i) {
    const std::size_t row = i / 20, column = i % 20;
    const float x = static_cast<float>(column) * 32.F, y = static_cast<float>(row) * 24.F;
    features[i] = {x, y, x + 0.1F, y};
  }
  CarrierLimits limits;
  limits.max_age_ns = INT64_MAX;
  BoxCarrier carrier(640, 480, limits);
  BoxMask mask(640, 480, 5);
  const std::vector<bool> movable = {true};
  std::int64_t t_ns = 0;
  carrier.advance(t_ns, features, {});
  carrier.replace(t_ns, boxes.view());
  for ([[maybe_unused]] auto _ : state) {
    t_ns += 33'000'000;
    carrier.advance(t_ns, features, {});
    if (t_ns % 330'000'000 == 0) carrier.replace(t_ns, boxes.view());
    mask.update(carrier.boxes(), movable);
    benchmark::DoNotOptimize(mask.view().level[0].data);
  }
}
BENCHMARK(carry_and_mask)->Unit(benchmark::kMicrosecond);

}  // namespace
