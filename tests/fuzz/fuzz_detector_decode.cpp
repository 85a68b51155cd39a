#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <vector>

#include "detector/box_carrier.h"
#include "detector/box_mask.h"
#include "detector/decode.h"

using namespace godwit::detector;

// Any numbers that a network may give: what comes out is sound and can be masked and carried.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 5) return 0;
  ModelInfo info;
  info.layout = (data[0] & 1) != 0 ? Layout::kYolox : Layout::kYolov5;
  info.placement = (data[0] & 2) != 0 ? Placement::kTopLeft : Placement::kCentre;
  info.input_width = info.input_height = 32;
  info.classes = {"a", "b"};
  info.movable = {true, false};
  const int width = 1 + data[1] * 5, height = 1 + data[2] * 4;
  const LetterboxFit fit = fit_letterbox(info, width, height);
  if (fit.width < 1 || fit.height < 1 || fit.left < 0 || fit.top < 0 || fit.left + fit.width > 32 ||
      fit.top + fit.height > 32) {
    std::abort();
  }
  std::vector<float> output(static_cast<std::size_t>(info.output_rows()) * 7, 0.F);
  std::memcpy(output.data(), data + 3, std::min(size - 3, output.size() * sizeof(float)));
  Decoder decoder(info, {});
  BoxList boxes;
  decoder.decode(output, fit, &boxes);
  for (const Box& b : boxes.view()) {
    const bool inside = b.x0 >= 0.F && b.y0 >= 0.F && b.x1 <= static_cast<float>(width) &&
                        b.y1 <= static_cast<float>(height) && b.x0 < b.x1 && b.y0 < b.y1;
    if (!inside || !(b.score >= 0.F && b.score <= 1.F) || b.class_id < 0 || b.class_id > 1) std::abort();
  }
  BoxMask mask(std::min(width, 1280), std::min(height, 1024), 3);
  mask.update(boxes.view(), info.movable);
  BoxCarrier carrier(width, height);
  carrier.advance(0, {}, {});
  if (!carrier.replace(0, boxes.view())) std::abort();
  std::vector<FeatureMotion> features((size - 3) / sizeof(FeatureMotion));
  if (!features.empty()) std::memcpy(features.data(), data + 3, features.size() * sizeof(FeatureMotion));
  carrier.advance(33'000'000, features, {});
  for (const Box& b : carrier.boxes()) {
    if (!(b.x0 >= 0.F && b.y0 >= 0.F && b.x0 < b.x1 && b.y0 < b.y1)) std::abort();
  }
  return 0;
}
