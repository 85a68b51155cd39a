// The pictures against truth: features tracked by OpenCV, masks against boxes, determinism.
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <gtest/gtest.h>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>
#include <vector>

#include "hal/sim/flight/flight.h"
#include "tests/sim/test_scenario.h"

namespace godwit::sim {
namespace {

using test::kSmall;
using test::scenario;

struct Picture {
  cv::Mat grey, mask;  ///< mask: 0 where no mover is
  hal::CapturedFrame frame;
  std::vector<TrueBox> boxes;
};

Picture take(SimCamera* camera, int index) {
  Picture p;
  p.grey.create(camera->height(), camera->width(), CV_8U);
  camera->skip_to(index);
  std::string why;
  const auto status =
      camera->next({p.grey.data, p.grey.cols, p.grey.rows, static_cast<int>(p.grey.step)}, nullptr, 0, &p.frame, &why);
  EXPECT_EQ(status, hal::CameraStatus::kFrame) << why;
  EXPECT_EQ(camera->scene().dropped_triangles(), 0);
  p.mask.create(p.grey.size(), CV_16U);
  for (int y = 0; y < p.mask.rows; ++y) {
    std::memcpy(p.mask.ptr(y), camera->scene().mover_mask() + y * camera->scene().stride(),
                static_cast<std::size_t>(p.mask.cols) * 2);
  }
  p.boxes = camera->scene().boxes();
  return p;
}

/// Grey levels relative to their neighbourhood's mean and spread.
cv::Mat structure(const cv::Mat& grey) {
  cv::Mat g, mean, squares, spread, out;
  grey.convertTo(g, CV_32F);
  cv::GaussianBlur(g, mean, cv::Size(), 8);
  cv::GaussianBlur(g.mul(g), squares, cv::Size(), 8);
  cv::sqrt(cv::max(squares - mean.mul(mean), 0) + 4.0, spread);
  cv::Mat((g - mean) / spread * 40 + 128).convertTo(out, CV_8U);
  return out;
}

/// Median distance [px] of tracked still features to the epipolar line that the true motion gives them.
double median_epipolar_error(const Flight& flight, int first, int second, int* tracks) {
  const std::unique_ptr<SimCamera> camera = flight.camera(0);
  const auto is_there = [&](int index) {
    hal::CapturedFrame frame;
    camera->skip_to(index);
    return camera->next({}, nullptr, 0, &frame, nullptr) == hal::CameraStatus::kFrame;
  };
  const int step = second - first;
  while (!is_there(first) || !is_there(second)) second = ++first + step;  // the scenario drops some
  Picture a = take(camera.get(), first), b = take(camera.get(), second);
  // The tracker takes a point to keep its brightness; flicker and exposure break that, so only structure is left in.
  for (Picture* p : {&a, &b}) p->grey = structure(p->grey);
  cv::Mat still = a.mask == 0;
  cv::erode(still, still, cv::Mat(), cv::Point(-1, -1), 12);
  std::vector<cv::Point2f> pa, pb, back;
  cv::goodFeaturesToTrack(a.grey, pa, 400, 0.01, 10, still);
  std::vector<unsigned char> ok, ok_back;
  std::vector<float> error;
  const cv::TermCriteria stop(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 50, 0.001);
  cv::calcOpticalFlowPyrLK(a.grey, b.grey, pa, pb, ok, error, cv::Size(21, 21), 3, stop);
  cv::calcOpticalFlowPyrLK(b.grey, a.grey, pb, back, ok_back, error, cv::Size(21, 21), 3, stop);
  const CameraRig& rig = flight.scenario().camera.rig;
  const double middle = (rig.lens.height - 1) / 2.0;
  std::vector<double> distance;
  for (std::size_t i = 0; i < pa.size(); ++i) {
    if (!ok[i] || !ok_back[i] || cv::norm(back[i] - pa[i]) > 0.3) continue;
    if (pb[i].x < 5 || pb[i].y < 5 || pb[i].x > static_cast<float>(b.grey.cols - 6) ||
        pb[i].y > static_cast<float>(b.grey.rows - 6))
      continue;
    if (b.mask.at<std::uint16_t>(static_cast<int>(pb[i].y), static_cast<int>(pb[i].x)) != 0) continue;
    // Poses of the very rows in which the feature is seen (the same for all rows with a global shutter).
    const auto pose = [&](int index, float row) {
      return camera_pose(flight.trajectory(), rig,
                         flight.frame_time_s(index) + (row - middle) / (rig.lens.height - 1) * rig.readout_s);
    };
    const CameraPose ta = pose(first, pa[i].y), tb = pose(second, pb[i].y);
    const Mat3 R = tb.R_world_cam.transpose() * ta.R_world_cam;
    const Vec3 t = (tb.R_world_cam.transpose() * (ta.position_m - tb.position_m)).normalized();
    const Vec2 ra = rig.lens.unproject(Vec2(pa[i].x, pa[i].y)), rb = rig.lens.unproject(Vec2(pb[i].x, pb[i].y));
    const Vec3 line = t.cross(R * Vec3(ra.x(), ra.y(), 1));
    const double off = line.dot(Vec3(rb.x(), rb.y(), 1)) / line.head<2>().norm();
    distance.push_back(std::abs(off) * rig.lens.fx);
  }
  *tracks = static_cast<int>(distance.size());
  if (distance.empty()) return 1e9;
  std::nth_element(distance.begin(), distance.begin() + static_cast<std::ptrdiff_t>(distance.size() / 2),
                   distance.end());
  return distance[distance.size() / 2];
}

struct EpipolarCase {
  const char* name;
  int first, step, tracks;
};

class Epipolar : public testing::TestWithParam<EpipolarCase> {};

TEST_P(Epipolar, TrackedFeaturesObeyTheTruth) {
  const EpipolarCase& c = GetParam();
  const Flight flight(scenario(c.name), 3);
  int tracks = 0;
  const double error = median_epipolar_error(flight, c.first, c.first + c.step, &tracks);
  std::printf("%s: median epipolar error %.3f px over %d tracks\n", c.name, error, tracks);
  RecordProperty("median_epipolar_px", std::to_string(error));
  EXPECT_GE(tracks, kSmall ? c.tracks / 4 : c.tracks);
  EXPECT_LT(error, 0.2);
}

INSTANTIATE_TEST_SUITE_P(
    Scenarios, Epipolar,
    testing::Values(EpipolarCase{"street", 300, 6, 100}, EpipolarCase{"survey", 400, 5, 100},
                    EpipolarCase{"corridor", 600, 6, 60}, EpipolarCase{"take-off-and-land", 500, 5, 100},
                    EpipolarCase{"glare", 300, 6, 100}, EpipolarCase{"night", 400, 5, 40},
                    EpipolarCase{"vibration", 300, 5, 100}, EpipolarCase{"half-the-picture-moving", 400, 5, 40},
                    EpipolarCase{"low-texture", 450, 4, 40}, EpipolarCase{"flicker-100hz", 300, 5, 100},
                    EpipolarCase{"hover-in-crowd", 300, 15, 40}, EpipolarCase{"dropped-frames", 301, 5, 100},
                    EpipolarCase{"rangefinder-jumps", 300, 5, 100}, EpipolarCase{"gnss-loss", 300, 5, 100}),
    [](const auto& test) {
      std::string name = test.param.name;
      std::replace(name.begin(), name.end(), '-', '_');
      return name;
    });

TEST(Lens, ProjectsAsOpenCvDoes) {
  const Lens lens = scenario("street").camera.rig.lens;
  const cv::Matx33d K(lens.fx, 0, lens.cx, 0, lens.fy, lens.cy, 0, 0, 1);
  const std::vector<double> d(lens.distortion.begin(), lens.distortion.end());
  std::vector<cv::Point3d> points;
  for (double x = -0.7; x <= 0.7; x += 0.1) {
    for (double y = -0.5; y <= 0.5; y += 0.1) points.emplace_back(x * 3, y * 3, 3);
  }
  std::vector<cv::Point2d> px;
  cv::projectPoints(points, cv::Vec3d(0, 0, 0), cv::Vec3d(0, 0, 0), K, d, px);
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Vec2 ray(points[i].x / 3, points[i].y / 3), mine = lens.project(ray);
    EXPECT_NEAR(mine.x(), px[i].x, 1e-9);
    EXPECT_NEAR(mine.y(), px[i].y, 1e-9);
    EXPECT_LT((lens.unproject(mine) - ray).norm(), 1e-9);
  }
}

TEST(Depth, IsThatOfTheGround) {
  // Straight rays through the picture, cut with the relief by bisection: the renderer must agree wherever it shows
  // ground.
  Scenario s = scenario("survey");
  s.world.trees = 0;
  const Flight flight(s, 2);
  const std::unique_ptr<SimCamera> camera = flight.camera(0);
  take(camera.get(), 200);
  const Renderer& scene = camera->scene();
  const CameraPose& pose = scene.pose();
  int close = 0, all = 0;
  for (int v = 10; v < camera->height(); v += 20) {
    for (int u = 10; u < camera->width(); u += 20) {
      const std::size_t i = static_cast<std::size_t>(v * scene.stride() + u);
      const Vec3 ray = pose.R_world_cam * Vec3(scene.rays().x[i], scene.rays().y[i], 1);
      double low = 1, high = 400;
      for (int k = 0; k < 60; ++k) {
        const double z = 0.5 * (low + high);
        const Vec3 p = pose.position_m + z * ray;
        (p.z() > flight.world().terrain().height(p.x(), p.y()) ? low : high) = z;
      }
      ++all;
      close += std::abs(static_cast<double>(scene.inverse_depth()[i]) * low - 1) < 2e-3 ? 1 : 0;
    }
  }
  EXPECT_GT(close, all * 9 / 10) << "the rest shows barns, bales and people";
}

class Boxes : public testing::TestWithParam<const char*> {};

TEST_P(Boxes, HoldTheirMoversPixels) {
  const Flight flight(scenario(GetParam()), 5);
  const std::unique_ptr<SimCamera> camera = flight.camera(0);
  long inside = 0, all = 0, box_area = 0;
  int boxes = 0;
  for (int index = 100; index < 1300; index += 240) {
    const Picture p = take(camera.get(), index);
    for (const TrueBox& box : p.boxes) {
      long mine = 0, held = 0;
      for (int y = 0; y < p.mask.rows; ++y) {
        for (int x = 0; x < p.mask.cols; ++x) {
          if (p.mask.at<std::uint16_t>(y, x) != box.mover + 1) continue;
          ++mine;
          held += x + 1 > box.x0 && x < box.x1 && y + 1 > box.y0 && y < box.y1 ? 1 : 0;
        }
      }
      ASSERT_EQ(mine, box.visible_px);
      if (mine >= 30) {
        EXPECT_GE(static_cast<double>(held), 0.98 * static_cast<double>(mine))
            << GetParam() << " picture " << index << " mover " << box.mover;
        // And it is no larger than it must be: a thing that is not hidden fills a fair part of its box.
        box_area += static_cast<long>((box.x1 - box.x0) * (box.y1 - box.y0));
      }
      inside += held;
      all += mine;
      ++boxes;
    }
    // No mover's pixel without a box.
    for (int y = 0; y < p.mask.rows; y += 3) {
      for (int x = 0; x < p.mask.cols; x += 3) {
        const int id = p.mask.at<std::uint16_t>(y, x);
        if (id == 0) continue;
        ASSERT_TRUE(std::any_of(p.boxes.begin(), p.boxes.end(), [&](const TrueBox& b) { return b.mover + 1 == id; }));
      }
    }
  }
  ASSERT_GT(boxes, 5);
  ASSERT_GT(all, 1000);
  EXPECT_GE(static_cast<double>(inside), 0.98 * static_cast<double>(all));
  EXPECT_GT(static_cast<double>(all), 0.2 * static_cast<double>(box_area));
}

INSTANTIATE_TEST_SUITE_P(Scenarios, Boxes,
                         testing::Values("street", "hover-in-crowd", "half-the-picture-moving", "vibration"),
                         [](const auto& test) {
                           std::string name = test.param;
                           std::replace(name.begin(), name.end(), '-', '_');
                           return name;
                         });

TEST(Pictures, SameSeedSamePicturesToTheBit) {
  const Scenario s = scenario("street");
  const Flight a(s, 9), b(s, 9), c(s, 10);
  const std::unique_ptr<SimCamera> ca = a.camera(0), cb = b.camera(0), cc = c.camera(0);
  for (const int index : {0, 1, 2}) {
    const Picture pa = take(ca.get(), index), pb = take(cb.get(), index), pc = take(cc.get(), index);
    EXPECT_EQ(cv::norm(pa.grey, pb.grey, cv::NORM_INF), 0);
    EXPECT_EQ(cv::norm(pa.mask, pb.mask, cv::NORM_INF), 0);
    EXPECT_GT(cv::norm(pa.grey, pc.grey, cv::NORM_L1) / static_cast<double>(pa.grey.total()), 5)
        << "another seed is another street";
  }
}

TEST(Pictures, OneThatNobodyTakesLeavesTheOthersAsTheyAre) {
  const Flight flight(scenario("street"), 9);
  ASSERT_TRUE(flight.scenario().sensor.auto_exposure);
  const std::unique_ptr<SimCamera> all = flight.camera(0), some = flight.camera(0);
  for (const int index : {0, 1, 2, 3}) {
    const Picture wanted = take(all.get(), index);
    if (index == 1 || index == 2) {
      hal::CapturedFrame frame;
      EXPECT_EQ(some->next({}, nullptr, 0, &frame, nullptr), hal::CameraStatus::kFrame);
      EXPECT_EQ(frame.sequence, static_cast<std::uint32_t>(index));
    } else {
      EXPECT_EQ(cv::norm(wanted.grey, take(some.get(), index).grey, cv::NORM_INF), 0) << index;
    }
  }
}

TEST(Pictures, NoiseIsNewInEveryPicture) {
  Scenario s = scenario("street");
  s.trajectory.legs = {Leg{}};
  s.trajectory.legs[0].duration_s = 10;
  s.trajectory.sway = 0;
  s.world.cars = s.world.people = 0;
  s.sensor.auto_exposure = false;
  s.sensor.read_noise = 2;
  s.sensor.shot_noise = 0;
  const Flight flight(s, 1);
  const std::unique_ptr<SimCamera> camera = flight.camera(0);
  const Picture a = take(camera.get(), 30), b = take(camera.get(), 31);
  cv::Mat difference;
  cv::subtract(a.grey, b.grey, difference, cv::noArray(), CV_32F);
  cv::Scalar mean, deviation;
  cv::meanStdDev(difference, mean, deviation, (a.grey > 15) & (a.grey < 240));
  EXPECT_NEAR(mean[0], 0, 0.05);
  EXPECT_NEAR(deviation[0], 2 * std::sqrt(2.0), 0.3);
}

TEST(Pictures, AMovedCameraBlursAlongItsMotion) {
  Scenario s = scenario("street");
  Leg spin;
  spin.kind = LegKind::kSpin;
  spin.angle_deg = 180;
  spin.rate_deg_s = 60;
  s.trajectory.legs = {spin};
  s.sensor.auto_exposure = false;
  const auto sharpness = [&](double exposure_ms, bool across) {
    s.sensor.exposure_ms = exposure_ms;
    const Flight flight(s, 4);
    const std::unique_ptr<SimCamera> camera = flight.camera(0);
    const Picture p = take(camera.get(), 75);
    cv::Mat gradient;
    cv::Sobel(p.grey, gradient, CV_32F, across ? 1 : 0, across ? 0 : 1);
    return cv::norm(gradient, cv::NORM_L1);
  };
  EXPECT_LT(sharpness(20, true), 0.7 * sharpness(0.1, true)) << "a turn smears across";
  EXPECT_GT(sharpness(20, false) / sharpness(0.1, false), 1.15 * sharpness(20, true) / sharpness(0.1, true))
      << "and less up and down";
}

TEST(Pictures, FlickerMakesBandsWithARollingShutter) {
  Scenario s = scenario("flicker-100hz");
  const auto row_means = [&](double depth) {
    s.sensor.flicker_depth = depth;
    const Flight flight(s, 2);
    const std::unique_ptr<SimCamera> camera = flight.camera(0);
    const Picture p = take(camera.get(), 90);
    cv::Mat rows;
    cv::reduce(p.grey, rows, 1, cv::REDUCE_AVG, CV_32F);
    return rows;
  };
  cv::Mat ratio;
  cv::divide(row_means(0.5), row_means(0), ratio);
  double low = 0, high = 0;
  cv::minMaxLoc(ratio, &low, &high);
  EXPECT_GT(high / low, 1.5);
}

TEST(Pictures, TheScenarioDropsPictures) {
  const Flight flight(test::in_small(scenario("dropped-frames")), 1);  // all of its pictures are drawn
  const std::unique_ptr<SimCamera> camera = flight.camera(7'000);
  int bad = 0, due = 0;
  hal::CapturedFrame frame;
  std::string why;
  for (hal::CameraStatus status; (status = camera->next({}, nullptr, 0, &frame, &why)) != hal::CameraStatus::kEnd;
       ++due) {
    EXPECT_EQ(frame.sequence, static_cast<std::uint32_t>(due));
    EXPECT_EQ(frame.t_capture_ns, 7'000 + frame.t_source_ns);
    bad += status == hal::CameraStatus::kBadFrame ? 1 : 0;
  }
  EXPECT_EQ(due, camera->frames());
  EXPECT_EQ(why, "dropped by the scenario");
  EXPECT_NEAR(static_cast<double>(bad) / due, 0.1 + 0.9 * 0.5 / 12, 0.04);
}

TEST(Rangefinder, MeasuresAndJumps) {
  const Flight flight(scenario("rangefinder-jumps"), 1);
  const std::unique_ptr<SimRangefinder> range = flight.rangefinder(0);
  ASSERT_NE(range, nullptr);
  hal::RangeSample sample;
  int lost = 0, all = 0, jumped = 0;
  while (range->next(&sample, 0) == hal::RangeStatus::kSample) {
    ++all;
    const double t = rt::to_seconds(sample.t_ns);
    EXPECT_GT(range->truth_m(), 4);
    EXPECT_LT(range->truth_m(), 25);
    if (!sample.valid) {
      ++lost;
      continue;
    }
    const bool jump = (t >= 8 && t < 9.5) || (t >= 20 && t < 20.3) || (t >= 30 && t < 40);
    EXPECT_EQ(std::abs(sample.range_m - range->truth_m()) > 0.3, jump) << t;
    jumped += jump ? 1 : 0;
  }
  EXPECT_EQ(all, 60 * 20 + 1);
  EXPECT_NEAR(static_cast<double>(lost) / all, 0.1, 0.03);
  EXPECT_GT(jumped, 150);
}

TEST(Gnss, IsLostWhenTheScenarioSaysSo) {
  const Flight flight(scenario("gnss-loss"), 1);
  const std::unique_ptr<SimGnss> gnss = flight.gnss(0);
  ASSERT_NE(gnss, nullptr);
  hal::GnssSample sample;
  double squares = 0;
  int fixes = 0;
  while (gnss->next(&sample, 0) == hal::GnssStatus::kSample) {
    const double t = rt::to_seconds(sample.t_ns);
    ASSERT_EQ(sample.fix, t < 20) << t;
    if (!sample.fix) continue;
    const Vec3 truth = flight.trajectory().at(t).position_m;
    squares += std::pow(sample.position_m[0] - truth.x(), 2) + std::pow(sample.position_m[1] - truth.y(), 2);
    ++fixes;
  }
  EXPECT_EQ(fixes, 100);
  EXPECT_LT(std::sqrt(squares / fixes), 4 * sample.sigma_position_m);
  EXPECT_GT(squares, 0);
  EXPECT_EQ(flight.scenario().gnss.lost_after_s, 20);
}

}  // namespace
}  // namespace godwit::sim
