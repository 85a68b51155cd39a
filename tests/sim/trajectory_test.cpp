#include "hal/sim/world/trajectory.h"

#include <Eigen/Geometry>
#include <cmath>
#include <gtest/gtest.h>

namespace godwit::sim {
namespace {

Leg leg(LegKind kind) {
  Leg l;
  l.kind = kind;
  return l;
}

TrajectoryPlan lively_plan() {
  TrajectoryPlan plan;
  plan.start_m = Vec2(10, 20);
  plan.heading_deg = 30;
  Leg up = leg(LegKind::kTakeOff), spin = leg(LegKind::kSpin), dash = leg(LegKind::kDash),
      survey = leg(LegKind::kSurvey), path = leg(LegKind::kPath), land = leg(LegKind::kLand),
      hover = leg(LegKind::kHover);
  up.height_m = 10;
  up.speed_m_s = 2;
  hover.duration_s = 2;
  spin.angle_deg = 200;
  spin.rate_deg_s = 90;
  dash.distance_m = 40;
  dash.speed_m_s = 12;
  survey.length_m = 30;
  survey.width_m = 20;
  survey.spacing_m = 10;
  survey.speed_m_s = 5;
  path.points_m = {{40, 40}, {60, 40}, {60, 60}};
  path.speed_m_s = 4;
  plan.legs = {up, hover, spin, dash, survey, path, land};
  return plan;
}

TEST(Trajectory, DerivativesAreThoseOfThePosition) {
  const Trajectory trajectory(lively_plan(), 2.0, 7);
  constexpr double h = 1e-4;
  for (double t = 0.5; t < trajectory.duration_s() - 0.5; t += 0.37) {
    const BodyState a = trajectory.at(t - h), b = trajectory.at(t), c = trajectory.at(t + h);
    EXPECT_LT(((c.position_m - a.position_m) / (2 * h) - b.velocity_m_s).norm(), 1e-5) << t;
    EXPECT_LT(((c.velocity_m_s - a.velocity_m_s) / (2 * h) - b.acceleration_m_s2).norm(), 1e-5) << t;
    const Eigen::AngleAxisd turn(a.R_world_body.transpose() * c.R_world_body);
    EXPECT_LT((turn.angle() * turn.axis() / (2 * h) - b.omega_rad_s).norm(), 1e-5) << t;
    const Vec3 force = b.R_world_body.transpose() * (b.acceleration_m_s2 + Vec3(0, 0, kGravity));
    EXPECT_LT((force - b.specific_force_m_s2).norm(), 1e-12);
  }
}

TEST(Trajectory, VibrationHasExactDerivativesToo) {
  TrajectoryPlan plan = lively_plan();
  plan.vibration = {.frequency_hz = 70, .angle_deg = 0.2, .position_mm = 0.5};
  const Trajectory trajectory(plan, 0.0, 7);
  constexpr double h = 1e-6;
  for (double t = 1; t < 20; t += 0.731) {
    const BodyState a = trajectory.at(t - h), b = trajectory.at(t), c = trajectory.at(t + h);
    EXPECT_LT(((c.position_m - a.position_m) / (2 * h) - b.velocity_m_s).norm(), 1e-5);
    EXPECT_LT(((c.velocity_m_s - a.velocity_m_s) / (2 * h) - b.acceleration_m_s2).norm(), 1e-3);
    EXPECT_GT((b.specific_force_m_s2 - Vec3(0, 0, -kGravity)).norm(), 0.0);
  }
}

TEST(Trajectory, ItFliesWhatThePlanSays) {
  const TrajectoryPlan plan = lively_plan();
  const Trajectory trajectory(plan, 2.0, 7);
  // On the ground before and after, at rest and level: an accelerometer reads minus gravity along z (down).
  for (const double t : {0.1, trajectory.duration_s()}) {
    const BodyState s = trajectory.at(t);
    EXPECT_NEAR(s.position_m.z(), 2.3, 0.05);
    EXPECT_LT(s.velocity_m_s.norm(), 0.3);
    EXPECT_NEAR(s.specific_force_m_s2.z(), -kGravity, 0.5);
  }
  EXPECT_NEAR((trajectory.at(0).position_m.head<2>() - plan.start_m).norm(), 0, 0.05);
  double fastest = 0, highest = 0, turn = 0;
  for (double t = 0; t < trajectory.duration_s(); t += 0.02) {
    const BodyState s = trajectory.at(t);
    fastest = std::max(fastest, s.velocity_m_s.norm());
    highest = std::max(highest, s.position_m.z());
    turn = std::max(turn, s.omega_rad_s.norm());
    // Nothing a multirotor could not do.
    EXPECT_LT(s.acceleration_m_s2.norm(), 8.0) << t;
    EXPECT_GT(s.R_world_body(2, 2), -1.0001);
    EXPECT_LT(s.R_world_body(2, 2), -0.75) << "tilted more than 40 degrees at " << t;
  }
  EXPECT_NEAR(fastest, std::sqrt(40 * 1.5), 1.5) << "dash: as fast as its length allows";
  EXPECT_NEAR(highest, 12, 0.6);
  EXPECT_NEAR(turn, 1.57, 0.35);
}

TEST(Trajectory, HeadingTurnsFromXTowardsY) {
  TrajectoryPlan plan;
  plan.start_height_m = 5;
  plan.sway = 0;
  plan.heading_deg = 90;
  Leg dash = leg(LegKind::kDash);
  dash.distance_m = 20;
  dash.speed_m_s = 4;
  plan.legs = {dash};
  const Trajectory trajectory(plan, 0, 1);
  const BodyState end = trajectory.at(trajectory.duration_s());
  EXPECT_NEAR(end.position_m.y(), 20, 0.1);
  EXPECT_NEAR(end.R_world_body(1, 0), 1, 0.02) << "nose along y";
  EXPECT_NEAR(end.R_world_body(0, 1), 1, 0.02) << "right wing along x";
}

TEST(Trajectory, ATiltIsNoseUpAndRightSideDownAndStays) {
  TrajectoryPlan plan;
  plan.start_height_m = 5;
  plan.sway = 0;
  Leg tilt = leg(LegKind::kTilt), hover = leg(LegKind::kHover);
  hover.duration_s = 3;
  tilt.rate_deg_s = 20;
  tilt.pitch_deg = 25;
  plan.legs = {tilt, hover};
  const Trajectory nose_up(plan, 0, 1);
  const BodyState up = nose_up.at(nose_up.duration_s());
  EXPECT_NEAR(up.R_world_body(2, 0), std::sin(25 * M_PI / 180), 1e-6) << "the nose points up";
  EXPECT_LT((up.position_m - nose_up.at(0).position_m).norm(), 1e-9) << "in place";
  plan.legs[0].pitch_deg = 0;
  plan.legs[0].roll_deg = 30;
  const Trajectory right_down(plan, 0, 1);
  const BodyState down = right_down.at(right_down.duration_s());
  EXPECT_NEAR(down.R_world_body(2, 1), -std::sin(30 * M_PI / 180), 1e-6) << "the right wing points down";
}

TEST(Trajectory, SameSeedSameFlightOtherSeedOtherSway) {
  const Trajectory a(lively_plan(), 0, 3), b(lively_plan(), 0, 3), c(lively_plan(), 0, 4);
  EXPECT_EQ(a.at(9.1).position_m, b.at(9.1).position_m);
  EXPECT_EQ(a.at(9.1).R_world_body, b.at(9.1).R_world_body);
  EXPECT_NE(a.at(9.1).position_m, c.at(9.1).position_m);
}

}  // namespace
}  // namespace godwit::sim
