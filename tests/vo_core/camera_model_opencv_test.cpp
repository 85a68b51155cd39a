// The camera models against OpenCV's, which were written independently.
#include <array>
#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>
#include <random>
#include <vector>

#include "tests/vo_core/test_cameras.h"

namespace godwit::vo {
namespace camera_model_opencv_test {

std::vector<cv::Point3d> points_in_view(const CameraModel& camera) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  std::vector<cv::Point3d> points;
  for (int i = 0; i < 2000; ++i) {
    const Vec2 px(unit(random) * camera.width(), unit(random) * camera.height());
    const Vec3 p = (0.2 + 20.0 * unit(random)) * camera.unproject(px);
    points.emplace_back(p.x(), p.y(), p.z());
  }
  return points;
}

cv::Matx33d matrix(const CameraModel& c) {
  return {c.fx(), 0, c.cx(), 0, c.fy(), c.cy(), 0, 0, 1};
}

TEST(CameraModelOpenCv, PinholeRadTanEqualsProjectPoints) {
  const std::vector<double> fr1{0.262383, -0.953104, -0.005358, 0.002628, 1.163314};
  const std::vector<double> euroc{-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05, 0.0};
  for (const auto& [camera, k] : {std::pair(test::tum_fr1(), fr1), std::pair(test::euroc(), euroc)}) {
    const std::vector<cv::Point3d> points = points_in_view(camera);
    std::vector<cv::Point2d> expected;
    cv::projectPoints(points, cv::Vec3d(), cv::Vec3d(), matrix(camera), k, expected);
    for (std::size_t i = 0; i < points.size(); ++i) {
      Vec2 px;
      ASSERT_TRUE(camera.project(Vec3(points[i].x, points[i].y, points[i].z), &px));
      ASSERT_NEAR(px.x(), expected[i].x, 1e-9);
      ASSERT_NEAR(px.y(), expected[i].y, 1e-9);
    }
  }
}

TEST(CameraModelOpenCv, KannalaBrandtEqualsFisheye) {
  const CameraModel camera = test::fisheye();
  const std::vector<cv::Point3d> points = points_in_view(camera);
  std::vector<cv::Point2d> expected;
  cv::fisheye::projectPoints(points, expected, cv::Vec3d(), cv::Vec3d(), matrix(camera),
                             cv::Vec4d(-0.012, 0.021, -0.014, 0.0031));
  for (std::size_t i = 0; i < points.size(); ++i) {
    Vec2 px;
    ASSERT_TRUE(camera.project(Vec3(points[i].x, points[i].y, points[i].z), &px));
    ASSERT_NEAR(px.x(), expected[i].x, 1e-9);
    ASSERT_NEAR(px.y(), expected[i].y, 1e-9);
  }
}

}  // namespace camera_model_opencv_test
}  // namespace godwit::vo
