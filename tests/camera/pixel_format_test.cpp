#include "hal/camera/pixels/pixel_format.h"

#include <algorithm>
#include <cstring>
#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>
#include <random>
#include <vector>

#include "hal/camera/pixels/yuv_rows.h"

namespace godwit::hal::pixel_format_test {
namespace {

constexpr int kWidth = 38, kHeight = 22;

/// Pixels of a format in rows with padding, which must never be read into a picture.
struct Padded {
  explicit Padded(PixelFormat f, int value_range)
      : format(f), stride(row_bytes(f, kWidth) + 26), bytes(picture_bytes(f, kWidth, kHeight, stride), 0xEE) {
    cv::RNG random(5);
    const int rows = f == PixelFormat::kNv12 ? kHeight + kHeight / 2 : kHeight;
    for (int y = 0; y < rows; ++y) {
      for (int i = 0; i < row_bytes(f, kWidth); ++i) {
        bytes[static_cast<std::size_t>(y * stride + i)] = static_cast<std::uint8_t>(random.uniform(0, 256));
      }
      if (value_range == 256) continue;
      for (int x = 0; x < kWidth; ++x) {
        const auto v = static_cast<std::uint16_t>(random.uniform(0, value_range));
        std::memcpy(&bytes[static_cast<std::size_t>(y * stride + 2 * x)], &v, 2);
      }
    }
  }
  cv::Mat mat(int type, int rows = kHeight) { return cv::Mat(rows, kWidth, type, bytes.data(), stride); }

  PixelFormat format;
  int stride;
  std::vector<std::uint8_t> bytes;
};

struct Converted {
  explicit Converted(const Padded& p, int shift = 0) : grey(kHeight, kWidth, CV_8U), bgr(kHeight, kWidth, CV_8UC3) {
    convert({p.bytes.data(), p.stride, p.format, shift}, {grey.data, kWidth, kHeight, kWidth}, bgr.data);
  }
  cv::Mat grey, bgr;
};

double worst(const cv::Mat& a, const cv::Mat& b) {
  return cv::norm(a, b, cv::NORM_INF);
}

TEST(PixelFormat, GreyAndSixteenBits) {
  Padded grey(PixelFormat::kGrey, 256);
  const Converted a(grey);
  EXPECT_EQ(worst(a.grey, grey.mat(CV_8U)), 0);
  EXPECT_EQ(a.bgr.at<cv::Vec3b>(3, 4)[2], a.grey.at<std::uint8_t>(3, 4));
  Padded ten(PixelFormat::kY10, 1024);
  const Converted b(ten, usual_shift(PixelFormat::kY10));
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x)
      ASSERT_EQ(b.grey.at<std::uint8_t>(y, x), ten.mat(CV_16U).at<std::uint16_t>(y, x) / 4);
  }
  // A sensor that uses more bits than it says is cut off at white, not wrapped around to black.
  const Converted cut(ten, 1);
  EXPECT_EQ(cut.grey.at<std::uint8_t>(0, 0), std::min(255, ten.mat(CV_16U).at<std::uint16_t>(0, 0) / 2));
  EXPECT_EQ(usual_shift(PixelFormat::kY16), 8);
}

TEST(PixelFormat, YuvAsOpenCvConvertsIt) {
  Padded yuyv(PixelFormat::kYuyv, 256);
  const Converted a(yuyv);
  cv::Mat want;
  cv::cvtColor(yuyv.mat(CV_8UC2), want, cv::COLOR_YUV2BGR_YUYV);
  EXPECT_LE(worst(a.bgr, want), 2);
  cv::cvtColor(yuyv.mat(CV_8UC2), want, cv::COLOR_YUV2GRAY_YUYV);
  EXPECT_EQ(worst(a.grey, want), 0);
  Padded nv12(PixelFormat::kNv12, 256);
  const Converted b(nv12);
  cv::cvtColor(nv12.mat(CV_8U, kHeight * 3 / 2), want, cv::COLOR_YUV2BGR_NV12);
  EXPECT_LE(worst(b.bgr, want), 2);
  EXPECT_EQ(worst(b.grey, nv12.mat(CV_8U)), 0);
}

// Many pixels at once give what one after the other gives, at every width.
TEST(YuvRows, AreTheSameAsPixelByPixel) {
  std::mt19937 random(3);
  for (const int width : {2, 4, 14, 16, 18, 62, 64, 66, 254, 256, 258, 640, 752, 1280}) {
    const auto w = static_cast<std::size_t>(width);
    // Exactly as long as they must be, so that a sanitizer sees whoever reads or writes beyond.
    std::vector<std::uint8_t> yuyv(2 * w), luma(w), chroma(w), grey(w), bgr(3 * w), want(3 * w);
    for (auto* bytes : {&yuyv, &luma, &chroma}) {
      for (auto& b : *bytes) b = static_cast<std::uint8_t>(random());
    }
    yuyv_row(yuyv.data(), width, grey.data(), bgr.data());
    for (std::size_t x = 0; x < w; ++x) {
      ASSERT_EQ(grey[x], yuyv[2 * x]);
      bgr_of_yuv(yuyv[2 * x], yuyv[x / 2 * 4 + 1], yuyv[x / 2 * 4 + 3], &want[3 * x]);
    }
    ASSERT_EQ(bgr, want) << width;
    nv12_row(luma.data(), chroma.data(), width, bgr.data());
    for (std::size_t x = 0; x < w; ++x) bgr_of_yuv(luma[x], chroma[x / 2 * 2], chroma[x / 2 * 2 + 1], &want[3 * x]);
    ASSERT_EQ(bgr, want) << width;
  }
}

