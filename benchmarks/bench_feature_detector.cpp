// New features of a keyframe: 200 over three levels, from scratch and where half of them exist.
#include "benchmarks/bench_pictures.h"
#include "vo_core/features/fast_corner.h"
#include "vo_core/features/feature_detector.h"

namespace godwit {
namespace {

constexpr int kWanted = 200;

void detect(benchmark::State& state, const vo::test::Picture& picture, bool half_exist) {
  const vo::test::Pyramid pyramid(picture.view());
  vo::FeatureDetector detector(picture.width(), picture.height(), {});
  std::vector<vo::Feature> features(kWanted);
  std::vector<vo::Vec2f> occupied;
  int wanted = kWanted;
  if (half_exist) {
    wanted = kWanted / 2;
    const int found = detector.detect(pyramid.view(), {}, {}, wanted, features);
    for (int i = 0; i < found; ++i) occupied.push_back(features[static_cast<std::size_t>(i)].px);
  }
  int found = 0;
  for ([[maybe_unused]] auto _ : state) found = detector.detect(pyramid.view(), {}, occupied, wanted, features);
  int edgelets = 0;
  for (int i = 0; i < found; ++i) edgelets += features[static_cast<std::size_t>(i)].type == vo::FeatureType::kEdgelet;
  state.counters["found"] = found;
  state.counters["edgelets"] = edgelets;
}

void fast_level0(benchmark::State& state, const vo::test::Picture& picture) {
  const rt::ImageView image = picture.view();
  std::vector<std::uint8_t> scores(static_cast<std::size_t>(image.width));
  for ([[maybe_unused]] auto _ : state) {
    for (int y = 8; y < image.height - 8; ++y) vo::fast_score_row(image, y, 8, image.width - 8, 5, scores.data());
    benchmark::DoNotOptimize(scores.data());
    benchmark::ClobberMemory();
  }
}

[[maybe_unused]] const int kRegistered =
    bench::register_for_pictures("detect", [](auto& state, const auto& picture) { detect(state, picture, false); }) +
    bench::register_for_pictures("detect_half_exist",
                                 [](auto& state, const auto& picture) { detect(state, picture, true); }) +
    bench::register_for_pictures("fast_level0", fast_level0);

}  // namespace
}  // namespace godwit
