// Poses between two pictures: at the link's rate, where the body was at their own time, and none where nobody knows.
#include "firmware_app/link/pose_carrier.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <vector>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/link/fake_bus.h"
#include "tests/link/viso_type3.h"

namespace godwit::link {
namespace pose_carrier_test {

constexpr rt::TimeNs kMs = rt::kNsPerMs;
constexpr rt::TimeNs kShiftNs = -7 * kMs;  // pictures are stamped so much later than they were taken

/// A banked turn of 2 m/s. Body: front, right, down; world: z up.
struct Truth {
  static constexpr double kRate = 0.8, kRadius = 2.5, kClimb = 0.3;
  explicit Truth(rt::TimeNs t_ns) : t(rt::to_seconds(t_ns - 1000 * rt::kNsPerSecond)) {}
  Eigen::Vector3d place() const {
    return {kRadius * std::sin(kRate * t), kRadius * (1 - std::cos(kRate * t)), kClimb * std::sin(2 * t)};
  }
  Eigen::Vector3d speed() const {
    return {kRadius * kRate * std::cos(kRate * t), kRadius * kRate * std::sin(kRate * t), 2 * kClimb * std::cos(2 * t)};
  }
  Eigen::Vector3d force() const {
    const double a = kRadius * kRate * kRate;
    return {-a * std::sin(kRate * t), a * std::cos(kRate * t), -4 * kClimb * std::sin(2 * t) + vo::kStandardGravity};
  }
  Eigen::Matrix3d attitude() const {
    const Eigen::Matrix3d level = Eigen::Vector3d(1, -1, -1).asDiagonal();
    return Eigen::AngleAxisd(kRate * t, Eigen::Vector3d::UnitZ()).toRotationMatrix() * level *
           Eigen::AngleAxisd(0.2, Eigen::Vector3d::UnitX()).toRotationMatrix();
  }
  Eigen::Vector3d rate() const { return attitude().transpose() * Eigen::Vector3d(0, 0, kRate); }
  double t;
};

hal::ImuSample reading(rt::TimeNs t_sensor_ns) {
  const Truth truth(t_sensor_ns - kShiftNs);
  hal::ImuSample s;
  s.t_ns = t_sensor_ns;
  Eigen::Map<Eigen::Vector3d>(s.gyro_rad_s.data()) = truth.rate();
  Eigen::Map<Eigen::Vector3d>(s.accel_m_s2.data()) = truth.attitude().transpose() * truth.force();
  return s;
}

/// As the odometry tells it of a picture.
PoseSample measured(rt::TimeNs t_capture_ns) {
  const Truth truth(t_capture_ns);
  const vo::CameraMounting mounting{OdometryConfig{}.R_body_cam, vo::Vec3::Zero()};
  vo::DeadReckoning state;
  state.p = truth.place();
  state.v = truth.speed();
  state.R = truth.attitude();
  state.P.diagonal() << Eigen::Vector3d::Constant(1e-4), Eigen::Vector3d::Constant(1e-3),
      Eigen::Vector3d::Constant(1e-4), Eigen::Vector3d::Constant(1e-6), Eigen::Vector3d::Constant(1e-3);
  const vo::CameraMotion camera = vo::camera_motion(state, mounting, truth.rate());
  PoseSample s = good_pose(t_capture_ns);
  s.motion = vo::motion_of(state, mounting, t_capture_ns + kShiftNs);
  Eigen::Map<Eigen::Vector3d>(s.position.data()) = camera.T_nav_cam.t;
  const Eigen::Quaterniond q = camera.T_nav_cam.quaternion();
  s.orientation = {q.w(), q.x(), q.y(), q.z()};
  Eigen::Map<Eigen::Vector3d>(s.velocity.data()) = camera.velocity_m_s;
  Eigen::Map<Eigen::Vector3d>(s.angular_velocity.data()) = camera.rate_rad_s;
  Eigen::Map<Eigen::Matrix<double, 6, 6, Eigen::RowMajor>>(s.covariance.data()) = camera.covariance;
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(s.velocity_covariance.data()) = camera.velocity_covariance;
  return s;
}

/// A link that carries; pictures at 30 a second come 15 ms late, readings at 200.
struct Flight {
  explicit Flight(double hz, int rate = 40) : camera_hz(hz), h(config(rate), "", {}, true) { h.camera = false; }
  static LinkConfig config(int rate) {
    LinkConfig c;
    c.parameters[static_cast<std::size_t>(Parameter::kRate)] = rate;
    return c;
  }
  void run(double seconds) {
    for (const rt::TimeNs end = h.now + static_cast<rt::TimeNs>(seconds * 1e9); h.now < end;) {
      if (h.now % (5 * kMs) == 0 && imu) {
        hal::ImuSample s = reading(h.now - kMs);
        if (spoil != nullptr) spoil(&s);
        h.readings.push(s);
      }
      if (h.now >= t_next_picture_ns + 15 * kMs) {
        if (camera) {
          PoseSample s = measured(t_next_picture_ns);
          s.state = state;
          s.reset_counter = jumps;
          h.poses.write(s);
          t_last_picture_ns = t_next_picture_ns;
        }
        t_next_picture_ns += static_cast<rt::TimeNs>(1e9 / camera_hz);
      }
      const rt::RtScope real_time;
      h.step();
    }
  }
  /// What was sent since the last call.
  std::vector<std::pair<rt::TimeNs, mavlink::Odometry>> sent() {
    h.decode_sent();
    std::vector<std::pair<rt::TimeNs, mavlink::Odometry>> out(h.odometry.begin() + seen, h.odometry.end());
    seen = static_cast<std::ptrdiff_t>(h.odometry.size());
    return out;
  }

