// What the benchmarks work on: a made-up picture and, if GODWIT_BENCH_IMAGE names a file, that picture.
#pragma once

#include <benchmark/benchmark.h>
#include <cstdlib>
#include <iostream>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "tests/vo_core/synthetic_picture.h"

namespace godwit::bench {

struct NamedPicture {
  std::string name;
  vo::test::Picture picture;
};

/// Made-up pictures in the two sizes of the test sequences, and the file.
inline const std::vector<NamedPicture>& pictures() {
  static const std::vector<NamedPicture> all = [] {
    std::vector<NamedPicture> list;
    list.push_back({"synthetic_640x480", vo::test::rectangles(640, 480, 500, 1)});
    list.push_back({"synthetic_752x480", vo::test::rectangles(752, 480, 500, 2)});
    if (const char* path = std::getenv("GODWIT_BENCH_IMAGE"); path != nullptr && *path != '\0') {
      const cv::Mat image = cv::imread(path, cv::IMREAD_GRAYSCALE);
      if (image.empty()) {
        std::cerr << "GODWIT_BENCH_IMAGE: cannot read a picture from " << path << "\n";
        std::exit(1);
      }
      vo::test::Picture picture(image.cols, image.rows, 0);
      for (int y = 0; y < image.rows; ++y) {
        for (int x = 0; x < image.cols; ++x) picture(x, y) = image.at<std::uint8_t>(y, x);
      }
      list.push_back({"file", std::move(picture)});
    }
    return list;
  }();
  return all;
}

/// Registers f(state, picture) for every picture.
template <typename F>
int register_for_pictures(const std::string& stage, F f) {
  for (const NamedPicture& p : pictures()) {
    benchmark::RegisterBenchmark((stage + "/" + p.name).c_str(), [f, &p](benchmark::State& state) {
      f(state, p.picture);
    })->Unit(benchmark::kMicrosecond);
  }
  return 0;
}

}  // namespace godwit::bench
