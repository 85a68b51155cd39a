#include "hal/camera/replay/png_encoder.h"

#include <gtest/gtest.h>

#include "hal/camera/replay/picture_codec.h"

namespace godwit::hal::png_encoder_test {
namespace {

TEST(PngEncoder, WhatIsPackedIsReadAgainToTheBit) {
  constexpr int kWidth = 37, kHeight = 23, kStride = 64;
  std::vector<std::uint8_t> grey(static_cast<std::size_t>(kStride) * kHeight, 255), packed;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x)
      grey[static_cast<std::size_t>(y * kStride + x)] = static_cast<std::uint8_t>(7 * x + 31 * y * y);
  }
  for (int twice = 0; twice < 2; ++twice) ASSERT_EQ(encode_png({grey.data(), kWidth, kHeight, kStride}, &packed), "");
  DecodedPicture read;
  ASSERT_EQ(decode_picture(packed, &read), "");
  ASSERT_EQ(read.width, kWidth);
  ASSERT_EQ(read.height, kHeight);
  ASSERT_EQ(read.channels, 1);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      ASSERT_EQ(read.pixels[static_cast<std::size_t>(y * kWidth + x)], grey[static_cast<std::size_t>(y * kStride + x)]);
    }
  }
}

TEST(PngEncoder, APictureWithoutSizeIsAWord) {
  std::vector<std::uint8_t> packed;
  EXPECT_NE(encode_png({}, &packed), "");
}

}  // namespace
}  // namespace godwit::hal::png_encoder_test
