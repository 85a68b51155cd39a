#include "benchmarks/latency/plot.h"

#include <algorithm>
#include <cmath>
#include <fmt/format.h>
#include <opencv2/imgproc.hpp>
#include <png.h>

namespace godwit::bench {
namespace {

constexpr int kRowPx = 340, kHistogramPx = 460, kTimelinePx = 840, kLeftPx = 60, kTopPx = 50, kBottomPx = 45;
const cv::Scalar kInk(40, 40, 40), kGrid(225, 225, 225), kAge(160, 90, 30), kDelivery(60, 160, 60),
    kDeadline(50, 50, 210);

void write(cv::Mat* picture, const std::string& text, cv::Point at, double size = 0.45) {
  cv::putText(*picture, text, at, cv::FONT_HERSHEY_SIMPLEX, size, kInk, 1, cv::LINE_AA);
}

/// A step of 1, 2 or 5 times a power of ten, some five of them over the range.
double round_step(double range) {
  const double raw = range / 5, power = std::pow(10, std::floor(std::log10(raw)));
  return raw / power < 1.5 ? power : raw / power < 3.5 ? 2 * power : raw / power < 7.5 ? 5 * power : 10 * power;
}

/// A frame with axes from 0 to x_most and 0 to y_most.
struct Axes {
  cv::Rect box;
  double x_most = 1, y_most = 1;
  cv::Point at(double x, double y) const {
    return {box.x + static_cast<int>(std::lround(box.width * std::clamp(x / x_most, 0.0, 1.0))),
            box.y + box.height - static_cast<int>(std::lround(box.height * std::clamp(y / y_most, 0.0, 1.0)))};
  }
  void draw(cv::Mat* picture, const std::string& x_name, const std::string& y_name) const {
    const double step_x = round_step(x_most), step_y = round_step(y_most);
    for (int i = 0; i * step_x <= x_most * 1.0001; ++i) {
      const double x = i * step_x;
      cv::line(*picture, at(x, 0), at(x, y_most), kGrid);
      write(picture, fmt::format("{:g}", x), at(x, 0) + cv::Point(-8, 16), 0.4);
    }
    for (int i = 0; i * step_y <= y_most * 1.0001; ++i) {
      const double y = i * step_y;
      cv::line(*picture, at(0, y), at(x_most, y), kGrid);
      write(picture, fmt::format("{:g}", y), at(0, y) + cv::Point(-42, 4), 0.4);
    }
    cv::rectangle(*picture, box, kInk);
    write(picture, x_name, {box.x + box.width / 2 - 60, box.y + box.height + 34}, 0.42);
    write(picture, y_name, {box.x, box.y - 8}, 0.42);
  }
};

void draw_flight(const FlightFigures& f, double delivery_ms, cv::Mat* row) {
  const double worst_ms = *std::max_element(f.age_ms.begin(), f.age_ms.end());
  const double deadline_ms = delivery_ms + f.deadline_ms;
  const double most_ms = 1.08 * std::max(worst_ms, deadline_ms);
  constexpr int kBins = 80;
  std::array<int, kBins> counts{};
  for (const float age : f.age_ms) {
    ++counts[static_cast<std::size_t>(std::clamp(static_cast<int>(age / most_ms * kBins), 0, kBins - 1))];
  }
  const int height = kRowPx - kTopPx - kBottomPx;
  const Axes histogram{{kLeftPx, kTopPx, kHistogramPx - kLeftPx - 20, height},
                       most_ms,
                       1.05 * *std::max_element(counts.begin(), counts.end())};
  histogram.draw(row, "age at pose [ms]", "frames");
  for (int i = 0; i < kBins; ++i) {
    const int n = counts[static_cast<std::size_t>(i)];
    if (n > 0) {
      cv::rectangle(*row, histogram.at(most_ms * i / kBins, 0), histogram.at(most_ms * (i + 1) / kBins, n), kAge,
                    cv::FILLED);
    }
  }
  const Axes timeline{{kHistogramPx + kLeftPx, kTopPx, kTimelinePx - kLeftPx - 20, height},
                      std::max(1e-3, static_cast<double>(f.t_s.back())),
                      most_ms};
  timeline.draw(row, "flight [s]", "age at pose [ms]; green: delivery, red: one interval later");
  for (std::size_t i = 0; i < f.t_s.size(); ++i)
    cv::circle(*row, timeline.at(f.t_s[i], f.age_ms[i]), 1, kAge, cv::FILLED);
  for (const auto& [ms, colour] : {std::pair{delivery_ms, kDelivery}, std::pair{deadline_ms, kDeadline}}) {
    cv::line(*row, histogram.at(ms, 0), histogram.at(ms, histogram.y_most), colour);
    cv::line(*row, timeline.at(0, ms), timeline.at(timeline.x_most, ms), colour);
  }
  const Distribution& d = f.age_at_pose;
  write(row,
        fmt::format("detector {}: p50 {:.2f}, p99 {:.2f}, p99.9 {:.2f}, max {:.2f} ms; our own share p99 {:.2f} ms; "
                    "{} of {} frames tracked, {} late, {} dropped",
                    f.detector ? "on" : "off", d.p50, d.p99, d.p999, d.max, f.own_at_pose.p99, f.tracked, f.due,
                    f.missed_deadlines, f.dropped),
        {kLeftPx, 20}, 0.5);
}

}  // namespace

rt::Result<std::string> plot(const Run& run) {
  cv::Mat picture(kRowPx * static_cast<int>(run.flights.size()), kHistogramPx + kTimelinePx, CV_8UC3,
                  cv::Scalar::all(255));
  for (std::size_t i = 0; i < run.flights.size(); ++i) {
    cv::Mat row = picture.rowRange(static_cast<int>(i) * kRowPx, static_cast<int>(i + 1) * kRowPx);
    if (run.flights[i].age_ms.empty()) {
      write(&row, "no pose was found", {kLeftPx, 40}, 0.6);
    } else {
      draw_flight(run.flights[i], run.live ? run.flights[i].delivery.p50 : run.delays.delivery_ms(), &row);
    }
  }
  // libpng's simplified interface; OpenCV's imgcodecs would bring 150 MB of libraries into the memory that is measured.
  png_image image{};
  image.version = PNG_IMAGE_VERSION;
  image.width = static_cast<png_uint_32>(picture.cols);
  image.height = static_cast<png_uint_32>(picture.rows);
  image.format = PNG_FORMAT_BGR;
  const auto row_bytes = static_cast<png_int_32>(picture.step[0]);
  png_alloc_size_t bytes = 0;
  // The first call tells how much room the second needs.
  bool drawn = png_image_write_to_memory(&image, nullptr, &bytes, 0, picture.data, row_bytes, nullptr) != 0;
  std::string out(bytes, '\0');
  drawn = drawn && png_image_write_to_memory(&image, out.data(), &bytes, 0, picture.data, row_bytes, nullptr) != 0;
  if (!drawn) return rt::Error{std::string("the plot cannot be drawn: ") + image.message};
  out.resize(bytes);
  return out;
}

}  // namespace godwit::bench
