#include "firmware_app/link/odometry_message.h"

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <gtest/gtest.h>
#include <limits>
#include <random>

#include "tests/vo_core/numeric_jacobian.h"

namespace godwit::link {
namespace odometry_message_test {

using Mat6 = Eigen::Matrix<double, 6, 6>;
using Vec6 = Eigen::Matrix<double, 6, 1>;

Eigen::Matrix3d exp_so3(const Eigen::Vector3d& w) {
  return w.norm() < 1e-14 ? Eigen::Matrix3d::Identity()
                          : Eigen::AngleAxisd(w.norm(), w.normalized()).toRotationMatrix();
}

class Random {
 public:
  double number(double most) { return std::uniform_real_distribution<double>(-most, most)(engine_); }
  Eigen::Vector3d vector(double most) { return {number(most), number(most), number(most)}; }
  Eigen::Matrix3d rotation() { return exp_so3(vector(2)); }
  Mat6 covariance() {
    Mat6 a;
    for (int i = 0; i < 36; ++i) a(i) = number(0.1);
    return a * a.transpose() + 1e-3 * Mat6::Identity();
  }

 private:
  std::mt19937 engine_{42};
};

void set_rotation(PoseSample* s, const Eigen::Matrix3d& R) {
  const Eigen::Quaterniond q(R);
  s->orientation = {q.w(), q.x(), q.y(), q.z()};
}

PoseSample random_sample(Random& random) {
  PoseSample s;
  s.state = PoseState::kTracking;
  s.has_scale = s.has_gravity = true;
  s.measurements = 100;
  Eigen::Map<Eigen::Vector3d>(s.position.data()) = random.vector(20);
  Eigen::Map<Eigen::Vector3d>(s.velocity.data()) = random.vector(5);
  Eigen::Map<Eigen::Vector3d>(s.angular_velocity.data()) = random.vector(1);
  set_rotation(&s, random.rotation());
  Eigen::Map<Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(s.covariance.data()) = random.covariance();
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(s.velocity_covariance.data()) =
      random.covariance().topLeftCorner<3, 3>();
  return s;
}

OdometryConfig random_mounting(Random& random) {
  OdometryConfig config;
  config.R_body_cam = random.rotation();
  config.t_body_cam = random.vector(0.5);
  return config;
}

Eigen::Matrix3d rotation_of(const Eigen::Vector4d& q) {
  return Eigen::Quaterniond(q(0), q(1), q(2), q(3)).toRotationMatrix();
}

TEST(BodyPose, LevelCameraLookingAheadIsALevelBody) {
  PoseSample s;
  s.state = PoseState::kTracking;
  s.has_scale = s.has_gravity = true;
  s.measurements = 100;
  s.position = {1, 2, 3};
  s.velocity = {4, 0.5, -0.25};
  // Camera z along world x, camera x along -world y, camera y down.
  set_rotation(&s, Eigen::Matrix3d{{0, 0, 1}, {-1, 0, 0}, {0, -1, 0}});
  const BodyPose ardupilot = body_pose(s, {});
  EXPECT_TRUE(ardupilot.position.isApprox(Eigen::Vector3d(1, -2, -3)));
  EXPECT_TRUE(ardupilot.q.isApprox(Eigen::Vector4d(1, 0, 0, 0), 1e-12)) << ardupilot.q.transpose();
  EXPECT_TRUE(ardupilot.velocity.isApprox(Eigen::Vector3d(4, -0.5, 0.25)));
  OdometryConfig px4;
  px4.profile = Profile::kPx4;
  px4.world_heading_rad = M_PI / 2;  // the world's x axis points east
  const BodyPose ned = body_pose(s, px4);
  EXPECT_TRUE(ned.position.isApprox(Eigen::Vector3d(2, 1, -3), 1e-12)) << ned.position.transpose();
  EXPECT_NEAR(std::atan2(rotation_of(ned.q)(1, 0), rotation_of(ned.q)(0, 0)), M_PI / 2, 1e-12) << "heading east";
  EXPECT_TRUE(ned.velocity.isApprox(ardupilot.velocity));
}

TEST(BodyPose, TurnsHaveTheSignsOfFrontRightDown) {
  const Eigen::Matrix3d level{{0, 0, 1}, {-1, 0, 0}, {0, -1, 0}};
  const auto euler = [&](const Eigen::Vector3d& turn_flu) {
    PoseSample s;
    s.state = PoseState::kTracking;
    s.has_scale = s.has_gravity = true;
    set_rotation(&s, exp_so3(turn_flu) * level);
    const Eigen::Matrix3d R = rotation_of(body_pose(s, {}).q);
    return Eigen::Vector3d(std::atan2(R(2, 1), R(2, 2)), -std::asin(R(2, 0)), std::atan2(R(1, 0), R(0, 0)));
  };
  EXPECT_TRUE(euler({0.1, 0, 0}).isApprox(Eigen::Vector3d(0.1, 0, 0), 1e-9)) << "right wing down is positive roll";
  EXPECT_TRUE(euler({0, -0.1, 0}).isApprox(Eigen::Vector3d(0, 0.1, 0), 1e-9)) << "nose up is positive pitch";
  EXPECT_TRUE(euler({0, 0, -0.1}).isApprox(Eigen::Vector3d(0, 0, 0.1), 1e-9)) << "a turn to the right is positive yaw";
}

// The covariance against numeric Jacobians: the body's error for small errors of the camera's pose.
TEST(BodyPose, CovarianceFollowsTheNumericJacobian) {
  Random random;
  for (int i = 0; i < 50; ++i) {
    OdometryConfig config;
    config.profile = i % 2 == 0 ? Profile::kArdupilot : Profile::kPx4;
    config.world_heading_rad = random.number(3);
    config.R_body_cam = random.rotation();
    config.t_body_cam = random.vector(0.5);
    const PoseSample s = random_sample(random);
    const BodyPose base = body_pose(s, config);
    const Eigen::Matrix3d R0 = rotation_of(base.q);
    const Eigen::Matrix3d R = rotation_of({s.orientation[0], s.orientation[1], s.orientation[2], s.orientation[3]});
    const Mat6 J = vo::test::numeric_jacobian<6>([&](const Vec6& x) {
      PoseSample moved = s;
      for (int k = 0; k < 3; ++k) moved.position[k] += x(k);
      set_rotation(&moved, exp_so3(x.tail<3>()) * R);
      const BodyPose out = body_pose(moved, config);
      const Eigen::AngleAxisd turn(rotation_of(out.q) * R0.transpose());
      Vec6 by;
      by << out.position - base.position, turn.angle() * turn.axis();
      return by;
    });
    const Eigen::Map<const Eigen::Matrix<double, 6, 6, Eigen::RowMajor>> C(s.covariance.data());
    const Mat6 expected = J * C * J.transpose();
    EXPECT_LT((base.covariance - expected).norm(), 1e-4 * expected.norm());
    const double turned = base.covariance.diagonal().tail<3>().sum(), given = C.diagonal().tail<3>().sum();
    EXPECT_NEAR(turned, given, 1e-9);
  }
}

// Along the world's x axis and nose up; the world's x axis heads for 120 degrees.
TEST(BodyPose, WhereNorthIsKnownTheFramePointsThereInBothProfiles) {
  PoseSample s;
  s.state = PoseState::kTracking;
  s.has_scale = s.has_gravity = true;
  s.position = {10, 0, 2};
  s.velocity = {3, 0, 0};
  OdometryConfig config;
  const Eigen::Matrix3d R_world_body = exp_so3({0, -0.2, 0}) * Eigen::Vector3d(1, -1, -1).asDiagonal();
  set_rotation(&s, R_world_body * config.R_body_cam);
  const BodyPose plain = body_pose(s, config);
  EXPECT_NEAR(plain.position.x(), 10, 1e-12);
  s.heading_known = true;
  s.heading_rad = 120 * M_PI / 180;
  s.heading_variance = 0.01;
  for (const Profile profile : {Profile::kArdupilot, Profile::kPx4}) {
    config.profile = profile;
    config.world_heading_rad = 1;
    const BodyPose out = body_pose(s, config);
    EXPECT_NEAR(out.position.x(), -5, 1e-9);
    EXPECT_NEAR(out.position.y(), 5 * std::sqrt(3), 1e-9) << "eastwards";
    EXPECT_NEAR(out.position.z(), -2, 1e-9);
    EXPECT_LT((out.velocity - plain.velocity).norm(), 1e-9) << "along the body's axes: nobody turned it";
    const Eigen::Vector3d nose = rotation_of(out.q).col(0);
    EXPECT_NEAR(std::atan2(nose.y(), nose.x()), s.heading_rad, 1e-9);
    // Off by 0.1 rad about a place 10 m away: 1 m across, and nothing along.
    const Eigen::Vector3d along = out.position.normalized(), across(-std::sqrt(3) / 2, -0.5, 0);
    EXPECT_NEAR(across.dot(out.covariance.topLeftCorner<3, 3>() * across), 1, 1e-3);
    EXPECT_LT(along.dot(out.covariance.topLeftCorner<3, 3>() * along), 1e-6);
    EXPECT_NEAR(out.covariance(5, 5), 0.01, 1e-6);
    EXPECT_LT(out.quality, plain.quality);
  }
  config.profile = Profile::kArdupilot;
  config.north = false;
  EXPECT_LT((body_pose(s, config).position - plain.position).norm(), 1e-12);
  config.north = true;
  s.heading_rad = std::numeric_limits<double>::quiet_NaN();
  EXPECT_LT((body_pose(s, config).position - plain.position).norm(), 1e-12) << "no number, no north";
}

// What vision strayed by since the frame began is not what north is off by: a frame of an hour whose north was found a
// minute ago. What it strayed by since is in north's.
TEST(BodyPose, WhereTheFramePointsNorthTheHeadingIsAsSureAsNorthIs) {
  Random random;
  for (int i = 0; i < 50; ++i) {
    OdometryConfig config = random_mounting(random);
    PoseSample s = random_sample(random);
    s.heading_known = true;
    s.heading_rad = random.number(3);
    s.heading_variance = 4e-4;
    s.north_about = {s.position[0] - 3, s.position[1] - 4};
    const BodyPose out = body_pose(s, config);
    EXPECT_NEAR(out.covariance(5, 5), s.heading_variance, 1e-12);
    EXPECT_GT(Eigen::SelfAdjointEigenSolver<Mat6>(out.covariance).eigenvalues().minCoeff(), 0);
    // The same by hand: mean variances of place and angle, five metres from where the frame was turned.
    PoseSample plain = s;
    plain.heading_known = false;
    plain.covariance[35] = s.heading_variance;
    for (const std::size_t axis : {0, 7}) plain.covariance[axis] += s.heading_variance * 25 / 2;
    EXPECT_EQ(out.quality, body_pose(plain, config).quality);
    config.north = false;
    EXPECT_NEAR(body_pose(s, config).covariance(5, 5), s.covariance[35], 1e-12) << "the frame's own";
  }
}

// Velocity of the body's origin against the difference quotient of its position.
TEST(BodyPose, VelocityIsThatOfTheBody) {
  Random random;
  for (int i = 0; i < 50; ++i) {
    OdometryConfig config = random_mounting(random);
    const PoseSample s = random_sample(random);
    const BodyPose base = body_pose(s, config);
    constexpr double kStep = 1e-6;
    PoseSample later = s;
    for (std::size_t k = 0; k < 3; ++k) later.position[k] += kStep * s.velocity[k];
    const Eigen::Matrix3d R = rotation_of({s.orientation[0], s.orientation[1], s.orientation[2], s.orientation[3]});
    set_rotation(&later, R * exp_so3(kStep * Eigen::Vector3d(s.angular_velocity.data())));
    const BodyPose moved = body_pose(later, config);
    const Eigen::Vector3d local = (moved.position - base.position) / kStep;
    EXPECT_LT((rotation_of(base.q) * base.velocity - local).norm(), 1e-5);
    const Eigen::AngleAxisd turn(rotation_of(base.q).transpose() * rotation_of(moved.q));
    EXPECT_LT((turn.angle() * turn.axis() / kStep - base.rates).norm(), 1e-4);
  }
}

TEST(BodyPose, WhatIsNotKnownIsNeutral) {
  Random random;
  PoseSample s = random_sample(random);
  s.has_scale = false;
  const BodyPose no_scale = body_pose(s, {});
  EXPECT_EQ(no_scale.quality, -1);
  EXPECT_TRUE(no_scale.position.isZero());
  EXPECT_TRUE(no_scale.velocity.isZero());
  EXPECT_FALSE(no_scale.q.isApprox(Eigen::Vector4d(1, 0, 0, 0), 1e-3)) << "the attitude is known by gravity";
  EXPECT_EQ(no_scale.covariance(0, 0), kUnknownPositionVariance);
  EXPECT_LT(no_scale.covariance(5, 5), 1);
  s.has_gravity = false;
  const BodyPose no_gravity = body_pose(s, {});
  EXPECT_TRUE(no_gravity.q.isApprox(Eigen::Vector4d(1, 0, 0, 0)));
  EXPECT_EQ(no_gravity.covariance(3, 3), kUnknownAngleVariance);
  OdometryConfig bench;
  bench.bench_metric = true;
  EXPECT_GT(body_pose(s, bench).quality, 0);
  // The arm is in metres, the map in units of its own.
  const BodyPose without_arm = body_pose(s, bench);
  bench.t_body_cam = {0.3, -0.2, 0.1};
  EXPECT_TRUE(body_pose(s, bench).position == without_arm.position);
  EXPECT_TRUE(body_pose(s, bench).velocity == without_arm.velocity);
  EXPECT_TRUE(body_pose(s, bench).covariance == without_arm.covariance);
  s.has_scale = true;
  EXPECT_NEAR((body_pose(s, bench).position - without_arm.position).norm(), bench.t_body_cam.norm(), 1e-9);
  s.has_scale = false;
  for (const PoseState state : {PoseState::kInitialising, PoseState::kRelocalising, PoseState::kLost}) {
    s.state = state;
    EXPECT_EQ(body_pose(s, bench).quality, -1) << "no word of the bench makes a pose out of none";
  }
}

TEST(BodyPose, CovarianceIsAlwaysOneAnEstimatorCanTake) {
  Random random;
  for (int i = 0; i < 200; ++i) {
    PoseSample s = random_sample(random);
    for (double& c : s.covariance) c *= std::pow(10.0, random.number(8));
    for (double& c : s.velocity_covariance) c = random.number(1e6);
    const BodyPose out = body_pose(s, {});
    for (int k = 0; k < 6; ++k) {
      EXPECT_GT(out.covariance(k, k), 0);
      EXPECT_LE(out.covariance(k, k), k < 3 ? kUnknownPositionVariance : kUnknownAngleVariance);
    }
    for (int k = 0; k < 3; ++k) EXPECT_GT(out.velocity_covariance(k, k), 0);
    EXPECT_TRUE(out.covariance.isApprox(out.covariance.transpose()));
  }
}

TEST(BodyPose, QualityIsHalvedByTheSigmasThatAreDocumentedAndByCoasting) {
  PoseSample s;
  s.state = PoseState::kTracking;
  EXPECT_EQ(pose_quality(s), 100);
  for (std::size_t i = 0; i < 3; ++i) s.covariance[7 * i] = 3 * 3;
  EXPECT_EQ(pose_quality(s), 50);
  s.state = PoseState::kCoasting;
  EXPECT_EQ(pose_quality(s), 25);
  s.covariance = {};
  EXPECT_EQ(pose_quality(s), 50);
  s.state = PoseState::kTracking;
  for (std::size_t i = 3; i < 6; ++i) s.covariance[7 * i] = std::pow(5 * M_PI / 180, 2);
  EXPECT_EQ(pose_quality(s), 50);
  s.covariance = {};
  for (std::size_t i = 0; i < 3; ++i) s.velocity_covariance[4 * i] = 0.5 * 0.5;
  EXPECT_EQ(pose_quality(s), 50);
  for (std::size_t i = 0; i < 3; ++i) s.covariance[7 * i] = 1e9;
  EXPECT_EQ(pose_quality(s), 1);
}

TEST(BodyPose, QualityNeverRisesAsAnyVarianceGrows) {
  Random random;
  for (int i = 0; i < 200; ++i) {
    PoseSample s = random_sample(random);
    for (std::size_t k = 0; k < 9; ++k) {
      PoseSample worse = s;
      double* const c = k < 6 ? &worse.covariance[7 * k] : &worse.velocity_covariance[4 * (k - 6)];
      std::int8_t last = pose_quality(worse);
      for (int step = 0; step < 20; ++step) {
        *c = 1.5 * *c + 1e-4;
        ASSERT_LE(pose_quality(worse), last) << k;
        last = pose_quality(worse);
        ASSERT_GE(last, 1);
      }
    }
  }
}

TEST(OdometryMessage, FillsTheFieldsTheProfilesWant) {
  Random random;
  const PoseSample s = random_sample(random);
  OdometryConfig config;
  const BodyPose pose = body_pose(s, config);
  mavlink::Odometry m = odometry_message(pose, config, 123456789012, 7);
  EXPECT_EQ(m.time_usec, 123456789U);
  EXPECT_EQ(m.frame_id, 20);
  EXPECT_EQ(m.child_frame_id, 12);
  EXPECT_EQ(m.reset_counter, 7);
  EXPECT_EQ(m.estimator_type, 2);
  const std::array<std::pair<std::size_t, int>, 6> diagonal{{{0, 0}, {6, 1}, {11, 2}, {15, 3}, {18, 4}, {20, 5}}};
  for (const auto& [index, k] : diagonal)
    EXPECT_FLOAT_EQ(m.pose_covariance[index], static_cast<float>(pose.covariance(k, k)));
  EXPECT_FLOAT_EQ(m.pose_covariance[1], static_cast<float>(pose.covariance(0, 1)));
  EXPECT_FLOAT_EQ(m.velocity_covariance[6], static_cast<float>(pose.velocity_covariance(1, 1)));
  EXPECT_EQ(m.velocity_covariance[15], 0);
  config.profile = Profile::kPx4;
  config.inertial = true;
  m = odometry_message(pose, config, 0, 0);
  EXPECT_EQ(m.frame_id, 1);
  EXPECT_EQ(m.estimator_type, 3);
}

}  // namespace odometry_message_test
}  // namespace godwit::link