  double camera_hz;
  LinkHarness h;
  bool camera = true, imu = true;
  PoseState state = PoseState::kTracking;
  std::uint8_t jumps = 0;
  void (*spoil)(hal::ImuSample*) = nullptr;
  rt::TimeNs t_next_picture_ns = 1000 * rt::kNsPerSecond, t_last_picture_ns = 0;
  std::ptrdiff_t seen = 0;
};

rt::TimeNs stamp(const mavlink::Odometry& m) {
  return static_cast<rt::TimeNs>(m.time_usec) * 1000;
}

void expect_true(const mavlink::Odometry& m) {
  const Truth truth(stamp(m));
  const Eigen::Vector3d p = Eigen::Vector3d(1, -1, -1).cwiseProduct(truth.place());
  EXPECT_NEAR((Eigen::Vector3d(m.x, m.y, m.z) - p).norm(), 0, 1e-3);
  EXPECT_NEAR((Eigen::Vector3d(m.vx, m.vy, m.vz) - truth.attitude().transpose() * truth.speed()).norm(), 0, 0.01);
  EXPECT_NEAR((Eigen::Vector3d(m.rollspeed, m.pitchspeed, m.yawspeed) - truth.rate()).norm(), 0, 0.01);
  const Eigen::Matrix3d frd = Eigen::Vector3d(1, -1, -1).asDiagonal();
  EXPECT_LT(
      Eigen::Quaterniond(m.q[0], m.q[1], m.q[2], m.q[3]).angularDistance(Eigen::Quaterniond(frd * truth.attitude())),
      1e-3);
}

void expect_times_grow(const std::vector<std::pair<rt::TimeNs, mavlink::Odometry>>& sent) {
  for (std::size_t i = 1; i < sent.size(); ++i) {
    EXPECT_GT(sent[i].second.time_usec, sent[i - 1].second.time_usec) << i;
    EXPECT_GE(sent[i].first - sent[i - 1].first, 20 * kMs) << "ArduPilot drops what comes closer";
  }
}

TEST(PoseCarrier, PosesLeaveAtTheLinksRateAndAreTrueAtTheirOwnTime) {
  for (const auto& [camera_hz, rate] : {std::pair{30.0, 40}, {15.0, 40}, {20.0, 30}, {60.0, 30}}) {
    Flight f(camera_hz, rate);
    f.run(0.5);
    f.sent();
    f.run(5);
    const auto sent = f.sent();
    EXPECT_NEAR(static_cast<double>(sent.size()) / 5, rate, 0.5) << camera_hz;
    expect_times_grow(sent);
    for (const auto& [t, m] : sent) {
      EXPECT_GT(m.quality, 0);
      // Readings come 1 ms late, 5 ms apart; pictures 15 ms.
      EXPECT_LE(t + kShiftNs - stamp(m), 6 * kMs) << "the newest reading's time, not the picture's";
      expect_true(m);
    }
    EXPECT_GT(f.h.link->status().poses_carried, 100u);
    EXPECT_EQ(f.h.link->status().poses_stale, 0u);
  }
}

TEST(PoseCarrier, ArduPilotTakesThemAtTheLinksRateAndFliesWhereItIs) {
  Flight f(15);
  f.run(0.5);
  f.sent();
  f.run(5);
  VisoType3 autopilot;
  int taken = 0;
  for (const auto& [t, m] : f.sent()) {
    const Truth truth(stamp(m));
    const Eigen::Matrix3d frd = Eigen::Vector3d(1, -1, -1).asDiagonal();
    autopilot.take(m, Eigen::Quaterniond(frd * truth.attitude()));
    EXPECT_FALSE(autopilot.arming_refused);
    ASSERT_TRUE(autopilot.fused.has_value());
    EXPECT_LT((*autopilot.fused - frd * truth.place()).norm(), 1e-3);
    ++taken;
  }
  EXPECT_NEAR(taken, 200, 2) << "of a camera with 15 pictures a second";
  EXPECT_EQ(autopilot.resets, 0);
}

TEST(PoseCarrier, TheCovarianceGrowsFromThePictureOn) {
  PoseSample from = measured(1000 * rt::kNsPerSecond);
  ReadingRing ring;
  PoseCarrier carrier(&ring);
  for (int i = -2; i < 30; ++i) ring.push(reading(from.motion.t_sensor_ns + i * 5 * kMs));
  EXPECT_EQ(carrier.reaches(from), 0) << "nothing is heard yet";
  carrier.hear();
  EXPECT_EQ(carrier.reaches(from), from.t_capture_ns + 100 * kMs);
  from.heading_known = true;
  from.heading_variance = 1e-4;
  double last = 0, last_heading = from.heading_variance;
  for (rt::TimeNs t = from.t_capture_ns; t <= from.t_capture_ns + 100 * kMs; t += 10 * kMs) {
    PoseSample there;
    ASSERT_TRUE(carrier.carry(from, t, &there));
    EXPECT_EQ(there.t_capture_ns, t);
    EXPECT_GT(there.covariance[0] + there.covariance[7] + there.covariance[14], last);
    last = there.covariance[0] + there.covariance[7] + there.covariance[14];
    EXPECT_LE(pose_quality(there), pose_quality(from));
    EXPECT_GE(there.heading_variance, last_heading);
    last_heading = there.heading_variance;
  }
  EXPECT_GT(last_heading, from.heading_variance);
  PoseSample there;
  EXPECT_FALSE(carrier.carry(from, from.t_capture_ns + 101 * kMs, &there)) << "beyond the horizon";
  EXPECT_FALSE(carrier.carry(from, from.t_capture_ns - 1, &there));
  for (bool PoseSample::*known : {&PoseSample::has_scale, &PoseSample::has_gravity}) {
    PoseSample unknown = from;
    unknown.*known = false;
    EXPECT_FALSE(carrier.carry(unknown, from.t_capture_ns + 10 * kMs, &there));
  }
  from.state = PoseState::kRelocalising;
  EXPECT_FALSE(carrier.carry(from, from.t_capture_ns + 10 * kMs, &there));
}

TEST(PoseCarrier, NothingGoesOutBeyondTheHorizonAndASilentCameraIsHeard) {
  Flight f(30);
  f.run(1);
  f.sent();
  f.camera = false;
  f.h.link->frame_begun(f.h.now);  // the picture that is worked on may take its time, and poses stop all the same
  f.run(1);
  const auto sent = f.sent();
  expect_times_grow(sent);
  int good = 0, none = 0;
  for (const auto& [t, m] : sent) {
    if (m.quality < 0) {
      ++none;
      continue;
    }
    ++good;
    EXPECT_EQ(none, 0) << "none once there is none";
    EXPECT_LE(stamp(m), f.t_last_picture_ns + 100 * kMs);
    expect_true(m);
  }
  EXPECT_GE(good, 2);
  EXPECT_GE(none, 20);
}

TEST(PoseCarrier, ALossIsToldAtOnceAndNothingIsCarriedThroughIt) {
  Flight f(30);
  f.run(1);
  f.sent();
  f.state = PoseState::kRelocalising;
  const rt::TimeNs t_lost = f.t_next_picture_ns + 15 * kMs;
  f.run(1);
  const auto sent = f.sent();
  expect_times_grow(sent);
  for (const auto& [t, m] : sent) {
    EXPECT_EQ(m.quality > 0, t < t_lost);
    if (t >= t_lost) {
      EXPECT_GE(m.pose_covariance[0], 1e4);
      EXPECT_EQ(m.vx, 0);
    }
  }
  const auto told = std::find_if(sent.begin(), sent.end(), [](const auto& s) { return s.second.quality < 0; });
  ASSERT_NE(told, sent.end());
  EXPECT_LE(told->first, t_lost + 22 * kMs) << "as soon as the autopilot takes another";
  // Back, and elsewhere: once as unusable with the true place, then with the reset.
  f.state = PoseState::kTracking;
  f.jumps = 1;
  f.run(0.5);
  auto back = f.sent();
  expect_times_grow(back);
  std::erase_if(back, [](const auto& s) { return s.second.quality < 0; });
  ASSERT_GT(back.size(), 10u);
  for (const auto& [t, m] : back) {
    EXPECT_EQ(m.reset_counter, 1);
    expect_true(m);
  }
}

TEST(PoseCarrier, WithoutReadingsPicturesAreToldAsTheyAre) {
  Flight f(30);
  f.run(1);
  f.imu = false;
  f.run(0.2);
  f.sent();
  f.run(2);
  const auto sent = f.sent();
  expect_times_grow(sent);
  EXPECT_NEAR(static_cast<double>(sent.size()) / 2, 30, 1);
  for (const auto& [t, m] : sent) {
    EXPECT_GT(m.quality, 0);
    EXPECT_GE(t - stamp(m), 14 * kMs) << "the picture's time";
    expect_true(m);
  }
}

TEST(PoseCarrier, WhatNoSensorMeasuresMovesNothing) {
  Flight f(30);
  f.run(1);
  f.sent();
  f.spoil = [](hal::ImuSample* s) {
    if (s->t_ns % (20 * kMs) == 19 * kMs) s->accel_m_s2[1] = std::numeric_limits<double>::quiet_NaN();
    if (s->t_ns % (20 * kMs) == 4 * kMs) s->gyro_rad_s[0] = 1e9;
  };
  f.run(1);
  for (const auto& [t, m] : f.sent()) expect_true(m);
}

TEST(PoseCarrier, AReaderThatWasAwayMissesReadingsAndSaysSo) {
  ReadingRing ring;
  PoseCarrier carrier(&ring);
  for (std::size_t i = 0; i < ReadingRing::capacity() + 7; ++i)
    ring.push(reading(static_cast<rt::TimeNs>(1000 * rt::kNsPerSecond + static_cast<rt::TimeNs>(i) * kMs)));
  EXPECT_EQ(carrier.missed(), 7u);
}

TEST(PoseCarrier, StepsDoNotAllocate) {
  Flight f(30);
  f.h.serve_storage = false;
  f.run(1);
  const rt::HeapCounts before = rt::rt_heap_counts();
  f.run(1);
  EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
}

}  // namespace pose_carrier_test
}  // namespace godwit::link
