// What an autopilot of VISO_TYPE 3 makes of a flight in which the pose is lost.
#include "firmware_app/link/pose_hold.h"

#include <gtest/gtest.h>

#include "tests/link/fake_bus.h"
#include "tests/link/viso_type3.h"

namespace godwit::link {
namespace pose_hold_test {

constexpr double kSpeed = 5;  // [m/s], along the world's x

/// A level flight along x at kSpeed, camera ahead; the harness gives the poses, `autopilot` takes what comes of them.
class HeldFlight {
 public:
  HeldFlight() { h.camera = false; }

  double x() const { return kSpeed * rt::to_seconds(h.now - t_start_); }
  Eigen::Vector3d truth() const { return {x(), 0, -10}; }

  PoseSample sample(double x_m) const {
    PoseSample s = good_pose(h.now - 5 * rt::kNsPerMs);
    s.position = {x_m - kSpeed * 0.005, 0, 10};
    const Eigen::Quaterniond q(Eigen::Matrix3d{{0, 0, 1}, {-1, 0, 0}, {0, -1, 0}});
    s.orientation = {q.w(), q.x(), q.y(), q.z()};
    s.velocity = {kSpeed, 0, 0};
    return s;
  }
  static PoseSample lost(PoseSample s) {
    PoseSample none;
    none.t_capture_ns = s.t_capture_ns;
    none.state = PoseState::kLost;
    return none;
  }
  /// Thirty samples a second of what `make` gives; the autopilot hears each message as it goes out.
  template <typename Make>
  void fly(double seconds, Make make) {
    const rt::TimeNs end = h.now + static_cast<rt::TimeNs>(seconds * 1e9);
    while (h.now < end) {
      h.poses.write(make(*this));
      const rt::TimeNs next = h.now + rt::kNsPerSecond / 30;
      while (h.now < next) h.step();
      h.decode_sent();
      for (; heard < h.odometry.size(); ++heard) autopilot.take(h.odometry[heard].second, vehicle);
    }
  }
  void tell_attitude() {
    mavlink::AttitudeQuaternion m;
    m.q1 = static_cast<float>(vehicle.w());
    m.q2 = static_cast<float>(vehicle.x());
    m.q3 = static_cast<float>(vehicle.y());
    m.q4 = static_cast<float>(vehicle.z());
    h.heartbeat(false);
    h.send_mavlink(m);
    h.step();
  }

  LinkHarness h;
  VisoType3 autopilot;
  Eigen::Quaterniond vehicle = Eigen::Quaterniond::Identity();
  std::size_t heard = 0;

