#include "vo_core/geometry/camera_model.h"

#include <Eigen/SVD>
#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <string>
#include <vector>

#include "tests/vo_core/numeric_jacobian.h"
#include "tests/vo_core/test_cameras.h"

namespace godwit::vo {
namespace camera_model_test {

class EachCamera : public testing::TestWithParam<CameraModel (*)()> {};
INSTANTIATE_TEST_SUITE_P(CameraModel, EachCamera, testing::Values(&test::tum_fr1, &test::euroc, &test::fisheye));

TEST_P(EachCamera, UnprojectIsExactOverTheWholePicture) {
  const CameraModel camera = GetParam()();
  double worst_rad = 0.0;
  for (int v = 0; v < camera.height(); v += 3) {
    for (int u = 0; u < camera.width(); u += 3) {
      const Vec3 ray = camera.unproject(Vec2(u, v));
      ASSERT_NEAR(ray.norm(), 1.0, 1e-12);
      Vec2 back;
      Mat23 J;
      ASSERT_TRUE(camera.project(ray, &back, &J)) << u << " " << v;
      // The error of the ray [rad] from that of the pixel: at least this many pixels go to a radian.
      const double px_per_rad = Eigen::JacobiSVD<Eigen::MatrixXd>(J).singularValues()(1);
      worst_rad = std::max(worst_rad, (back - Vec2(u, v)).norm() / px_per_rad);
    }
  }
  EXPECT_LT(worst_rad, 1e-9);
}

TEST_P(EachCamera, JacobianEqualsNumericOne) {
  const CameraModel camera = GetParam()();
  for (const Vec2& px : {Vec2(3, 4), Vec2(camera.cx(), camera.cy()), Vec2(600, 30), Vec2(17, 470), Vec2(320, 111)}) {
    for (const double range : {0.3, 1.0, 12.0}) {
      const Vec3 p = range * camera.unproject(px);
      Vec2 at;
      Mat23 J;
      ASSERT_TRUE(camera.project(p, &at, &J));
      const auto numeric = test::numeric_jacobian<3>(
          [&](const Vec3& d) {
            Vec2 moved = Vec2::Zero();
            EXPECT_TRUE(camera.project(p + d, &moved));
            return moved;
          },
          1e-6 * range);
      EXPECT_TRUE(test::agrees(J, numeric)) << px.transpose();
    }
  }
}

TEST_P(EachCamera, JacobianNearTheAxisHasNoHole) {
  const CameraModel camera = GetParam()();
  for (const double offset : {0.0, 1e-12, 1e-9, 1e-8, 1e-5}) {
    Vec2 px;
    Mat23 J;
    ASSERT_TRUE(camera.project(Vec3(2.0 * offset, -offset, 2.0), &px, &J));
    EXPECT_NEAR(J(0, 0), camera.fx() / 2.0, 1e-2);
    EXPECT_NEAR(J(1, 1), camera.fy() / 2.0, 1e-2);
    EXPECT_NEAR(px.x(), camera.cx() + camera.fx() * offset, 1e-6);
  }
}

TEST_P(EachCamera, RefusesWhatCannotBeSeenAndLeavesThePixelAlone) {
  const CameraModel camera = GetParam()();
  const double nan = std::numeric_limits<double>::quiet_NaN();
  for (const Vec3& p : {Vec3(0, 0, -1), Vec3(0, 0, 0), Vec3(nan, 0, 1), Vec3(0, nan, 1), Vec3(0, 0, nan)}) {
    Vec2 px(-7, -7);
    EXPECT_FALSE(camera.project(p, &px)) << p.transpose();
    EXPECT_EQ(px, Vec2(-7, -7));
  }
}

template <typename Real>
void expect_rows_as_one_by_one(const CameraModel& camera, double off_px) {
  std::vector<Vec3> points;
  points.reserve(37);
  for (int i = 0; i < 37; ++i)
    points.push_back(camera.unproject(Vec2(17 * i % camera.width(), 29 * i % camera.height())) * (0.5 + i));
  const double nan = std::numeric_limits<double>::quiet_NaN(), inf = std::numeric_limits<double>::infinity();
  points.insert(points.begin() + 5, {Vec3(0, 0, 2), Vec3(0.1, 0.2, -1), Vec3(1, 2, 0), Vec3(nan, 1, 1), Vec3(1, 1, nan),
                                     Vec3(1e30, 1, 1), Vec3(inf, 0, 1)});
  const int count = static_cast<int>(points.size());
  // What stands behind the last point is anything.
  std::vector<std::vector<Real>> row(
      12, std::vector<Real>(static_cast<std::size_t>(CameraModel::row_room(count)), Real(nan)));
  for (std::size_t i = 0; i < points.size(); ++i)
    for (int axis = 0; axis < 3; ++axis) row[static_cast<std::size_t>(axis)][i] = static_cast<Real>(points[i](axis));
  Real* const J[6] = {row[6].data(), row[7].data(), row[8].data(), row[9].data(), row[10].data(), row[11].data()};
  camera.project(count, CameraModel::Rows<Real>{row[0].data(), row[1].data(), row[2].data(), row[3].data(),
                                                row[4].data(), row[5].data(), J});
  for (std::size_t i = 0; i < points.size(); ++i) {
    Vec2 px;
    Mat23 J_one;
    const bool seen = camera.project(points[i], &px, &J_one);
    EXPECT_EQ(row[5][i], seen ? Real(1) : Real(0)) << points[i].transpose();
    for (std::size_t k = 3; k < row.size(); ++k) EXPECT_TRUE(std::isfinite(row[k][i])) << points[i].transpose();
    if (!seen) continue;
    EXPECT_NEAR(row[3][i], px.x(), off_px);
    EXPECT_NEAR(row[4][i], px.y(), off_px);
    for (int k = 0; k < 6; ++k)
      EXPECT_NEAR(row[static_cast<std::size_t>(6 + k)][i], J_one(k / 3, k % 3), off_px * (1.0 + J_one.norm()));
  }
}

TEST_P(EachCamera, ManyPointsAtOnceAreAsOneByOne) {
  expect_rows_as_one_by_one<double>(GetParam()(), 1e-9);
  expect_rows_as_one_by_one<float>(GetParam()(), 3e-4);
}

TEST(CameraModel, FisheyeSeesBehindItsPlane) {
  // 240 degrees across, and more into the corners: the picture holds rays with z < 0.
  const CameraModel camera =
      CameraModel::kannala_brandt(640, 640, 150.0, 150.0, 320.0, 320.0, {0.0, 0.0, 0.0, 0.0}).value();
  const Vec3 ray = camera.unproject(Vec2(320.0, 320.0 + 150.0 * 2.0));
  EXPECT_NEAR(ray.z(), std::cos(2.0), 1e-12);
  EXPECT_NEAR(ray.y(), std::sin(2.0), 1e-12);
  Vec2 px;
  ASSERT_TRUE(camera.project(5.0 * ray, &px));
  EXPECT_NEAR(px.y(), 620.0, 1e-9);
}

TEST(CameraModel, PointsBeyondTheFoldAreNotSeen) {
  // r + k1 r^3 with k1 = -0.2 folds at r = sqrt(1 / 0.6) = 1.29.
  const CameraModel camera = CameraModel::pinhole_radtan(640, 480, 600, 600, 320, 240, {-0.2, 0, 0, 0, 0}).value();
  Vec2 px;
  EXPECT_TRUE(camera.project(Vec3(1.28, 0, 1), &px));
  EXPECT_FALSE(camera.project(Vec3(1.30, 0, 1), &px));
  EXPECT_FALSE(camera.project(Vec3(2.2, 0, 1), &px)) << "the fold would put this point back into the picture";
}

TEST(CameraModel, UnprojectOutsideThePictureStaysFinite) {
  for (const CameraModel& camera : {test::tum_fr1(), test::euroc(), test::fisheye()}) {
    for (const Vec2& px : {Vec2(-500, -500), Vec2(5000, 200), Vec2(300, 1e6)}) {
      const Vec3 ray = camera.unproject(px);
      EXPECT_TRUE(ray.allFinite());
      EXPECT_NEAR(ray.norm(), 1.0, 1e-9);
    }
  }
}

struct Intrinsics {
  int width = 640, height = 480;
  double fx = 500, fy = 500, cx = 320, cy = 240;
};

void expect_refused(const Intrinsics& i, double k, const std::string& word) {
  const auto pinhole = CameraModel::pinhole_radtan(i.width, i.height, i.fx, i.fy, i.cx, i.cy, {k, 0, 0, 0, 0});
  const auto fisheye = CameraModel::kannala_brandt(i.width, i.height, i.fx, i.fy, i.cx, i.cy, {k, 0, 0, 0});
  ASSERT_FALSE(pinhole.ok()) << word;
  ASSERT_FALSE(fisheye.ok()) << word;
  EXPECT_NE(pinhole.error().message.find(word), std::string::npos) << pinhole.error().message;
  EXPECT_NE(fisheye.error().message.find(word), std::string::npos) << fisheye.error().message;
}

TEST(CameraModel, RefusesBadCalibrationNamingTheReason) {
  const double nan = std::numeric_limits<double>::quiet_NaN(), inf = std::numeric_limits<double>::infinity();
  ASSERT_TRUE(CameraModel::pinhole_radtan(640, 480, 500, 500, 320, 240, {}).ok());
  ASSERT_TRUE(CameraModel::kannala_brandt(640, 480, 500, 500, 320, 240, {}).ok());
  expect_refused({.width = 0}, 0, "width is 0");
  expect_refused({.height = -480}, 0, "height is -480");
  expect_refused({.width = 100000}, 0, "width is 100000");
  for (const double f : {0.0, -500.0, nan, inf, 1e-3, 1e9}) {
    expect_refused({.fx = f}, 0, "fx is");
    expect_refused({.fy = f}, 0, "fy is");
  }
  expect_refused({.fx = 200, .fy = 500}, 0, "differ");
  for (const double c : {-1.0, 1e4, nan, inf}) {
    expect_refused({.cx = c}, 0, "cx is");
    expect_refused({.cy = c}, 0, "cy is");
  }
  expect_refused({}, nan, "coefficient 1");
  expect_refused({}, inf, "coefficient 1");
  expect_refused({}, -3.0, "folds inside the picture");
}

}  // namespace camera_model_test
}  // namespace godwit::vo
