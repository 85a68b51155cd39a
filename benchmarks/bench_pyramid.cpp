// The pyramid of a frame: five levels by half-sampling.
#include "benchmarks/bench_pictures.h"
#include "vo_core/image/pyramid.h"

namespace godwit {
namespace {

void five_levels(benchmark::State& state, const vo::test::Picture& picture) {
  const rt::ImageView base = picture.view();
  const std::size_t bytes = vo::pyramid_bytes(base.width, base.height, rt::kPyramidLevels);
  auto* storage = static_cast<std::uint8_t*>(std::aligned_alloc(rt::kRowAlignment, bytes));
  for ([[maybe_unused]] auto _ : state) {
    benchmark::DoNotOptimize(vo::build_pyramid(base, rt::kPyramidLevels, storage, bytes));
    benchmark::ClobberMemory();
  }
  std::free(storage);
}

[[maybe_unused]] const int kRegistered = bench::register_for_pictures("pyramid", five_levels);

}  // namespace
}  // namespace godwit
