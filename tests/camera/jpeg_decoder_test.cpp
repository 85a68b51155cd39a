// JPEGs of every sampling that a camera may give, at sizes that fill their blocks and at such that do not.
#include "hal/camera/pixels/jpeg_decoder.h"

#include <cstdio>
#include <cstdlib>
#include <gtest/gtest.h>
// libjpeg's header needs FILE and size_t before it.
#include <jpeglib.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <random>
#include <vector>

namespace godwit::hal::jpeg_decoder_test {
namespace {

struct Sampling {
  const char* name;
  int across, down;  ///< pixels that share their chroma
};
constexpr Sampling kSamplings[] = {{"4:2:0", 2, 2}, {"4:2:2", 2, 1}, {"4:4:4", 1, 1}, {"4:4:0", 1, 2}, {"4:1:1", 4, 1}};

/// OpenCV 4.6 cannot choose the sampling.
std::vector<std::uint8_t> coded(const cv::Mat& bgr, const Sampling& sampling, J_COLOR_SPACE space = JCS_YCbCr,
                                bool progressive = false) {
  jpeg_compress_struct c{};
  jpeg_error_mgr errors{};
  c.err = jpeg_std_error(&errors);
  jpeg_create_compress(&c);
  unsigned char* data = nullptr;
  unsigned long bytes = 0;
  jpeg_mem_dest(&c, &data, &bytes);
  c.image_width = static_cast<JDIMENSION>(bgr.cols);
  c.image_height = static_cast<JDIMENSION>(bgr.rows);
  c.input_components = 3;
  c.in_color_space = JCS_EXT_BGR;
  jpeg_set_defaults(&c);
  jpeg_set_colorspace(&c, space);
  jpeg_set_quality(&c, 90, TRUE);
  c.comp_info[0].h_samp_factor = sampling.across;
  c.comp_info[0].v_samp_factor = sampling.down;
  if (progressive) jpeg_simple_progression(&c);
  jpeg_start_compress(&c, TRUE);
  for (int y = 0; y < bgr.rows; ++y) {
    JSAMPROW row = const_cast<std::uint8_t*>(bgr.ptr(y));
    jpeg_write_scanlines(&c, &row, 1);
  }
  jpeg_finish_compress(&c);
  std::vector<std::uint8_t> out(data, data + bytes);
  std::free(data);
  jpeg_destroy_compress(&c);
  return out;
}

/// Colours that change slowly, so that smoothed chroma and chroma as it stands differ little.
cv::Mat soft_picture(int width, int height) {
  cv::Mat picture(height, width, CV_8UC3);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const auto wave = [&](double a, double b) {
        return cv::saturate_cast<std::uint8_t>(128 + 90 * std::sin(a * x + b * y));
      };
      picture.at<cv::Vec3b>(y, x) = {wave(0.03, 0.01), wave(0.01, 0.04), wave(0.02, -0.03)};
    }
  }
  return picture;
}

struct Decoded {
  explicit Decoded(cv::Size size) : grey(size, CV_8U, cv::Scalar(7)), bgr(size, CV_8UC3) {}
  const char* decode(JpegDecoder* decoder, const std::vector<std::uint8_t>& jpeg, bool colour = true) {
    return decoder->decode(jpeg.data(), jpeg.size(), {grey.data, grey.cols, grey.rows, static_cast<int>(grey.step)},
                           colour ? bgr.data : nullptr);
  }
  cv::Mat grey, bgr;
};

double worst(const cv::Mat& a, const cv::Mat& b) {
  return cv::norm(a, b, cv::NORM_INF);
}