 private:
  rt::TimeNs t_start_ = h.now;
};

TEST(PoseHold, ANewMapAfterASearchCostsTheWayFlownBlindAndNoMore) {
  HeldFlight f;
  f.fly(4, [](const HeldFlight& now) { return now.sample(now.x()); });
  EXPECT_LT((*f.autopilot.fused - f.truth()).norm(), 0.5);
  const double x_lost = f.x();
  f.fly(1.2, [](const HeldFlight& now) { return HeldFlight::lost(now.sample(0)); });
  const double x_found = f.x();
  f.fly(2, [&](const HeldFlight& now) {
    PoseSample s = now.sample(now.x() - x_found);
    s.position[2] = 0;  // the new map begins where it was found
    s.map_id = 2;
    return s;
  });
  EXPECT_EQ(f.autopilot.resets, 1) << "one for the new map, none for the loss";
  const Eigen::Vector3d error = *f.autopilot.fused - f.truth();
  EXPECT_LT(error.norm(), x_found - x_lost + 1) << error.transpose();
  EXPECT_LT(std::abs(error.z()), 0.1) << "the height is not the new map's";
}

TEST(PoseHold, WithoutAPoseTheLastOneStandsStill) {
  HeldFlight f;
  f.fly(1, [](const HeldFlight& now) { return now.sample(now.x()); });
  const mavlink::Odometry last = f.h.odometry.back().second;
  const std::size_t before = f.h.odometry.size();
  f.fly(0.5, [](const HeldFlight& now) { return HeldFlight::lost(now.sample(0)); });
  f.h.run(0.5);  // and now not even a sample comes
  f.h.decode_sent();
  ASSERT_GT(f.h.odometry.size(), before + 20);
  for (std::size_t i = before; i < f.h.odometry.size(); ++i) {
    const mavlink::Odometry& m = f.h.odometry[i].second;
    EXPECT_EQ(m.quality, -1);
    EXPECT_EQ(m.x, last.x);
    EXPECT_EQ(m.z, last.z);
    EXPECT_EQ(m.q, last.q);
    EXPECT_EQ(m.vx, 0);
    EXPECT_EQ(m.pose_covariance[0], 1e4F);
    EXPECT_EQ(m.reset_counter, last.reset_counter);
  }
}

TEST(PoseHold, FoundAgainInTheSameMapTheTruePoseComesBeforeTheReset) {
  HeldFlight f;
  f.fly(2, [](const HeldFlight& now) { return now.sample(now.x()); });
  f.fly(2, [](const HeldFlight& now) { return HeldFlight::lost(now.sample(0)); });
  const std::size_t found = f.h.odometry.size();
  f.fly(1, [](const HeldFlight& now) {
    PoseSample s = now.sample(now.x());
    s.reset_counter = 1;  // the map was corrected meanwhile
    return s;
  });
  EXPECT_EQ(f.h.odometry[found].second.quality, -1);
  EXPECT_GT(f.h.odometry[found + 1].second.quality, 0);
  EXPECT_NE(f.h.odometry[found].second.reset_counter, f.h.odometry[found + 1].second.reset_counter);
  // What VISO_TYPE 3 aligns to is a frame old, not the whole search.
  EXPECT_LT((*f.autopilot.fused - f.truth()).norm(), 0.5);
}

TEST(PoseHold, FoundAgainWithoutAJumpIsNoReset) {
  HeldFlight f;
  f.fly(1, [](const HeldFlight& now) { return now.sample(now.x()); });
  f.fly(2, [](const HeldFlight& now) { return HeldFlight::lost(now.sample(0)); });
  f.fly(1, [](const HeldFlight& now) { return now.sample(now.x()); });
  EXPECT_EQ(f.autopilot.resets, 0);
  EXPECT_LT((*f.autopilot.fused - f.truth()).norm(), 0.5);
}

// Turned by 40 and tilted by 15 degrees, nothing known to us yet.
TEST(PoseHold, TheAttitudeBeforeOursIsKnownIsTheAutopilots) {
  HeldFlight f;
  f.vehicle = Eigen::AngleAxisd(0.7, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(0.26, Eigen::Vector3d::UnitY());
  const auto unknown = [](const HeldFlight& now) { return HeldFlight::lost(now.sample(0)); };
  for (int i = 0; i < 5; ++i) {
    f.tell_attitude();
    f.fly(0.2, unknown);
    EXPECT_FALSE(f.autopilot.arming_refused);
  }
  f.vehicle = Eigen::AngleAxisd(0.9, Eigen::Vector3d::UnitZ()) * f.vehicle;  // carried about
  f.tell_attitude();
  f.fly(0.2, unknown);
  EXPECT_FALSE(f.autopilot.arming_refused);
  // Our own frame has another heading; the one reset aligns it.
  f.tell_attitude();
  f.vehicle = Eigen::AngleAxisd(1.6, Eigen::Vector3d::UnitZ());
  f.fly(0.5, [](const HeldFlight& now) { return now.sample(now.x()); });
  EXPECT_EQ(f.autopilot.resets, 1);
  EXPECT_FALSE(f.autopilot.arming_refused);
}

TEST(PoseHold, LostAndTurnedOnTheGroundStillAgrees) {
  HeldFlight f;
  f.vehicle = Eigen::AngleAxisd(2.0, Eigen::Vector3d::UnitZ());
  f.tell_attitude();
  f.fly(0.5, [](const HeldFlight& now) { return now.sample(0); });
  f.vehicle = Eigen::AngleAxisd(2.6, Eigen::Vector3d::UnitZ());
  for (int i = 0; i < 3; ++i) {
    f.tell_attitude();
    f.fly(0.3, [](const HeldFlight& now) { return HeldFlight::lost(now.sample(0)); });
  }
  EXPECT_FALSE(f.autopilot.arming_refused);
}

TEST(PoseHold, NonsenseIsNoAttitude) {
  PoseHold hold;
  hold.heard_attitude({std::nan(""), 0, 0, 0}, 1);
  hold.heard_attitude({0, 0, 0, 0}, 1);
  hold.lose(2);
  EXPECT_TRUE(hold.pose().q.isApprox(Eigen::Vector4d(1, 0, 0, 0)));
}

}  // namespace pose_hold_test
}  // namespace godwit::link
