// godwit-conversion-yardstick SEQUENCE: what it costs to turn a device's picture into a frame slot's, in units that do
// not depend on the machine (benchmarks/yardstick.h). The sequence's pictures are packed as cameras pack them, outside
// the times; to grey alone, and to grey and colour.
#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <CLI/Validators.hpp>
#include <fmt/format.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "benchmarks/last_catch.h"
#include "benchmarks/yardstick.h"
#include "hal/camera/pixels/jpeg_decoder.h"
#include "hal/camera/pixels/pixel_format.h"
#include "hal/camera/replay/replay_camera.h"

namespace {

using namespace godwit;
using hal::PixelFormat;

/// A picture as a device of that format gives it, rows without padding.
std::vector<std::uint8_t> packed(const cv::Mat& bgr, PixelFormat format) {
  const int w = bgr.cols, h = bgr.rows;
  std::vector<std::uint8_t> out;
  cv::Mat yuv;
  cv::cvtColor(bgr, yuv, cv::COLOR_BGR2YUV);
  const auto word = [&](int value) {
    out.push_back(static_cast<std::uint8_t>(value));
    out.push_back(static_cast<std::uint8_t>(value >> 8));
  };
  switch (format) {
    case PixelFormat::kMjpeg:
      cv::imencode(".jpg", bgr, out, {cv::IMWRITE_JPEG_QUALITY, 85});
      return out;
    case PixelFormat::kYuyv:
      for (int y = 0; y < h; ++y) {
        for (int x = 0; x < w; ++x) {
          const auto& p = yuv.at<cv::Vec3b>(y, x);
          out.push_back(p[0]);
          out.push_back(p[x % 2 == 0 ? 1 : 2]);
        }
      }
      return out;
    case PixelFormat::kNv12:
      for (int y = 0; y < h; ++y) {
        for (int x = 0; x < w; ++x) out.push_back(yuv.at<cv::Vec3b>(y, x)[0]);
      }
      for (int y = 0; y < h; y += 2) {
        for (int x = 0; x < w; ++x) out.push_back(yuv.at<cv::Vec3b>(y, x)[x % 2 == 0 ? 1 : 2]);
      }
      return out;
    case PixelFormat::kRg10:
    case PixelFormat::kBa10:
      for (int y = 0; y < h; ++y) {
        for (int x = 0; x < w; ++x) word(4 * bgr.at<cv::Vec3b>(y, x)[y % 2 != x % 2 ? 1 : y % 2 == 0 ? 2 : 0]);
      }
      return out;
    case PixelFormat::kBgr3:
    case PixelFormat::kRgb3:
      for (int y = 0; y < h; ++y) {
        for (int i = 0; i < 3 * w; ++i) {
          const cv::Vec3b& p = bgr.at<cv::Vec3b>(y, i / 3);
          out.push_back(p[format == PixelFormat::kBgr3 ? i % 3 : 2 - i % 3]);
        }
      }
      return out;
    case PixelFormat::kY10:
    case PixelFormat::kY16:
      for (int y = 0; y < h; ++y) {
        for (int x = 0; x < w; ++x) word(yuv.at<cv::Vec3b>(y, x)[0] << (format == PixelFormat::kY10 ? 2 : 8));
      }
      return out;
    case PixelFormat::kGrey:
      for (int y = 0; y < h; ++y) {
        for (int x = 0; x < w; ++x) out.push_back(yuv.at<cv::Vec3b>(y, x)[0]);
      }
      return out;
  }
  return out;
}

struct Row {
  PixelFormat format;
  bool colour;
  std::vector<double> ms;
};

int run(const std::string& sequence, const hal::ReplayOptions& replay) {
  auto camera = hal::ReplayCamera::open(sequence, replay);
  if (!camera) {
    fmt::print(stderr, "godwit-conversion-yardstick: {}\n", camera.error().message);
    return 2;
  }
  const int w = camera.value()->width(), h = camera.value()->height();
  cv::setNumThreads(1);
  std::vector<Row> rows;
  for (const PixelFormat format : hal::kPixelFormats) {
    rows.push_back({format, false, {}});
    if (hal::channels(format) == 3) rows.push_back({format, true, {}});
  }
  cv::Mat earlier, later(h, w, CV_8UC1), colour(h, w, CV_8UC3), to(h, w, CV_8UC1), bgr(h, w, CV_8UC3);
  const rt::MutableImageView grey{to.data, w, h, static_cast<int>(to.step)};
  hal::JpegDecoder jpeg;
  std::vector<double> yardstick;
  std::string why;
  while (true) {
    hal::CapturedFrame frame;
    const auto status = camera.value()->next({later.data, w, h, static_cast<int>(later.step)}, colour.data,
                                             rt::kNsPerSecond, &frame, &why);
    if (status == hal::CameraStatus::kEnd) break;
    if (status != hal::CameraStatus::kFrame) continue;
    if (camera.value()->channels() == 1) cv::cvtColor(later, colour, cv::COLOR_GRAY2BGR);
    if (!earlier.empty()) {
      const double ms = bench::time_yardstick(earlier, later);
      if (ms >= 0) yardstick.push_back(ms);
    }
    for (Row& row : rows) {
      const auto raw = packed(colour, row.format);
      std::uint8_t* const in_colour = row.colour ? bgr.data : nullptr;
      const rt::TimeNs begin = rt::thread_cpu_now_ns();
      const char* wrong = nullptr;
      if (row.format == PixelFormat::kMjpeg) {
        wrong = jpeg.decode(raw.data(), raw.size(), grey, in_colour);
      } else {
        hal::convert({raw.data(), hal::row_bytes(row.format, w), row.format, hal::usual_shift(row.format)}, grey,
                     in_colour);
      }
      row.ms.push_back(rt::to_ms(rt::thread_cpu_now_ns() - begin));
      if (wrong != nullptr) return fmt::print(stderr, "{}\n", wrong), 1;
    }
    later.copyTo(earlier);
  }
  if (yardstick.empty()) return fmt::print(stderr, "{}: nothing to compare with\n", sequence), 1;
  const double y = app::statistics_of(yardstick).median;
  fmt::print("{} pictures of {} x {}; thread CPU time\n", rows.front().ms.size(), w, h);
  bench::print_heading();
  bench::print_row("yardstick (Y = median)", yardstick, y);
  for (const Row& row : rows) {
    bench::print_row(fmt::format("{} to grey{}", hal::name(row.format), row.colour ? " and BGR" : "").c_str(), row.ms,
                     y);
  }
  return 0;
}

int measure(int argc, char** argv) {
  CLI::App cli("Times the conversions of a camera's pictures against a workload of known size.",
               "godwit-conversion-yardstick");
  std::string sequence;
  hal::ReplayOptions replay;
  replay.frames = 200;
  cli.add_option("SEQUENCE", sequence, "Folder in TUM or EuRoC layout")->required();
  cli.add_option("--frames", replay.frames, "Stop after N pictures")->check(CLI::PositiveNumber);
  CLI11_PARSE(cli, argc, argv);
  return run(sequence, replay);
}

}  // namespace

int main(int argc, char** argv) {
  return bench::last_catch("godwit-conversion-yardstick", measure, argc, argv);
}
