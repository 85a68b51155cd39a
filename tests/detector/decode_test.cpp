#include "detector/decode.h"

#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <random>
#include <vector>

namespace godwit::detector::decode_test {
namespace {

ModelInfo model(Layout layout = Layout::kYolov5, int side = 416) {
  ModelInfo info;
  info.layout = layout;
  info.input_width = info.input_height = side;
  info.classes = {"person", "car"};
  info.movable = {true, true};
  return info;
}

struct Output {
  explicit Output(const ModelInfo& info) : values(5 + info.classes.size()) {
    data.assign(static_cast<std::size_t>(info.output_rows()) * values, 0.F);
  }
  void set(int row, const std::vector<float>& v) {
    std::copy(v.begin(), v.end(), data.begin() + static_cast<std::ptrdiff_t>(static_cast<std::size_t>(row) * values));
  }
  std::size_t values;
  std::vector<float> data;
};

TEST(Letterbox, CentresAndKeepsTheAspect) {
  const LetterboxFit fit = fit_letterbox(model(), 640, 480);
  EXPECT_FLOAT_EQ(fit.scale, 0.65F);
  EXPECT_EQ(fit.width, 416);
  EXPECT_EQ(fit.height, 312);
  EXPECT_EQ(fit.left, 0);
  EXPECT_EQ(fit.top, 52);
  ModelInfo corner = model();
  corner.placement = Placement::kTopLeft;
  EXPECT_EQ(fit_letterbox(corner, 640, 480).top, 0);
}

TEST(Letterbox, ARectangleShowsACamerasPictureLarger) {
  ModelInfo wide = model();
  wide.input_width = 480;
  wide.input_height = 352;
  const LetterboxFit fit = fit_letterbox(wide, 640, 480);
  EXPECT_FLOAT_EQ(fit.scale, 352.F / 480.F);
  EXPECT_EQ(fit.width, 469);
  EXPECT_EQ(fit.height, 352);
  EXPECT_EQ(fit.left, 5);
  EXPECT_EQ(fit.top, 0);
  Output out(wide);
  out.set(0, {240.F, 176.F, 44.F, 88.F, 0.9F, 0.8F, 0.1F});
  Decoder decoder(wide, {});
  BoxList boxes;
  decoder.decode(out.data, fit, &boxes);
  ASSERT_EQ(boxes.count, 1);
  EXPECT_NEAR(boxes.box[0].x0, (240 - 22 - 5) / fit.scale, 1e-3);
  EXPECT_NEAR(boxes.box[0].y1, (176 + 44) / fit.scale, 1e-3);
}

TEST(Letterbox, AVeryLongPictureKeepsOneRow) {
  const LetterboxFit fit = fit_letterbox(model(), 5000, 1);
  EXPECT_EQ(fit.height, 1);
  EXPECT_EQ(fit.width, 416);
}

TEST(Decode, BringsABoxBackToThePicture) {
  const ModelInfo info = model();
  Output out(info);
  out.set(7, {208.F, 208.F, 65.F, 130.F, 0.9F, 0.1F, 0.8F});
  Decoder decoder(info, {});
  BoxList boxes;
  decoder.decode(out.data, fit_letterbox(info, 640, 480), &boxes);
  ASSERT_EQ(boxes.count, 1);
  const Box& b = boxes.box[0];
  EXPECT_EQ(b.class_id, 1);
  EXPECT_NEAR(b.score, 0.72F, 1e-6F);
  EXPECT_NEAR(b.x0, 320 - 50, 1e-3);
  EXPECT_NEAR(b.x1, 320 + 50, 1e-3);
  EXPECT_NEAR(b.y0, 240 - 100, 1e-3);
  EXPECT_NEAR(b.y1, 240 + 100, 1e-3);
}

TEST(Decode, YoloxIsRelativeToCellAndStride) {
  ModelInfo info = model(Layout::kYolox);
  info.placement = Placement::kTopLeft;
  Output out(info);
  // Row 52 * 52 + 26 * 3 + 5: stride 16, row 3, column 5.
  out.set(52 * 52 + 26 * 3 + 5, {0.5F, 0.25F, std::log(2.F), std::log(4.F), 1.F, 1.F, 0.F});
  Decoder decoder(info, {});
  BoxList boxes;
  decoder.decode(out.data, fit_letterbox(info, 416, 416), &boxes);
  ASSERT_EQ(boxes.count, 1);
  EXPECT_NEAR(boxes.box[0].x0, 5.5 * 16 - 16, 1e-3);
  EXPECT_NEAR(boxes.box[0].y0, 3.25 * 16 - 32, 1e-3);
  EXPECT_NEAR(boxes.box[0].x1, 5.5 * 16 + 16, 1e-3);
  EXPECT_NEAR(boxes.box[0].y1, 3.25 * 16 + 32, 1e-3);
}

TEST(Decode, SuppressesWithinAClassOnly) {
  const ModelInfo info = model();
  Output out(info);
  out.set(0, {100.F, 100.F, 50.F, 50.F, 0.8F, 1.F, 0.F});
  out.set(1, {102.F, 100.F, 50.F, 50.F, 0.9F, 1.F, 0.F});  // the same person, surer
  out.set(2, {100.F, 100.F, 50.F, 50.F, 0.7F, 0.F, 1.F});  // a car in the same place stays
  out.set(3, {300.F, 100.F, 50.F, 50.F, 0.6F, 1.F, 0.F});  // another person
  out.set(4, {300.F, 300.F, 50.F, 50.F, 0.2F, 1.F, 0.F});  // below the threshold
  Decoder decoder(info, {});
  BoxList boxes;
  decoder.decode(out.data, fit_letterbox(info, 416, 416), &boxes);
  ASSERT_EQ(boxes.count, 3);
  EXPECT_FLOAT_EQ(boxes.box[0].score, 0.9F);
  EXPECT_EQ(boxes.box[1].class_id, 1);
  EXPECT_FLOAT_EQ(boxes.box[2].x0, 275.F);
}

TEST(Decode, WhatReachesOutOfThePartAskedForSuppressesNothing) {
  const ModelInfo info = model();
  Output out(info);
  out.set(0, {100.F, 100.F, 50.F, 50.F, 0.8F, 1.F, 0.F});
  out.set(1, {102.F, 100.F, 50.F, 50.F, 0.9F, 1.F, 0.F});  // surer, to x = 127
  Decoder decoder(info, {});
  BoxList boxes;
  Box inside = Decoder::kAnywhere;
  inside.x1 = 126.F;
  decoder.decode(out.data, fit_letterbox(info, 416, 416), &boxes, inside);
  ASSERT_EQ(boxes.count, 1);
  EXPECT_FLOAT_EQ(boxes.box[0].x1, 125.F);
  inside.x0 = 76.F;
  decoder.decode(out.data, fit_letterbox(info, 416, 416), &boxes, inside);
  EXPECT_EQ(boxes.count, 0);
}

TEST(Decode, DropsWhatIsNotFiniteAndClipsWhatIsAbsurd) {
  const ModelInfo info = model();
  const float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
  Output out(info);
  out.set(0, {nan, 100.F, 50.F, 50.F, 0.9F, 1.F, 0.F});
  out.set(1, {100.F, 100.F, inf, 50.F, 0.9F, 1.F, 0.F});
  out.set(2, {100.F, 100.F, 50.F, 50.F, nan, 1.F, 0.F});
  out.set(3, {100.F, 100.F, 50.F, 50.F, 0.9F, nan, 1.F});
  out.set(4, {100.F, 100.F, 50.F, 50.F, 3e38F, 1.F, 0.F});
  out.set(5, {100.F, 100.F, -50.F, 50.F, 0.9F, 1.F, 0.F});
  out.set(6, {-900.F, 100.F, 50.F, 50.F, 0.9F, 1.F, 0.F});
  out.set(7, {200.F, 200.F, 1e30F, 1e30F, 0.9F, 1.F, 0.F});
  Decoder decoder(info, {});
  BoxList boxes;
  decoder.decode(out.data, fit_letterbox(info, 640, 480), &boxes);
  ASSERT_EQ(boxes.count, 1);
  EXPECT_FLOAT_EQ(boxes.box[0].x0, 0.F);
  EXPECT_FLOAT_EQ(boxes.box[0].y0, 0.F);
  EXPECT_FLOAT_EQ(boxes.box[0].x1, 640.F);
  EXPECT_FLOAT_EQ(boxes.box[0].y1, 480.F);
}

TEST(Decode, AnOutputOfAnotherSizeGivesNothing) {
  const ModelInfo info = model();
  Output out(info);
  out.set(0, {100.F, 100.F, 50.F, 50.F, 0.9F, 1.F, 0.F});
  Decoder decoder(info, {});
  BoxList boxes;
  decoder.decode(std::span<const float>(out.data).first(out.data.size() - 1), fit_letterbox(info, 416, 416), &boxes);
  EXPECT_EQ(boxes.count, 0);
}

TEST(Decode, TenThousandBoxesKeepTheSurest) {
  const ModelInfo info = model();
  Output out(info);
  std::mt19937 rng(1);
  std::uniform_real_distribution<float> place(5.F, 411.F), score(0.3F, 1.F);
  float surest = 0.F;
  for (int row = 0; row < 10'000; ++row) {
    const float s = score(rng);
    surest = std::max(surest, s);
    out.set(row, {place(rng), place(rng), 6.F, 6.F, s, 1.F, 0.F});
  }
  Decoder decoder(info, {});
  BoxList boxes;
  decoder.decode(out.data, fit_letterbox(info, 416, 416), &boxes);
  ASSERT_EQ(boxes.count, kMaxBoxes);
  EXPECT_FLOAT_EQ(boxes.box[0].score, surest);
  for (int i = 1; i < boxes.count; ++i) {
    EXPECT_GE(boxes.box[static_cast<std::size_t>(i - 1)].score, boxes.box[static_cast<std::size_t>(i)].score);
    for (int j = 0; j < i; ++j) {
      EXPECT_LE(overlap(boxes.box[static_cast<std::size_t>(i)], boxes.box[static_cast<std::size_t>(j)]), 0.45F);
    }
  }
}

TEST(Overlap, OfKnownBoxes) {
  const Box a{0, 0, 10, 10, 1, 0}, b{5, 0, 15, 10, 1, 0}, c{20, 20, 30, 30, 1, 0};
  EXPECT_FLOAT_EQ(overlap(a, a), 1.F);
  EXPECT_FLOAT_EQ(overlap(a, b), 1.F / 3.F);
  EXPECT_FLOAT_EQ(overlap(a, c), 0.F);
}

}  // namespace
}  // namespace godwit::detector::decode_test
