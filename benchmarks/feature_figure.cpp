// feature_figure PICTURE OUT.png [WANTED]: what the quadtree takes beside what plain FAST takes from the same picture
// with more than a third of it masked (the paper's figure 6). Prints the two counts and the occupied cells of an 8x6
// grid.
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "tests/vo_core/plain_fast.h"
#include "tests/vo_core/synthetic_picture.h"
#include "vo_core/features/feature_detector.h"

namespace {

using godwit::vo::Vec2f;

/// The picture with the mask in red, the 8x6 grid, and the points.
cv::Mat draw(const cv::Mat& grey, const godwit::rt::ImageView& mask, const std::vector<Vec2f>& points,
             const char* name) {
  cv::Mat out;
  cv::cvtColor(grey, out, cv::COLOR_GRAY2BGR);
  for (int y = 0; y < out.rows; ++y) {
    for (int x = 0; x < out.cols; ++x) {
      if (mask.at(x, y) != 0)
        out.at<cv::Vec3b>(y, x)[2] = static_cast<std::uint8_t>(128 + grey.at<std::uint8_t>(y, x) / 2);
    }
  }
  for (int i = 1; i < 8; ++i) cv::line(out, {out.cols * i / 8, 0}, {out.cols * i / 8, out.rows}, {160, 160, 160});
  for (int i = 1; i < 6; ++i) cv::line(out, {0, out.rows * i / 6}, {out.cols, out.rows * i / 6}, {160, 160, 160});
  for (const Vec2f& p : points) cv::circle(out, cv::Point2f(p.x(), p.y()), 3, {0, 255, 0}, 1, cv::LINE_AA);
  const std::string label = std::string(name) + ": " + std::to_string(points.size()) + " points, " +
                            std::to_string(godwit::vo::test::occupied_cells(points, grey.cols, grey.rows)) +
                            " of 48 cells";
  cv::copyMakeBorder(out, out, 24, 0, 0, 0, cv::BORDER_CONSTANT);
  cv::putText(out, label, {8, 17}, cv::FONT_HERSHEY_SIMPLEX, 0.5, {255, 255, 255}, 1, cv::LINE_AA);
  std::printf("%s\n", label.c_str());
  return out;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3 || argc > 4) {
    std::fprintf(stderr, "usage: feature_figure PICTURE OUT.png [WANTED, default 200]\n");
    return 2;
  }
  const int wanted = argc == 4 ? std::atoi(argv[3]) : 200;
  const cv::Mat grey = cv::imread(argv[1], cv::IMREAD_GRAYSCALE);
  if (grey.empty() || wanted < 1) {
    std::fprintf(stderr, "feature_figure: %s\n", grey.empty() ? "cannot read the picture" : "WANTED must be 1 or more");
    return 1;
  }
  const godwit::rt::ImageView base{grey.data, grey.cols, grey.rows, static_cast<int>(grey.step)};
  const godwit::vo::test::Pyramid pyramid(base);
  const godwit::vo::test::Mask mask = godwit::vo::test::two_walkers(grey.cols, grey.rows);

  godwit::vo::FeatureDetector detector(grey.cols, grey.rows, {});
  std::vector<godwit::vo::Feature> features(static_cast<std::size_t>(wanted));
  features.resize(static_cast<std::size_t>(detector.detect(pyramid.view(), mask.view(), {}, wanted, features)));
  std::vector<Vec2f> quadtree;
  quadtree.reserve(features.size());
  for (const auto& f : features) quadtree.push_back(f.px);
  const std::vector<Vec2f> plain = godwit::vo::test::plain_fast(base, mask.view().level[0], wanted);

  std::printf("masked: %.1f %%\n", 100.0 * mask.share());
  cv::Mat both;
  cv::hconcat(draw(grey, mask.view().level[0], plain, "plain FAST"),
              draw(grey, mask.view().level[0], quadtree, "quadtree"), both);
  if (!cv::imwrite(argv[2], both)) {
    std::fprintf(stderr, "feature_figure: cannot write %s\n", argv[2]);
    return 1;
  }
  return 0;
}
