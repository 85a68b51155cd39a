// A small recorded sequence on disk, for tests of everything that reads one.
#pragma once

#include <cstdio>
#include <opencv2/imgcodecs.hpp>
#include <string>

#include "tests/support/temp_folder.h"

namespace godwit::test {

constexpr int kTinyWidth = 160;
constexpr int kTinyHeight = 120;

inline std::string tiny_camera_yaml() {
  return "model: pinhole\nwidth: 160\nheight: 120\nfx: 130.0\nfy: 130.0\ncx: 79.5\ncy: 59.5\n"
         "distortion_model: none\ndistortion: []\nfps: 20\nimage_channels: 1\n";
}

/// A picture whose grey values depend on its number, so that a mix-up shows.
inline cv::Mat tiny_picture(int number) {
  cv::Mat m(kTinyHeight, kTinyWidth, CV_8UC1);
  for (int y = 0; y < m.rows; ++y) {
    for (int x = 0; x < m.cols; ++x)
      m.at<unsigned char>(y, x) = static_cast<unsigned char>((x + 3 * y + 7 * number) & 255);
  }
  return m;
}

/// rgb/0000.png .., a picture each 50 ms from 100.000000001 s, rgb.txt and camera.yaml.
inline void write_tiny_tum(const std::string& folder, int pictures) {
  std::filesystem::create_directories(folder + "/rgb");
  std::string index = "# timestamp filename\n";
  for (int i = 0; i < pictures; ++i) {
    char name[32], line[80];
    std::snprintf(name, sizeof(name), "rgb/%04d.png", i);
    std::snprintf(line, sizeof(line), "%d.%03d000001 %s\n", 100 + 50 * i / 1000, 50 * i % 1000, name);
    index += line;
    cv::imwrite(folder + "/" + name, tiny_picture(i));
  }
  write_file(folder + "/rgb.txt", index);
  write_file(folder + "/camera.yaml", tiny_camera_yaml());
}

}  // namespace godwit::test