TEST(YuvRows, OfAJpegAreTheSameAsPixelByPixel) {
  std::mt19937 random(4);
  for (const int width : {1, 2, 3, 15, 16, 17, 31, 33, 64, 255, 256, 257, 259, 640, 753}) {
    const auto w = static_cast<std::size_t>(width);
    std::vector<std::uint8_t> luma(w), cb((w + 1) / 2), cr((w + 1) / 2), bgr(3 * w), want(3 * w);
    for (auto* bytes : {&luma, &cb, &cr}) {
      for (auto& b : *bytes) b = static_cast<std::uint8_t>(random());
    }
    jpeg_row(luma.data(), cb.data(), cr.data(), width, bgr.data());
    for (std::size_t x = 0; x < w; ++x) bgr_of_jpeg(luma[x], cb[x / 2], cr[x / 2], &want[3 * x]);
    ASSERT_EQ(bgr, want) << width;
  }
}

TEST(YuvRows, AJpegsColoursAreJfifsWithinOne) {
  for (int y = 0; y < 256; y += 5) {
    for (int cb = 0; cb < 256; cb += 3) {
      for (int cr = 0; cr < 256; cr += 3) {
        std::uint8_t bgr[3];
        bgr_of_jpeg(y, cb, cr, bgr);
        const double d = cb - 128, e = cr - 128;
        const double want[3] = {y + 1.772 * d, y - 0.344136 * d - 0.714136 * e, y + 1.402 * e};
        for (int i = 0; i < 3; ++i)
          ASSERT_NEAR(bgr[i], std::clamp(want[i], 0.0, 255.0), 1) << y << ' ' << cb << ' ' << cr;
      }
    }
  }
}

TEST(PixelFormat, RgbAsOpenCvConvertsIt) {
  for (const bool red_first : {false, true}) {
    Padded raw(red_first ? PixelFormat::kRgb3 : PixelFormat::kBgr3, 256);
    const Converted c(raw);
    cv::Mat grey, bgr = raw.mat(CV_8UC3).clone();
    if (red_first) cv::cvtColor(raw.mat(CV_8UC3), bgr, cv::COLOR_RGB2BGR);
    cv::cvtColor(bgr, grey, cv::COLOR_BGR2GRAY);
    EXPECT_EQ(worst(c.bgr, bgr), 0);
    EXPECT_LE(worst(c.grey, grey), 1);
    cv::Mat alone(kHeight, kWidth, CV_8U);
    convert({raw.bytes.data(), raw.stride, raw.format, 0}, {alone.data, kWidth, kHeight, kWidth}, nullptr);
    EXPECT_EQ(worst(c.grey, alone), 0);
  }
}

TEST(PixelFormat, BayerGivesTheBlocksColoursAndTheirMean) {
  for (const PixelFormat format : {PixelFormat::kRg10, PixelFormat::kBa10}) {
    Padded raw(format, 1024);
    // A picture of one colour: red 800, green 400, blue 80.
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const bool red_first = format == PixelFormat::kRg10;
        const int place = (y % 2) * 2 + x % 2;
        const int red = red_first ? 0 : 1, blue = red_first ? 3 : 2;
        const auto v = static_cast<std::uint16_t>(place == red ? 800 : place == blue ? 80 : 400);
        std::memcpy(&raw.bytes[static_cast<std::size_t>(y * raw.stride + 2 * x)], &v, 2);
      }
    }
    const Converted c(raw, usual_shift(format));
    EXPECT_EQ(worst(c.bgr, cv::Mat(kHeight, kWidth, CV_8UC3, cv::Scalar(20, 100, 200))), 0);
    EXPECT_EQ(worst(c.grey, cv::Mat(kHeight, kWidth, CV_8U, cv::Scalar(105))), 0);  // (800 + 2 * 400 + 80) / 4 / 4
  }
}

TEST(PixelFormat, NamesAndSizes) {
  for (const PixelFormat format : kPixelFormats) EXPECT_EQ(pixel_format_named(name(format)), format);
  EXPECT_FALSE(pixel_format_named("H264"));
  EXPECT_EQ(picture_bytes(PixelFormat::kGrey, 640, 480, 704), 479u * 704 + 640);
  EXPECT_EQ(picture_bytes(PixelFormat::kNv12, 640, 480, 640), 640u * 720);
  EXPECT_EQ(picture_bytes(PixelFormat::kRg10, 640, 480, 1280), 640u * 2 * 480);
}

}  // namespace
}  // namespace godwit::hal::pixel_format_test
