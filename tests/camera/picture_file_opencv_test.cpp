// Pictures decoded with libjpeg-turbo and libpng against OpenCV's: equal to the bit, so that recordings fly the same.
#include <algorithm>
#include <array>
#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "hal/camera/replay/picture_file.h"
#include "tests/support/temp_folder.h"

namespace godwit::hal::picture_file_opencv_test {
namespace {

cv::Mat noise(int channels, int depth = CV_8U) {
  cv::Mat out(47, 61, CV_MAKETYPE(depth, channels));
  cv::RNG random(static_cast<std::uint64_t>(channels));
  random.fill(out, cv::RNG::UNIFORM, 0, depth == CV_8U ? 256 : 65536);
  return out;
}

struct Kind {
  const char* name;
  int channels;
};

class EachPicture : public testing::TestWithParam<Kind> {};

TEST_P(EachPicture, IsWhatOpenCvReads) {
  const test::TempFolder folder;
  const std::string file = folder / GetParam().name;
  ASSERT_TRUE(cv::imwrite(file, noise(GetParam().channels)));
  PictureDecoder decoder;
  const auto loaded = decoder.load(file);
  ASSERT_TRUE(loaded.ok()) << loaded.error().message;
  const cv::Mat stored = cv::imread(file, cv::IMREAD_UNCHANGED | cv::IMREAD_IGNORE_ORIENTATION);
  ASSERT_EQ(decoder.width(), stored.cols);
  ASSERT_EQ(decoder.height(), stored.rows);
  cv::Mat wanted_grey = stored, wanted_bgr = stored;
  if (stored.channels() == 3) cv::cvtColor(stored, wanted_grey, cv::COLOR_BGR2GRAY);
  if (stored.channels() == 4) cv::cvtColor(stored, wanted_grey, cv::COLOR_BGRA2GRAY);
  if (stored.channels() == 1) cv::cvtColor(stored, wanted_bgr, cv::COLOR_GRAY2BGR);
  if (stored.channels() == 4) cv::cvtColor(stored, wanted_bgr, cv::COLOR_BGRA2BGR);
  cv::Mat grey(stored.rows, stored.cols + 3, CV_8UC1), bgr(stored.rows, stored.cols, CV_8UC3);
  decoder.write_grey({grey.data, stored.cols, stored.rows, static_cast<int>(grey.step)});
  decoder.write_bgr(bgr.data);
  EXPECT_EQ(cv::norm(grey.colRange(0, stored.cols), wanted_grey, cv::NORM_INF), 0);
  EXPECT_EQ(cv::norm(bgr, wanted_bgr, cv::NORM_INF), 0);
}

INSTANTIATE_TEST_SUITE_P(Kinds, EachPicture,
                         testing::Values(Kind{"grey.png", 1}, Kind{"colour.png", 3}, Kind{"alpha.png", 4},
                                         Kind{"grey.jpg", 1}, Kind{"colour.jpg", 3}));

TEST(PictureFile, OtherThanEightBitsIsRefused) {
  const test::TempFolder folder;
  const std::string file = folder / "deep.png";
  ASSERT_TRUE(cv::imwrite(file, noise(1, CV_16U)));
  const auto loaded = PictureDecoder().load(file);
  ASSERT_FALSE(loaded.ok());
  EXPECT_EQ(loaded.error().message, file + ": 1 channels of 16 bits; 1, 3 or 4 channels of 8 bits are wanted");
}

TEST(PictureFile, AHugeSizeIsRefusedByItsHeader) {
  // Grey, 60000 x 60000: would be 3.6 GB. The header's checksum is right, and the end is there.
  constexpr unsigned char kPng[] =
      "\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\xea\x60\0\0\xea\x60\x08\0\0\0\0\xa5\xb9\x2a\x9e"
      "\0\0\0\0IDAT\x35\xaf\x06\x1e\0\0\0\0IEND\xae\x42\x60\x82";
  DecodedPicture out;
  const std::string wrong = decode_picture({kPng, sizeof(kPng) - 1}, &out);
  EXPECT_EQ(wrong, "60000 x 60000 pixels; at most 8192 x 8192 are read");
  EXPECT_TRUE(out.pixels.empty());
}

TEST(PictureFile, AHugeSizeOfAJpegIsRefusedByItsHeader) {
  std::vector<std::uint8_t> jpeg;
  ASSERT_TRUE(cv::imencode(".jpg", noise(1, CV_8U), jpeg));
  const std::array<std::uint8_t, 2> frame = {0xFF, 0xC0};
  const auto at = std::search(jpeg.begin(), jpeg.end(), frame.begin(), frame.end());
  ASSERT_GT(jpeg.end() - at, 9);
  // Marker, length, bits, then height and width: 60000.
  for (const int side : {5, 7}) at[side] = 0xEA, at[side + 1] = 0x60;
  DecodedPicture out;
  EXPECT_EQ(decode_picture(jpeg, &out), "60000 x 60000 pixels; at most 8192 x 8192 are read");
  EXPECT_TRUE(out.pixels.empty());
}

TEST(PictureFile, WhatIsNeitherIsRefused) {
  const std::string bmp = "BM......................................................";
  DecodedPicture out;
  EXPECT_EQ(decode_picture({reinterpret_cast<const std::uint8_t*>(bmp.data()), bmp.size()}, &out),
            "not a picture that can be decoded: neither a JPEG nor a PNG");
}

}  // namespace
}  // namespace godwit::hal::picture_file_opencv_test
