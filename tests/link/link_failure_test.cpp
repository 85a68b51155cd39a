// What fails on our side, and how it is told.
#include <cmath>
#include <cstring>
#include <gtest/gtest.h>
#include <limits>

#include "firmware_app/link/link_node.h"
#include "tests/link/fake_bus.h"

namespace godwit::link {
namespace link_failure_test {

constexpr rt::TimeNs kMs = rt::kNsPerMs;

TEST(LinkNode, LostIsToldWithTheFrame) {
  LinkHarness h;
  h.run(2);
  h.make_pose = [](rt::TimeNs t) {
    PoseSample s = good_pose(t);
    s.state = PoseState::kLost;
    return s;
  };
  const rt::TimeNs first_lost = h.next_frame;
  h.run(1);
  h.make_pose = good_pose;
  h.run(1);
  h.decode_sent();
  bool told = false;
  int good_after = 0;
  for (const auto& [t, m] : h.odometry) {
    const bool is_first = m.time_usec == static_cast<std::uint64_t>(first_lost / 1000);
    if (is_first) {
      EXPECT_EQ(m.quality, -1);
    }
    told = told || is_first;
    if (m.quality < 0) {
      EXPECT_NEAR(m.x, 1, 0.1) << "the last position";
      EXPECT_EQ(m.vx, 0);
      EXPECT_EQ(m.pose_covariance[0], 1e4F);
    }
    good_after += t > first_lost + rt::kNsPerSecond && m.quality > 0 ? 1 : 0;
  }
  EXPECT_TRUE(told);
  EXPECT_GT(good_after, 25);
  EXPECT_NE(
      std::find_if(h.texts.begin(), h.texts.end(), [](const auto& x) { return x.find("lost") != std::string::npos; }),
      h.texts.end());
}

TEST(LinkNode, SilentCameraIsAnErrorWithin100MsAndNoPoseFreezes) {
  LinkHarness h;
  h.run(2);
  h.camera = false;
  const rt::TimeNs last = h.next_frame - static_cast<rt::TimeNs>(1e9 / 30) + 5 * kMs;
  h.run(1);
  h.decode_sent();
  const auto error =
      std::find_if(h.statuses.begin(), h.statuses.end(), [](const auto& s) { return s.second.health == 2; });
  ASSERT_NE(error, h.statuses.end());
  EXPECT_LE(error->first - last, 90 * kMs);
  EXPECT_EQ(error->second.vendor_code & kPoseStalled, kPoseStalled);
  int failing = 0;
  for (const auto& [t, m] : h.odometry) {
    if (t > last + 95 * kMs) {
      EXPECT_EQ(m.quality, -1);
      ++failing;
    }
  }
  EXPECT_NEAR(failing, 27, 3) << "the stream of -1 goes on at the usual rate";
  h.camera = true;
  h.next_frame = h.now;
  h.run(1);
  EXPECT_EQ(h.link->status().condition.health, dronecan::NodeHealth::kOk);
  EXPECT_GT(h.link->status().quality, 0);
}

TEST(LinkNode, ACameraThatNeverGivesAPictureIsAnError) {
  LinkHarness h;
  h.camera = false;
  h.run(2.9);
  EXPECT_EQ(h.link->status().condition.health, dronecan::NodeHealth::kOk) << "it may still be starting";
  EXPECT_EQ(h.link->status().condition.mode, dronecan::NodeMode::kInitialization);
  h.run(0.2);
  EXPECT_EQ(h.link->status().condition.health, dronecan::NodeHealth::kError);
  EXPECT_EQ(h.link->status().condition.reasons & kPoseStalled, kPoseStalled);
  h.next_frame = h.now;
  h.camera = true;
  h.run(0.2);
  EXPECT_EQ(h.link->status().condition.health, dronecan::NodeHealth::kOk);
}

// Whatever the node said of itself just before, and with an ODOMETRY on its way at 1 Mbit/s.
TEST(LinkNode, SilenceIsToldWithin100MsInEveryPhaseOfTheStatus) {
  rt::TimeNs latest = 0;
  for (int phase_ms = 0; phase_ms < 1000; phase_ms += 7) {
    LinkHarness h;
    h.bus.budget_per_step = 8;  // of about 128 bits, in a step of a millisecond
    h.run(2 + phase_ms * 1e-3);
    h.camera = false;
    const rt::TimeNs last = h.t_last_pose;
    h.heartbeat(phase_ms % 2 == 0);  // changes the node's reasons, which costs a status of its own
    h.run(0.2);
    h.decode_sent();
    const auto error =
        std::find_if(h.statuses.begin(), h.statuses.end(), [](const auto& s) { return s.second.health == 2; });
    ASSERT_NE(error, h.statuses.end()) << phase_ms;
    EXPECT_GE(error->first - last, 80 * kMs) << phase_ms;
    latest = std::max(latest, error->first - last);
  }
  EXPECT_LE(latest, 95 * kMs);
  RecordProperty("latest_ms", static_cast<int>(latest / kMs));
}

// At 30 pictures a second: late by up to two thirds of a period, one in seven lost, and the two together.
TEST(LinkNode, LateAndSinglyLostPicturesAreNoFailure) {
  LinkHarness h;
  h.camera = false;
  const rt::TimeNs period = rt::kNsPerSecond / 30;
  rt::TimeNs capture = h.now;
  for (int i = 0; i < 900; ++i, capture += period) {
    if (i % 7 == 3) continue;
    const rt::TimeNs arrival = capture + 5 * kMs + (i % 7 == 4 ? 12 : i * 37 % 23) * kMs;
    while (h.now < arrival) h.step();
    h.poses.write(good_pose(capture));
    h.step();
  }
  h.decode_sent();
  for (const auto& [t, s] : h.statuses) EXPECT_EQ(s.health, 0) << rt::to_ms(t);
  for (const auto& [t, m] : h.odometry) EXPECT_GT(m.quality, 0);
}

// A busy machine: the picture came, its pose takes its time.
TEST(LinkNode, APoseThatIsALittleLateIsNoError) {
  LinkHarness h;
  h.run(1);
  h.camera = false;
  h.decode_sent();
  const std::size_t before = h.odometry.size();
  const rt::TimeNs last = h.t_last_pose;
  h.run(0.03);
  h.link->frame_begun(h.now);
  const rt::TimeNs capture = h.now - 5 * kMs;
  while (h.now < last + 160 * kMs) {
    h.step();
    EXPECT_EQ(h.link->status().condition.health, dronecan::NodeHealth::kOk) << rt::to_ms(h.now - last);
  }
  h.poses.write(good_pose(capture));
  h.step();
  h.decode_sent();
  ASSERT_GT(h.odometry.size(), before);
  for (std::size_t i = before; i < h.odometry.size(); ++i) EXPECT_GT(h.odometry[i].second.quality, 0);
  // One that hangs is one all the same.
  h.link->frame_begun(h.now + 30 * kMs);
  h.run(0.2);
  EXPECT_EQ(h.link->status().condition.health, dronecan::NodeHealth::kError);
}

TEST(LinkNode, TimesOnlyGrowWhateverComesLate) {
  LinkHarness h;
  h.run(1);
  h.camera = false;
  for (const int late_ms : {90, 130, 200, 400}) {
    const rt::TimeNs capture = h.now;
    h.run(late_ms * 1e-3);
    h.poses.write(good_pose(capture));
    h.run(0.05);
  }
  h.decode_sent();
  std::uint64_t newest = 0;
  int good = 0;
  for (const auto& [t, m] : h.odometry) {
    EXPECT_GT(m.time_usec, newest);
    newest = m.time_usec;
    good += m.quality > 0 ? 1 : 0;
  }
  EXPECT_GE(good, 32) << "those of 90, 130 and 200 ms were sent, too";
}

TEST(LinkNode, TellsWhenSilenceIsDue) {
  LinkHarness h;
  h.run(1);
  const rt::TimeNs due = h.link->t_silence_ns();
  EXPECT_EQ(due, h.t_last_pose + 80 * kMs);
  h.now = due - 1;
  h.link->step(h.now);
  EXPECT_EQ(h.link->status().condition.health, dronecan::NodeHealth::kOk);
  h.link->step(due);
  EXPECT_EQ(h.link->status().condition.health, dronecan::NodeHealth::kError);
}

// What becomes worse is told at once, what becomes better 20 ms later: a hundred a second at most.
TEST(LinkNode, FlickeringHealthDoesNotFillTheBus) {
  LinkHarness h;
  h.run(2);
  h.decode_sent();
  const std::size_t before = h.statuses.size();
  for (int i = 0; i < 1000; ++i) {
    SystemHealth bad;
    bad.process_ok = i % 2 == 0;
    h.health.write(bad);
    h.run(0.001);
  }
  h.decode_sent();
  EXPECT_LE(h.statuses.size() - before, 101U);
  EXPECT_GE(h.statuses.size() - before, 40U);
}

TEST(LinkNode, FailedCameraImuOrProcessIsAnErrorAtOnce) {
  for (const int which : {0, 1, 2}) {
    LinkConfig config;
    config.imu_required = true;
    LinkHarness h(config);
    h.run(1.5);
    SystemHealth bad;
    bad.camera_ok = which != 0;
    bad.imu_ok = which != 1;
    bad.process_ok = which != 2;
    h.health.write(bad);
    const rt::TimeNs t = h.now;
    h.run(0.2);
    h.decode_sent();
    EXPECT_EQ(h.statuses.back().second.health, 2);
    const auto error =
        std::find_if(h.statuses.begin(), h.statuses.end(), [](const auto& s) { return s.second.health == 2; });
    EXPECT_LE(error->first - t, 100 * kMs);
  }
}

// A driver gives a picture twice, or for as long as the odometry's state stands: neither a word to the autopilot nor an
// error of the node; a camera that is frozen for longer is told by a sample without a pose.
TEST(LinkNode, ARepeatedPictureIsNeitherALossNorASilence) {
  LinkHarness h;
  h.run(2);
  h.camera = false;
  h.decode_sent();
  const std::size_t statuses = h.statuses.size(), odometry = h.odometry.size();
  const rt::TimeNs last = h.t_last_pose;
  for (const int ms : {33, 67, 100, 133}) {
    while (h.now < last + ms * kMs) h.step();
    h.link->frame_begun(h.now);
    h.step();
    h.link->picture_repeated(h.now);
  }
  PoseSample next = good_pose(h.now + 28 * kMs);
  while (h.now < next.t_capture_ns + 5 * kMs) h.step();
  h.poses.write(next);
  h.step();
  h.decode_sent();
  for (std::size_t i = statuses; i < h.statuses.size(); ++i) {
    EXPECT_EQ(h.statuses[i].second.health, 0);
    EXPECT_EQ(h.statuses[i].second.vendor_code & (kNoPose | kPoseStalled), 0);
  }
  for (std::size_t i = odometry; i < h.odometry.size(); ++i) EXPECT_GT(h.odometry[i].second.quality, 0);
  EXPECT_GT(h.odometry.size(), odometry);
  EXPECT_EQ(h.link->status().pictures_repeated, 4u);
  EXPECT_EQ(h.link->status().condition.health, dronecan::NodeHealth::kOk);
}

TEST(LinkNode, APoseWithoutVelocityIsNotFused) {
  LinkHarness h;
  h.make_pose = [](rt::TimeNs t) {
    PoseSample s = good_pose(t);
    s.has_velocity = false;
    return s;
  };
  h.run(1);
  h.decode_sent();
  ASSERT_FALSE(h.odometry.empty());
  for (const auto& [t, m] : h.odometry) EXPECT_EQ(m.quality, -1);
}

TEST(LinkNode, StaleRepeatedAndFuturePosesAreNotSent) {
  LinkHarness h;
  h.run(1);
  h.camera = false;
  const std::uint64_t sent = h.link->status().odometry_sent;
  const rt::TimeNs newest = h.next_frame - static_cast<rt::TimeNs>(1e9 / 30);
  h.run(0.03);
  h.poses.write(good_pose(newest));  // the same capture time again
  h.step();
  h.poses.write(good_pose(h.now + 20 * kMs));
  h.step();
  EXPECT_EQ(h.link->status().condition.reasons & kBadPose, kBadPose);
  EXPECT_EQ(h.link->status().odometry_sent, sent);
  h.now += 700 * kMs;
  h.poses.write(good_pose(h.now - 600 * kMs));
  h.run(0.2);
  h.decode_sent();
  EXPECT_EQ(h.odometry.back().second.quality, -1);
  EXPECT_GE(h.link->status().poses_stale, 3U);
}

TEST(LinkNode, NothingThatIsNotFiniteLeaves) {
  LinkHarness h;
  h.run(1);
  for (int field = 0; field < 7; ++field) {
    for (const double bad : {std::nan(""), std::numeric_limits<double>::infinity(), 1e9}) {
      PoseSample s = good_pose(h.now - 5 * kMs);
      if (field == 0) s.position[1] = bad;
      if (field == 1) s.orientation[2] = bad;
      if (field == 2) s.velocity[0] = bad;
      if (field == 3) s.angular_velocity[2] = bad;
      if (field == 4) s.covariance[14] = bad;
      if (field == 5) s.velocity_covariance[8] = bad;
      if (field == 6) s.covariance[1] = bad;
      h.camera = false;
      h.poses.write(s);
      h.now += 40 * kMs;
      h.step();
      h.decode_sent();
      const mavlink::Odometry& m = h.odometry.back().second;
      std::array<std::uint8_t, 300> bytes{};
      mavlink::detail::Writer writer(bytes);
      mavlink::Odometry::visit(writer, m);
      for (std::size_t at = 8; at < 228; at += 4) {
        float value = 0;
        std::memcpy(&value, bytes.data() + at, 4);
        ASSERT_TRUE(std::isfinite(value)) << "field " << field << " offset " << at;
      }
      if (std::isnan(bad) || std::isinf(bad) || field < 4) {
        EXPECT_EQ(m.quality, -1) << field << " " << bad;
        EXPECT_EQ(h.link->status().condition.health, dronecan::NodeHealth::kError);
      }
    }
  }
}

}  // namespace link_failure_test
}  // namespace godwit::link
