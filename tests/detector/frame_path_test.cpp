// What runs on the tracker thread for every frame must not touch the heap: carrying, masking; and decoding neither.
#include <algorithm>
#include <gtest/gtest.h>
#include <vector>

#include "detector/box_carrier.h"
#include "detector/box_mask.h"
#include "detector/decode.h"
#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"

namespace godwit::detector::frame_path_test {
namespace {

TEST(FramePath, CarriesAndMasksAndDecodesWithoutTheHeap) {
  ModelInfo info;
  info.input_width = info.input_height = 416;
  info.classes = {"person", "car"};
  info.movable = {true, true};
  std::vector<float> output(static_cast<std::size_t>(info.output_rows()) * 7, 0.F);
  for (std::size_t row = 0; row < 5'000; ++row) {
    const float at = static_cast<float>(row % 400);
    const float values[] = {at, at, 20.F, 30.F, 0.3F + 0.0001F * static_cast<float>(row), 1.F, 0.F};
    std::copy(std::begin(values), std::end(values), output.begin() + static_cast<std::ptrdiff_t>(row * 7));
  }
  const LetterboxFit fit = fit_letterbox(info, 640, 480);
  Decoder decoder(info, {});
  BoxMask mask(640, 480, 5);
  BoxCarrier carrier(640, 480);
  BoxList boxes;
  std::vector<FeatureMotion> features(400);
  for (std::size_t i = 0; i < features.size(); ++i) {
    const float x = static_cast<float>(i % 20) * 32.F, y = static_cast<float>(i / 20) * 24.F;
    features[i] = {x, y, x + 1.F, y};
  }
  const rt::HeapCounts before = rt::rt_heap_counts();
  {
    const rt::RtScope scope;
    for (int frame = 0; frame < 100; ++frame) {
      carrier.advance(frame * 33'000'000LL, features, {});
      if (frame % 10 == 0) {
        decoder.decode(output, fit, &boxes);
        carrier.replace(frame * 33'000'000LL, boxes.view());
      }
      mask.update(carrier.boxes(), info.movable);
    }
  }
  const rt::HeapCounts after = rt::rt_heap_counts();
  EXPECT_EQ(after.allocations, before.allocations);
  EXPECT_EQ(after.frees, before.frees);
  EXPECT_GT(boxes.count, 0);
  EXPECT_FALSE(carrier.boxes().empty());
  const rt::ImageView& m = mask.view().level[0];
  EXPECT_TRUE(std::any_of(m.data, m.row(m.height - 1) + m.width, [](std::uint8_t p) { return p != 0; }));
}

}  // namespace
}  // namespace godwit::detector::frame_path_test
