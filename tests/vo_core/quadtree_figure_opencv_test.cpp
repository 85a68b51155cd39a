// Quadtree against plain FAST on real pictures with 36 % masked (the paper's figure 6; benchmarks/feature_figure draws
// it).
#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <gtest/gtest.h>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "tests/vo_core/plain_fast.h"
#include "tests/vo_core/synthetic_picture.h"
#include "vo_core/features/feature_detector.h"

namespace godwit::vo {
namespace quadtree_figure_opencv_test {

class RealPictures : public testing::TestWithParam<const char*> {};
INSTANTIATE_TEST_SUITE_P(QuadtreeFigure, RealPictures, testing::Values("tum_fr1_xyz", "euroc_mh01"));

TEST_P(RealPictures, QuadtreeAgainstPlainFastUnderAMask) {
  const char* shared = std::getenv("GODWIT_SHARED_DIR");
  const std::filesystem::path folder =
      std::filesystem::path(shared == nullptr ? "" : shared) / "data" / GetParam() / "rgb";
  if (shared == nullptr || !std::filesystem::is_directory(folder)) {
    const char* ci = std::getenv("CI");
    ASSERT_FALSE(ci != nullptr && std::string(ci) == "true") << folder << " is missing";
    GTEST_SKIP() << folder << " is missing: GODWIT_SHARED_DIR must name the folder that holds data/" << GetParam();
  }
  std::vector<std::string> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) files.push_back(entry.path().string());
  std::sort(files.begin(), files.end());

  constexpr int kWanted = 200;
  int pictures = 0, plain_cells = 0, quadtree_cells = 0, taken = 0;
  for (std::size_t i = 0; i < files.size(); i += 50, ++pictures) {
    const cv::Mat grey = cv::imread(files[i], cv::IMREAD_GRAYSCALE);
    ASSERT_FALSE(grey.empty()) << files[i];
    const rt::ImageView base{grey.data, grey.cols, grey.rows, static_cast<int>(grey.step)};
    const test::Pyramid pyramid(base);
    const test::Mask mask = test::two_walkers(grey.cols, grey.rows);
    const rt::ImageView masked = mask.view().level[0];
    FeatureDetector detector(grey.cols, grey.rows, {});
    std::vector<Feature> features(kWanted);
    features.resize(static_cast<std::size_t>(detector.detect(pyramid.view(), mask.view(), {}, kWanted, features)));
    std::vector<Vec2f> points;
    int corners = 0;
    for (const Feature& f : features) {
      points.push_back(f.px);
      corners += f.type == FeatureType::kCorner;
      EXPECT_EQ(masked.at(static_cast<int>(f.px.x() + 0.5f), static_cast<int>(f.px.y() + 0.5f)), 0);
    }
    const std::vector<Vec2f> plain = test::plain_fast(base, masked, kWanted);
    const int ours = test::occupied_cells(points, grey.cols, grey.rows);
    const int theirs = test::occupied_cells(plain, grey.cols, grey.rows);
    EXPECT_GE(corners, kWanted * 95 / 100) << files[i];
    EXPECT_GT(ours, theirs) << files[i];
    taken += corners;
    quadtree_cells += ours;
    plain_cells += theirs;
  }
  ASSERT_GT(pictures, 0);
  std::printf("%s: %d pictures, mean of %d wanted: %.1f corners, %.1f of 48 cells; plain FAST %.1f cells\n", GetParam(),
              pictures, kWanted, static_cast<double>(taken) / pictures, static_cast<double>(quadtree_cells) / pictures,
              static_cast<double>(plain_cells) / pictures);
}

}  // namespace quadtree_figure_opencv_test
}  // namespace godwit::vo
