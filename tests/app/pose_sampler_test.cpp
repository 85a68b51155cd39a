#include "firmware_app/autopilot/pose_sampler.h"

#include <Eigen/Cholesky>
#include <gtest/gtest.h>
#include <random>

#include "firmware_app/link/odometry_message.h"
#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::app {
namespace pose_sampler_test {

using Mat3 = Eigen::Matrix3d;
using Mat6 = Eigen::Matrix<double, 6, 6>;
using Vec3 = Eigen::Vector3d;
using Vec6 = Eigen::Matrix<double, 6, 1>;

constexpr rt::TimeNs kFrameNs = rt::kNsPerSecond / 30;

/// Looking ahead and 0.3 rad down.
Mat3 mounting() {
  const double c = std::cos(0.3), s = std::sin(0.3);
  return Mat3{{0, -s, c}, {1, 0, 0}, {0, c, s}};
}

FrameRecord record_at(int frame, const vo::SE3& T_world_cam) {
  FrameRecord r;
  r.t_capture_ns = rt::kNsPerSecond + frame * kFrameNs;
  r.tracked = r.has_pose = true;
  r.map_id = 1;
  r.features = 120;
  r.state = vo::State::kTracking;
  const Eigen::Quaterniond q = T_world_cam.quaternion();
  r.q_world_cam = {q.x(), q.y(), q.z(), q.w()};
  Eigen::Map<Vec3>(r.t_world_cam.data()) = T_world_cam.t;
  for (std::size_t i = 0; i < 6; ++i) r.covariance[std::array<std::size_t, 6>{0, 6, 11, 15, 18, 20}[i]] = 1e-6;
  r.own_covariance = r.covariance;
  return r;
}

vo::SE3 cruise(double t) {
  return {vo::so3_exp(Vec3(0.1, 0.4, -0.2) * t), Vec3(0.3, -0.2, 2.0) * t + Vec3(0, 0.5, 1) * t * t};
}

Vec3 vec(const std::array<double, 3>& a) {
  return Vec3(a[0], a[1], a[2]);
}

TEST(PoseSampler, TheStateTravelsAsItIs) {
  using S = vo::State;
  for (const S state : {S::kInitialising, S::kTracking, S::kCoasting, S::kRelocalising, S::kLost}) {
    PoseSampler sampler(world_of_level_start(mounting()));
    FrameRecord record = record_at(0, {});
    record.state = state;
    EXPECT_EQ(sampler.sample(record).state, state);
    record.has_pose = false;
    EXPECT_EQ(sampler.sample(record).state, vo::claims_pose(state) ? S::kRelocalising : state);
  }
}

TEST(PoseSampler, ARepeatedPictureIsNothingNewWhileTheStateStands) {
  FrameRecord record = record_at(0, {});
  record.repeated = true;
  record.has_pose = record.tracked = false;
  using S = vo::State;
  for (const S state : {S::kInitialising, S::kTracking, S::kCoasting, S::kRelocalising, S::kLost}) {
    record.state = state;
    EXPECT_EQ(PoseSampler::nothing_new(record), vo::claims_pose(state)) << vo::state_name(state);
  }
  record.state = S::kTracking;
  record.repeated = false;
  EXPECT_FALSE(PoseSampler::nothing_new(record)) << "a pose that is missing is told";
}

TEST(PoseSampler, TheMapsFirstViewIsALevelBody) {
  PoseSampler sampler(world_of_level_start(mounting()));
  const link::PoseSample s = sampler.sample(record_at(0, {}));
  link::OdometryConfig config;
  config.R_body_cam = mounting();
  config.bench_metric = true;
  link::PoseSample with_velocity = s;
  with_velocity.has_velocity = true;
  const link::BodyPose body = link::body_pose(with_velocity, config);
  EXPECT_NEAR(body.q(0), 1, 1e-12) << "level, and heading along the local x axis";
  EXPECT_LT(body.position.norm(), 1e-12);
}

TEST(PoseSampler, AMetricRecordIsPassedOnAsItIs) {
  PoseSampler sampler(world_of_level_start(mounting()));
  FrameRecord r = record_at(0, cruise(0.3));
  r.metric = true;
  r.velocity = {1, 2, 3};
  r.velocity_covariance = {1e-4, 1e-5, 2e-5, 4e-4, 3e-5, 9e-4};
  const link::PoseSample s = sampler.sample(r);
  EXPECT_TRUE(s.has_scale && s.has_gravity && s.has_velocity) << "from the first one on";
  EXPECT_EQ(s.position, r.t_world_cam);
  EXPECT_EQ(s.velocity, r.velocity);
  EXPECT_EQ(s.velocity_covariance[5], 3e-5);
  EXPECT_EQ(s.velocity_covariance[7], 3e-5);
  EXPECT_NEAR(std::abs(Eigen::Quaterniond(s.orientation[0], s.orientation[1], s.orientation[2], s.orientation[3])
                           .dot(cruise(0.3).quaternion())),
              1, 1e-12);
  EXPECT_FALSE(sampler.sample(record_at(1, cruise(0.3))).has_scale);
}

TEST(PoseSampler, NorthIsToldAsAJumpOnceAndWhereItTurnsFar) {
  PoseSampler sampler(world_of_level_start(mounting()));
  const auto at = [&](int frame, double heading, bool known = true) {
    FrameRecord r = record_at(frame, {Mat3::Identity(), Vec3(20, 0, 5)});
    r.metric = true;
    r.frame_id = 1;
    r.earth.known = known;
    r.earth.heading = heading;
    r.earth.heading_sigma = 0.002;
    return sampler.sample(r);
  };
  const link::PoseSample unknown = at(0, 0, false);
  EXPECT_FALSE(unknown.heading_known);
  const link::PoseSample first = at(1, M_PI);
  EXPECT_TRUE(first.heading_known);
  EXPECT_NEAR(std::remainder(first.heading_rad + M_PI / 2, 2 * M_PI), 0, 1e-12) << "x axis westwards";
  EXPECT_EQ(first.reset_counter, unknown.reset_counter + 1);
  const link::OdometryConfig config;
  EXPECT_LT((link::body_pose(first, config).position - link::body_pose(unknown, config).position).norm(), 1e-9)
      << "it turns about the camera";
  EXPECT_EQ(at(2, M_PI + 1e-3).reset_counter, first.reset_counter) << "20 mm";
  EXPECT_EQ(at(3, M_PI + 1e-3 - 2 * M_PI).reset_counter, first.reset_counter) << "the same heading";
  EXPECT_EQ(at(3, M_PI + 0.01).heading_rad, first.heading_rad) << "it stands";
  EXPECT_GT(at(3, M_PI + 0.01).heading_variance, 0.99e-4) << "and what it is off by is told";
  // However slowly it creeps: 0.1 radians are five turns of a degree and a bit.
  link::PoseSample s;
  for (int k = 0; k <= 100; ++k) s = at(4 + k, M_PI + 0.001 * k);
  EXPECT_EQ(s.reset_counter, first.reset_counter + 5);
  EXPECT_NEAR(std::remainder(s.heading_rad + M_PI / 2 + 0.1, 2 * M_PI), 0, 0.018);
  const link::PoseSample forgotten = at(110, 0, false);
  EXPECT_EQ(forgotten.heading_rad, s.heading_rad) << "who forgets it does not turn back";
  EXPECT_EQ(forgotten.reset_counter, s.reset_counter);
  EXPECT_GT(forgotten.heading_variance, 9);
  PoseSampler unturned(world_of_level_start(mounting()), false);
  FrameRecord r = record_at(6, {});
  r.metric = r.earth.known = true;
  EXPECT_FALSE(unturned.sample(r).heading_known);
  EXPECT_EQ(unturned.sample(r).reset_counter, 0);
}

TEST(PoseSampler, WhereVisionAndInertialSensorDisagreeTheSigmasToldGrow) {
  PoseSampler sampler(world_of_level_start(mounting()));
  FrameRecord r = record_at(0, cruise(0.3));
  r.metric = true;
  r.velocity_covariance = {1e-4, 1e-5, 2e-5, 4e-4, 3e-5, 9e-4};
  r.earth.known = true;
  r.earth.heading_sigma = 0.01;
  const link::PoseSample trusted = sampler.sample(r);
  ASSERT_GT(trusted.covariance[0], 0);
  r.trust = 0.25;
  const link::PoseSample doubted = sampler.sample(r);
  EXPECT_EQ(doubted.trust, 0.25);
  for (std::size_t i = 0; i < 36; ++i) EXPECT_DOUBLE_EQ(doubted.covariance[i], 16 * trusted.covariance[i]) << i;
  EXPECT_DOUBLE_EQ(doubted.velocity_covariance[5], 16 * 3e-5);
  EXPECT_DOUBLE_EQ(doubted.heading_variance, 16e-4) << "which takes the place of the heading's in there";
  for (const double nothing : {0.0, -1.0, 1e-9}) {
    r.trust = nothing;
    EXPECT_DOUBLE_EQ(sampler.sample(r).covariance[0], 100 * trusted.covariance[0]);
  }
}

TEST(PoseSampler, AMetricFrameGoesOnThroughMapsAndCoastingAndOnlyItsOwnEndIsAReset) {
  PoseSampler sampler(world_of_level_start(mounting()));
  const auto at = [&](int frame, std::uint32_t map_id, std::uint32_t frame_id, vo::State state) {
    FrameRecord r = record_at(frame, cruise(frame / 30.0));
    r.metric = true;
    r.map_id = map_id;
    r.frame_id = frame_id;
    r.state = state;
    r.tracked = state == vo::State::kTracking;
    return sampler.sample(r);
  };
  const link::PoseSample first = at(0, 1, 1, vo::State::kTracking);
  const link::PoseSample coasted = at(1, 1, 1, vo::State::kCoasting);
  EXPECT_EQ(coasted.state, link::PoseState::kCoasting);
  EXPECT_TRUE(coasted.has_scale && coasted.has_gravity);
  EXPECT_GT(vec(coasted.angular_velocity).norm(), 0.1) << "and turn rates go on";
  const link::PoseSample other_map = at(2, 2, 1, vo::State::kTracking);
  EXPECT_EQ(other_map.map_id, first.map_id) << "the frame is the same";
  EXPECT_EQ(other_map.reset_counter, first.reset_counter);
  EXPECT_GT(vec(other_map.angular_velocity).norm(), 0.1);
  EXPECT_NE(at(3, 2, 2, vo::State::kTracking).map_id, first.map_id);
}

// The camera moves along its own axes: what of it is front, right and down of the body.
TEST(PoseSampler, MovesOfTheCameraAreMovesOfTheBody) {
  PoseSampler sampler(world_of_level_start(mounting()));
  sampler.sample(record_at(0, {}));
  const Vec3 moved_cam(0.1, 0.2, 0.5);
  link::PoseSample s = sampler.sample(record_at(1, {Mat3::Identity(), moved_cam}));
  link::OdometryConfig config;
  config.R_body_cam = mounting();
  config.bench_metric = true;
  const link::BodyPose body = link::body_pose(s, config);
  EXPECT_LT((body.position - mounting() * moved_cam).norm(), 1e-12);
  EXPECT_LT((body.velocity - mounting() * moved_cam * 30).norm(), 1e-6);
  EXPECT_GT(body.quality, 0);
  config.bench_metric = false;
  EXPECT_EQ(link::body_pose(s, config).quality, -1) << "the odometry alone knows neither scale nor gravity";
  EXPECT_FALSE(s.has_scale);
  EXPECT_FALSE(s.has_gravity);
}

TEST(PoseSampler, VelocityAndTurnRateAreThoseOfTheMotion) {
  const Mat3 R_world_map = world_of_level_start(mounting());
  PoseSampler sampler(R_world_map);
  for (int i = 0; i < 12; ++i) {
    const double t = i / 30.0;
    const link::PoseSample s = sampler.sample(record_at(i, cruise(t)));
    EXPECT_EQ(s.has_velocity, i > 0);
    if (i < 4) continue;
    const Vec3 velocity = R_world_map * (Vec3(0.3, -0.2, 2.0) + 2 * Vec3(0, 0.5, 1) * t);
    EXPECT_LT((vec(s.velocity) - velocity).norm(), 1e-5) << "a parabola has no lag under constant acceleration";
    EXPECT_LT((vec(s.angular_velocity) - Vec3(0.1, 0.4, -0.2)).norm(), 1e-6);
  }
}

TEST(PoseSampler, VelocityVarianceIsThatOfItsErrors) {
  std::mt19937 random(3);
  std::normal_distribution<double> noise(0, 0.004);
  double squared = 0, told = 0;
  int n = 0;
  for (int run = 0; run < 400; ++run) {
    PoseSampler sampler(Mat3::Identity());
    for (int i = 0; i < 10; ++i) {
      vo::SE3 T = cruise(i / 30.0);
      T.t += Vec3(noise(random), noise(random), noise(random));
      const link::PoseSample s = sampler.sample(record_at(i, T));
      if (i < 6) continue;
      const Vec3 truth = Vec3(0.3, -0.2, 2.0) + 2 * Vec3(0, 0.5, 1) * (i / 30.0);
      squared += (vec(s.velocity) - truth).squaredNorm() / 3;
      told += s.velocity_covariance[0];
      ++n;
    }
  }
  EXPECT_NEAR(squared / told, 1.0, 0.15) << n;
}

TEST(PoseSampler, WhatTheMapIsOffByIsNoNoiseOfTheVelocity) {
  PoseSampler sure(Mat3::Identity()), adrift(Mat3::Identity());
  for (int i = 0; i < 10; ++i) {
    FrameRecord r = record_at(i, cruise(i / 30.0));
    const link::PoseSample near = sure.sample(r);
    for (double& c : r.covariance) c *= 1e4;  // far from where the map began
    const link::PoseSample far = adrift.sample(r);
    EXPECT_GT(far.covariance[0], 1e3 * near.covariance[0]);
    EXPECT_EQ(far.velocity_covariance, near.velocity_covariance);
  }
}

// Perturbs T_cam_world by twists drawn from the record's covariance and looks at what becomes of position and attitude.
TEST(PoseSampler, CovarianceIsThatOfPositionAndAttitudeInTheWorld) {
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  Mat6 A;
  for (int i = 0; i < 36; ++i) A(i) = 1e-3 * normal(random);
  const Mat6 C = A * A.transpose() + 1e-8 * Mat6::Identity();
  const vo::SE3 T_world_cam{vo::so3_exp(Vec3(0.3, -0.7, 0.5)), Vec3(4, -2, 7)};
  FrameRecord record = record_at(0, T_world_cam);
  std::size_t k = 0;
  for (int row = 0; row < 6; ++row)
    for (int column = row; column < 6; ++column) record.covariance[k++] = C(row, column);
  const Mat3 R_world_map = world_of_level_start(mounting());
  PoseSampler sampler(R_world_map);
  const link::PoseSample s = sampler.sample(record);
  const Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>> told(s.covariance.data());

  const Mat6 L = C.llt().matrixL();
  Mat6 seen = Mat6::Zero();
  constexpr int kDraws = 40000;
  for (int i = 0; i < kDraws; ++i) {
    Vec6 x;
    for (int j = 0; j < 6; ++j) x(j) = normal(random);
    const vo::SE3 other = (vo::SE3::exp(L * x) * T_world_cam.inverse()).inverse();
    Vec6 e;
    e << R_world_map * (other.t - T_world_cam.t),
        vo::so3_log(R_world_map * other.R * T_world_cam.R.transpose() * R_world_map.transpose());
    seen += e * e.transpose() / kDraws;
  }
  EXPECT_LT((seen - told).norm(), 0.03 * told.norm());
}

TEST(PoseSampler, ACorrectionOfTheMapIsNoVelocityAndABigOneIsAJump) {
  for (const double metres : {0.02, 0.5}) {
    PoseSampler sampler(Mat3::Identity());
    const Vec3 correction(0, metres, 0);
    std::uint8_t before = 0;
    for (int i = 0; i < 12; ++i) {
      const double t = i / 30.0;
      vo::SE3 T{Mat3::Identity(), Vec3(1, 0, 0) * t};
      FrameRecord r = record_at(i, T);
      if (i >= 8) Eigen::Map<Vec3>(r.t_world_cam.data()) += correction;
      if (i == 8) {
        r.map_moved = true;
        Eigen::Map<Vec3>(r.moved_by.data()) = correction;
      }
      const link::PoseSample s = sampler.sample(r);
      if (i == 7) before = s.reset_counter;
      if (i >= 2) {
        EXPECT_LT((vec(s.velocity) - Vec3(1, 0, 0)).norm(), 1e-6) << i;
      }
      if (i >= 8) {
        EXPECT_EQ(s.reset_counter - before, metres > 0.05 ? 1 : 0) << i;
      }
    }
  }
}

TEST(PoseSampler, ACorrectionWithinThreeSigmaIsNoJump) {
  PoseSampler sampler(Mat3::Identity());
  for (int i = 0; i < 4; ++i) {
    FrameRecord r = record_at(i, {});
    for (const std::size_t k : {0U, 6U, 11U, 15U, 18U, 20U}) r.covariance[k] = 0.04;
    r.map_moved = i == 3;
    r.moved_by = {0.5, 0, 0};
    r.turned_by = {0, 0.3, 0};
    EXPECT_EQ(sampler.sample(r).reset_counter, 0);
  }
}

TEST(PoseSampler, ATurnOfTheMapByMoreThanADegreeIsAJumpAndNoTurnRate) {
  PoseSampler sampler(Mat3::Identity());
  sampler.sample(record_at(0, {}));
  const Mat3 turned = vo::so3_exp(Vec3(0, 0.05, 0));
  FrameRecord r = record_at(1, {turned, Vec3::Zero()});
  r.map_moved = true;
  r.turned_by = {0, 0.05, 0};
  const link::PoseSample s = sampler.sample(r);
  EXPECT_EQ(s.reset_counter, 1);
  EXPECT_LT(vec(s.angular_velocity).norm(), 1e-9);
}

TEST(PoseSampler, WithoutAPoseNothingIsClaimedAndAfterItVelocityBeginsAnew) {
  PoseSampler sampler(Mat3::Identity());
  for (int i = 0; i < 6; ++i) sampler.sample(record_at(i, cruise(i / 30.0)));
  FrameRecord lost = record_at(6, {});
  lost.has_pose = lost.tracked = false;
  EXPECT_EQ(sampler.sample(lost).state, link::PoseState::kRelocalising) << "TRACKING without a pose is no tracking";
  lost = record_at(7, {});
  lost.has_pose = lost.tracked = false;
  lost.state = vo::State::kLost;
  EXPECT_EQ(sampler.sample(lost).state, link::PoseState::kLost);
  EXPECT_FALSE(sampler.sample(record_at(8, cruise(0.5))).has_velocity);
  EXPECT_TRUE(sampler.sample(record_at(9, cruise(0.6))).has_velocity);
  FrameRecord other_map = record_at(10, cruise(3));
  other_map.map_id = 2;
  EXPECT_FALSE(sampler.sample(other_map).has_velocity);
}

TEST(PoseSampler, DoesNotAllocate) {
  PoseSampler sampler(world_of_level_start(mounting()));
  const rt::HeapCounts before = rt::rt_heap_counts();
  for (int i = 0; i < 20; ++i) {
    FrameRecord r = record_at(i, cruise(i / 30.0));
    r.map_moved = i % 3 == 0;
    const rt::RtScope real_time;
    sampler.sample(r);
  }
  EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
}

TEST(VelocityFit, AGapBeginsAnew) {
  vo::VelocityFit fit;
  fit.add(0, Vec3::Zero());
  fit.add(kFrameNs, Vec3(1, 0, 0));
  EXPECT_EQ(fit.points(), 2U);
  fit.add(kFrameNs + vo::VelocityFit::kMaxGapNs + 1, Vec3(9, 9, 9));
  EXPECT_EQ(fit.points(), 1U);
}

}  // namespace pose_sampler_test
}  // namespace godwit::app
