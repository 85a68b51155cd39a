// What the inertial window believes of how vision strays: the course of a map that leans, and what a correction tells.
#include <cmath>
#include <gtest/gtest.h>

#include "tests/vo_core/inertial_flown.h"
#include "vo_core/inertial/inertial_factors.h"

namespace godwit::vo {
namespace inertial_stray_test {

using S = InertialState;
using test::Flight;
using test::Flown;

/// The row of the course between two moments, 0.1 s and `way` map units apart, where vision strays by 0.03 map units in
/// a root of a second: what is left of it, and one sigma of what is new.
struct CourseRow {
  double kept, fresh;
};

CourseRow course_row(double way, const InertialModel& model) {
  VisionSight at_i, at_j;
  at_i.depth = at_j.depth = 10;
  at_i.position_rate = at_j.position_rate = 9e-4;
  at_j.camera = Vec3(0, 0, way);
  S i, j;
  j.camera = at_j.camera;
  Preintegration between;
  for (int k = 0; k < 20; ++k) between.add(Vec3::Zero(), Vec3(0, -9.8, 0), 0.005, model.imu);
  PairJacobian J_i, J_j;
  PairResidual r = pair_residual(i, j, between, at_i, at_j, {}, model, &J_i, &J_j);
  whiten_pair(between, at_i, at_j, model, &r, &J_i, &J_j);
  const int row = 22;
  return {-J_i(row, S::kCourse) / J_j(row, S::kCourse), 1 / J_j(row, S::kCourse)};
}

// As a walk without end it was told as 0.2 rad after a climb of eight seconds, and velocities with it.
TEST(Course, GrowsNoFurtherThanVisionStraysOverAWay) {
  const InertialModel model;
  for (const double way : {0.2, 0.5, 2.0}) {
    const CourseRow row = course_row(way, model);
    double variance = 0;
    for (int k = 0; k < 600; ++k) variance = row.kept * row.kept * variance + row.fresh * row.fresh;
    const double speed = way / 0.1, strays = model.position_stray * 0.03 / speed;
    EXPECT_NEAR(std::sqrt(variance), model.course * strays, 0.05 * model.course * strays) << way;
  }
}

TEST(Course, StaysWhereNothingMoves) {
  const CourseRow row = course_row(0, {});
  EXPECT_GT(std::pow(row.kept, 600), 0.97) << "a minute";
  EXPECT_LT(row.fresh, 0.2 * course_row(0.2, {}).fresh);
}

TEST(VisionStray, CountsWhatACorrectionTookBackForAsLongAsThatReachesBack) {
  const VisionStrayOptions options;
  const double strayed_s = rt::to_seconds(options.strayed_ns);
  VisionStray stray(options);
  VisualPose pose;
  pose.map_id = 1;
  pose.median_depth = 2;
  pose.relative_age_ns = options.age_ns;
  pose.relative_covariance = 1e-8 * Mat6::Identity();
  const auto judge = [&](double t_s) {
    pose.t_ns = static_cast<rt::TimeNs>(t_s * 1e9);
    stray.judge(pose);
  };
  judge(10);
  const double told = stray.rotation_rate();
  pose.map_moved = true;
  pose.moved_by = Vec3(0.3, 0, 0);
  pose.turned_by = Vec3(0, 0.02, 0);
  judge(10.05);
  EXPECT_NEAR(stray.position_rate(), 0.09 / 4 / (3 * strayed_s), 1e-12) << "a walk of an axis, in depths";
  EXPECT_NEAR(stray.rotation_rate(), 4e-4 / (3 * strayed_s), 1e-12);
  pose.map_moved = false;
  judge(10.05 + 6 * strayed_s);
  EXPECT_LT(stray.rotation_rate(), 1.2 * told);
  pose.map_moved = true;
  judge(16);
  pose.map_moved = false;
  pose.map_id = 2;
  judge(16.05);
  EXPECT_NEAR(stray.rotation_rate(), told, 1e-12) << "another map";
}

/// Vision that says it hardly strays, strays within a fifth of a second, and a correction takes that back.
struct Corrected {
  double off2 = 0, sigmas2 = 0;  ///< of the scale's logarithm after it, mean squares
};

Corrected corrected(double moved, int flights) {
  Corrected out;
  for (int seed = 1; seed <= flights; ++seed) {
    Flight f(1.0, static_cast<unsigned>(1200 + seed));
    Flown flown(&f);
    flown.corrected_at_ = 100;
    flown.corrected_over_ = 4;
    flown.corrected_told_ = 1e-7;
    flown.corrected_move_ = moved * Vec3(0.6, -0.5, 0.6);
    for (int k = 0; k < 112; ++k) flown.frame(k);
    if (!flown.odometry_->metric()) {
      ADD_FAILURE() << "seed " << seed << ": " << flown.odometry_->refusal().text;
      continue;
    }
    const auto& smoother = flown.odometry_->smoother();
    const double off = smoother.newest().log_scale - std::log(f.scale_);
    out.off2 += off * off / flights;
    out.sigmas2 += off * off / smoother.covariance()(S::kScale, S::kScale) / flights;
  }
  return out;
}

TEST(MapCorrection, TellsThatVisionStrayedFasterThanItSaid) {
  for (const double moved : {0.0, 0.02, 0.05}) {
    const Corrected c = corrected(moved, 12);
    EXPECT_LT(std::sqrt(c.off2), 0.03) << moved;
    EXPECT_LT(c.sigmas2, 2) << moved;
  }
}

}  // namespace inertial_stray_test
}  // namespace godwit::vo