TEST(JpegDecoder, EverySamplingAndSizeGivesLumaAndColours) {
  JpegDecoder decoder;
  for (const cv::Size size :
       {cv::Size(64, 48), cv::Size(640, 480), cv::Size(70, 50), cv::Size(65, 47), cv::Size(17, 1), cv::Size(1, 3)}) {
    const cv::Mat picture = soft_picture(size.width, size.height);
    for (const Sampling& sampling : kSamplings) {
      for (const bool progressive : {false, true}) {
        SCOPED_TRACE(testing::Message() << sampling.name << ' ' << size << (progressive ? " progressive" : ""));
        const auto jpeg = coded(picture, sampling, JCS_YCbCr, progressive);
        Decoded both(size), alone(size);
        ASSERT_EQ(both.decode(&decoder, jpeg), nullptr);
        ASSERT_EQ(alone.decode(&decoder, jpeg, false), nullptr);
        const cv::Mat want = cv::imdecode(jpeg, cv::IMREAD_COLOR);
        EXPECT_LE(worst(both.bgr, want), 8);
        EXPECT_LE(cv::norm(both.bgr, want, cv::NORM_L1) / (3.0 * size.area()), 1.0);
        EXPECT_EQ(worst(alone.grey, cv::imdecode(jpeg, cv::IMREAD_GRAYSCALE)), 0);
        // What the odometry sees must not hang on whether a network looks, too.
        EXPECT_LE(worst(both.grey, alone.grey), sampling.across == 2 ? 0 : 2);
      }
    }
  }
}

// Where a colour ends the chroma of the pair is what it was coded as, and where the light ends the luma is untouched.
TEST(JpegDecoder, EdgesOfColourDoNotMoveTheGrey) {
  cv::Mat picture(48, 64, CV_8UC3, cv::Scalar(20, 30, 220));
  picture(cv::Rect(33, 0, 31, 48)) = cv::Scalar(220, 60, 10);
  JpegDecoder decoder;
  for (const Sampling& sampling : {kSamplings[0], kSamplings[1]}) {
    const auto jpeg = coded(picture, sampling);
    Decoded both({64, 48});
    ASSERT_EQ(both.decode(&decoder, jpeg), nullptr);
    EXPECT_EQ(worst(both.grey, cv::imdecode(jpeg, cv::IMREAD_GRAYSCALE)), 0) << sampling.name;
  }
}

TEST(JpegDecoder, GreyAndRgbPicturesAreTakenToo) {
  const cv::Mat picture = soft_picture(50, 34);
  JpegDecoder decoder;
  Decoded rgb({50, 34}), grey({50, 34});
  ASSERT_EQ(rgb.decode(&decoder, coded(picture, {"rgb", 1, 1}, JCS_RGB)), nullptr);
  EXPECT_LE(worst(rgb.bgr, picture), 30);
  EXPECT_LE(cv::norm(rgb.bgr, picture, cv::NORM_L1) / (3.0 * picture.size().area()), 2.5);
  cv::Mat light;
  cv::cvtColor(picture, light, cv::COLOR_BGR2GRAY);
  std::vector<std::uint8_t> jpeg;
  cv::imencode(".jpg", light, jpeg);
  ASSERT_EQ(grey.decode(&decoder, jpeg), nullptr);
  EXPECT_LE(worst(grey.grey, light), 12);
  EXPECT_EQ(grey.bgr.at<cv::Vec3b>(20, 20), cv::Vec3b::all(grey.grey.at<std::uint8_t>(20, 20)));
}

// Broken bytes anywhere end in a word or in a picture, and the decoder takes the next one: for the sanitizers.
TEST(JpegDecoder, BrokenBytesAreSurvived) {
  const cv::Mat picture = soft_picture(70, 50);
  std::mt19937 random(8);
  JpegDecoder decoder;
  int refused = 0;
  for (const Sampling& sampling : kSamplings) {
    const auto good = coded(picture, sampling);
    for (int i = 0; i < 200; ++i) {
      auto jpeg = good;
      for (int n = 0; n <= i % 4; ++n) jpeg[random() % jpeg.size()] = static_cast<std::uint8_t>(random());
      if (i % 3 == 0) jpeg.resize(random() % jpeg.size());
      Decoded d({70, 50});
      refused += d.decode(&decoder, jpeg) != nullptr ? 1 : 0;
      if (i % 20 == 0) {
        ASSERT_EQ(d.decode(&decoder, good), nullptr);
      }
    }
  }
  EXPECT_GT(refused, 300);
}

}  // namespace
}  // namespace godwit::hal::jpeg_decoder_test
