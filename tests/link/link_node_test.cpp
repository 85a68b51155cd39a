#include "firmware_app/link/link_node.h"

#include <cmath>
#include <cstring>
#include <gtest/gtest.h>
#include <limits>
#include <random>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/link/fake_bus.h"

namespace godwit::link {
namespace {

constexpr rt::TimeNs kMs = rt::kNsPerMs;

TEST(LinkNode, RefusesContradictions) {
  Storage storage("");
  rt::TripleBuffer<PoseSample> poses;
  rt::TripleBuffer<SystemHealth> health;
  FakeBus bus;
  LinkPorts ports{&bus, nullptr, &storage, &poses, &health, nullptr, nullptr};
  LinkConfig config;
  EXPECT_TRUE(LinkNode::create(config, ports, {}).ok());
  EXPECT_FALSE(
      LinkNode::create(config, LinkPorts{nullptr, nullptr, &storage, &poses, &health, nullptr, nullptr}, {}).ok());
  config.odometry.R_body_cam.row(0) *= -1;
  auto mirrored = LinkNode::create(config, ports, {});
  ASSERT_FALSE(mirrored.ok());
  EXPECT_NE(mirrored.error().message.find("T_body_cam"), std::string::npos);
  config = {};
  config.parameters[static_cast<std::size_t>(Parameter::kProfile)] = 1;
  EXPECT_FALSE(LinkNode::create(config, ports, {}).ok()) << "PX4 has no tunnel";
  config = {};
  config.parameters[static_cast<std::size_t>(Parameter::kCanFd)] = 1;
  bus.fd = false;
  EXPECT_FALSE(LinkNode::create(config, ports, {}).ok());
}

TEST(LinkNode, OdometryAtTheCameraRate) {
  for (const auto& [camera, expected] :
       {std::pair{20.0, 20.0}, {29.97, 29.97}, {30.0, 30.0}, {30.3, 30.3}, {60.0, 30.0}, {90.0, 30.0}}) {
    LinkHarness h;
    h.camera_hz = camera;
    h.run(10);
    h.decode_sent();
    ASSERT_GT(h.odometry.size(), 2U);
    const double span = rt::to_seconds(h.odometry.back().first - h.odometry.front().first);
    const double rate = static_cast<double>(h.odometry.size() - 1) / span;
    EXPECT_NEAR(rate, expected, 0.4) << camera;
    for (std::size_t i = 1; i < h.odometry.size(); ++i) {
      EXPECT_GE(h.odometry[i].first - h.odometry[i - 1].first, 20 * kMs) << camera;
      EXPECT_LE(h.odometry[i].first - h.odometry[i - 1].first, 70 * kMs) << camera;
    }
  }
}

// A busy computer: each pose comes up to 25 ms late, so that some come a few milliseconds after the one before.
TEST(LinkNode, BunchedPosesLeaveFarEnoughApartAndHardlyOneIsLost) {
  LinkHarness h;
  h.camera = false;
  const rt::TimeNs period = rt::kNsPerSecond / 30;
  rt::TimeNs capture = h.now;
  for (int i = 0; i < 300; ++i, capture += period) {
    const rt::TimeNs arrival = capture + 5 * kMs + (i * 37 % 26) * kMs;
    while (h.now < arrival) h.step();
    h.poses.write(good_pose(capture));
    h.step();
  }
  h.run(0.03);
  h.decode_sent();
  EXPECT_GE(h.odometry.size(), 290U);
  for (std::size_t i = 1; i < h.odometry.size(); ++i) {
    EXPECT_GE(h.odometry[i].first - h.odometry[i - 1].first, 21 * kMs);
    EXPECT_GT(h.odometry[i].second.time_usec, h.odometry[i - 1].second.time_usec);
  }
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

TEST(LinkNode, OwnTimeRunsFromTheGivenPoseToItsLastFrame) {
  static rt::TimeNs clock_now = 0;
  LinkConfig config;
  config.clock = [] { return clock_now; };
  LinkHarness h(config);
  h.camera = false;
  for (int i = 0; i < 90; ++i) {
    PoseSample s = good_pose(h.now);
    s.t_published_ns = h.now;
    h.poses.write(s);
    clock_now = h.now + 700'000;  // when the last frame was handed over
    for (int k = 0; k < 33; ++k) h.step();
  }
  EXPECT_NEAR(h.link->status().own_p50_ms, 0.7, 1e-3);
  EXPECT_NEAR(h.link->status().own_p99_ms, 0.7, 1e-3);
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

TEST(LinkNode, PoseLeavesInTheStepThatTakesIt) {
  LinkHarness h;
  h.run(1);
  h.poses.write(good_pose(h.now - 5 * kMs));
  h.camera = false;
  h.now += 40 * kMs;
  const rt::TimeNs t = h.now;
  h.step();
  h.decode_sent();
  EXPECT_EQ(h.odometry.back().first, t);
}

TEST(LinkNode, BusLoadStaysBelowAQuarter) {
  LinkHarness h;
  h.run(5);
  EXPECT_LT(h.link->status().bus_load_percent, 25);
  EXPECT_GT(h.link->status().bus_load_percent, 15);
}

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
      EXPECT_EQ(m.x, 0);
      EXPECT_EQ(m.q[0], 1);
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
  EXPECT_LE(error->first - last, 100 * kMs);
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

TEST(LinkNode, ResetsAndMapsRaiseTheCounterAndARestartGoesOn) {
  StoredState stored;
  stored.reset_counter = 250;
  LinkHarness h({}, "", stored);
  h.run(0.5);
  h.make_pose = [](rt::TimeNs t) {
    PoseSample s = good_pose(t);
    s.reset_counter = 3;
    return s;
  };
  h.run(0.5);
  h.make_pose = [](rt::TimeNs t) {
    PoseSample s = good_pose(t);
    s.reset_counter = 3;
    s.map_id = 2;
    return s;
  };
  h.run(0.5);
  h.decode_sent();
  EXPECT_EQ(h.odometry.front().second.reset_counter, 250);
  EXPECT_EQ(h.odometry[20].second.reset_counter, 253);
  EXPECT_EQ(h.odometry.back().second.reset_counter, 254);
}

// ---- what must not happen in flight ---------------------------------------------------------------------------------

struct ArmedBy {
  bool heartbeat;
};

class Armed : public ::testing::TestWithParam<ArmedBy> {
 protected:
  void arm(LinkHarness& h, bool armed) {
    if (GetParam().heartbeat) {
      h.heartbeat(armed);
    } else {
      dronecan::ArmingStatus status;
      status.status = armed ? 255 : 0;
      h.send(status, {.source = kTestAutopilot, .transfer_id = transfer_id++, .payload = {}});
    }
    h.run(0.01);
  }
  static void ask(LinkHarness& h) {
    dronecan::GetSetRequest set;
    assign(&set.name, "VIO_RATE");
    set.value.tag = dronecan::Value::kInteger;
    set.value.integer = 22;
    h.request(set);
    h.request(dronecan::ExecuteOpcodeRequest{1, 0});
    dronecan::RestartNodeRequest restart;
    restart.magic = dronecan::RestartNodeRequest::kMagic;
    h.request(restart);
    h.run(0.6);
    h.decode_sent();
  }
  std::uint8_t transfer_id = 0;
};

TEST_P(Armed, RefusesRestartEraseAndWrites) {
  LinkHarness h;
  h.run(0.5);
  arm(h, true);
  ask(h);
  ASSERT_EQ(h.get_sets.size(), 1U);
  EXPECT_EQ(h.get_sets[0].second.value.integer, 30);
  ASSERT_EQ(h.opcodes.size(), 1U);
  EXPECT_FALSE(h.opcodes[0].second.ok);
  ASSERT_EQ(h.restarts.size(), 1U);
  EXPECT_FALSE(h.restarts[0].second.ok);
  EXPECT_FALSE(h.link->restart_due());
  EXPECT_EQ(h.link->node().counters().refused_armed, 3U);
  h.run(30);  // the autopilot falls silent: it may still be flying
  ask(h);
  EXPECT_FALSE(h.link->restart_due());
  arm(h, false);
  ask(h);
  EXPECT_EQ(h.get_sets.back().second.value.integer, 22);
  EXPECT_TRUE(h.restarts.back().second.ok);
  EXPECT_TRUE(h.link->restart_due());
}

INSTANTIATE_TEST_SUITE_P(By, Armed, ::testing::Values(ArmedBy{false}, ArmedBy{true}));

TEST(LinkNode, NothingOnTheBusSetsAParameterOutsideItsLimits) {
  LinkHarness h;
  std::mt19937_64 random(3);
  h.run(0.1);
  for (int i = 0; i < 3000; ++i) {
    dronecan::GetSetRequest set;
    set.index = static_cast<std::uint16_t>(random() % (kParameters + 2));
    set.value.tag = static_cast<std::uint8_t>(random() % dronecan::Value::kTags);
    set.value.integer =
        random() % 4 == 0 ? static_cast<std::int64_t>(random()) : static_cast<std::int64_t>(random() % 2000) - 500;
    set.value.real =
        random() % 4 == 0 ? std::nanf("") : static_cast<float>(set.value.integer) * (random() % 2 ? 1.0F : 0.37F);
    set.value.boolean = static_cast<std::uint8_t>(random());
    h.request(set);
    h.step();
    h.decode_sent();
  }
  EXPECT_GT(h.link->node().counters().refused_value, 500U);
  for (const auto& [t, r] : h.get_sets) {
    if (r.value.tag == dronecan::Value::kInteger) {
      EXPECT_GE(r.value.integer, r.min_value.integer);
      EXPECT_LE(r.value.integer, r.max_value.integer);
    } else if (r.value.tag == dronecan::Value::kBoolean) {
      EXPECT_LE(r.value.boolean, 1);
    } else {
      EXPECT_EQ(r.name.size, 0U);
    }
  }
}

// ---- a bad bus ------------------------------------------------------------------------------------------------------

TEST(LinkFaults, BusOffDropsWholeOldPosesAndRecoversAtOnce) {
  LinkHarness h;
  h.run(2);
  h.bus.state_now = hal::CanState::kBusOff;
  h.run(3);
  EXPECT_GT(h.link->status().tx.poses_replaced, 55U) << "counted once a second";
  EXPECT_EQ(h.link->status().condition.reasons & kBusTrouble, kBusTrouble);
  h.bus.state_now = hal::CanState::kActive;
  const rt::TimeNs back = h.now;
  h.run(1);
  h.decode_sent();
  int after = 0;
  for (const auto& [t, m] : h.odometry) {
    if (t < back) continue;
    ++after;
    EXPECT_LE(t - static_cast<rt::TimeNs>(m.time_usec) * 1000, 250 * kMs) << "no old pose leaves";
  }
  EXPECT_GT(after, 25);
  EXPECT_EQ(h.parser.counters().bad_crc, 0U) << "no half message";
}

TEST(LinkFaults, AFullQueueDropsWholePosesNeverBytes) {
  LinkHarness h;
  h.run(1);
  std::mt19937 random(5);
  const rt::TimeNs begin = h.now;
  for (int i = 0; i < 5000; ++i) {
    h.bus.budget = random() % 2;  // about half a frame a millisecond: less than half of what poses need
    if (h.now >= h.next_frame + 5 * kMs) {
      h.poses.write(good_pose(h.next_frame));
      h.next_frame += static_cast<rt::TimeNs>(1e9 / 30);
    }
    h.step();
  }
  h.bus.budget = SIZE_MAX;
  h.run(0.5);
  h.decode_sent();
  EXPECT_GT(h.link->status().tx.poses_replaced, 50U);
  EXPECT_GT(h.odometry.size(), 35U) << "the newest still leave";
  EXPECT_EQ(h.parser.counters().bad_crc, 0U);
  EXPECT_EQ(h.parser.counters().skipped_bytes, 0U);
  EXPECT_EQ(h.decoder->counters().errors(), 0U);
  rt::TimeNs status_before = begin;
  for (const auto& [t, s] : h.statuses) {
    if (t < begin) continue;
    EXPECT_LE(t - status_before, 1400 * kMs) << "the node stays alive meanwhile";
    status_before = t;
  }
}

TEST(LinkFaults, AFloodOfQuestionsDoesNotDelayPoses) {
  LinkHarness h;
  h.run(1);
  std::mt19937 random(9);
  for (int i = 0; i < 3000; ++i) {
    for (int k = 0; k < 5; ++k) {
      h.send(dronecan::GetNodeInfoRequest{}, {.priority = 24,
                                              .source = static_cast<std::uint8_t>(1 + random() % 125),
                                              .destination = kTestNode,
                                              .transfer_id = static_cast<std::uint8_t>(random() % 32),
                                              .payload = {}});
    }
    h.bus.budget = 8;  // a bus at 1 Mbit/s takes about eight frames a millisecond
    if (h.now >= h.next_frame + 5 * kMs) {
      h.poses.write(good_pose(h.next_frame));
      h.next_frame += static_cast<rt::TimeNs>(1e9 / 30);
    }
    h.step();
  }
  h.decode_sent();
  EXPECT_NEAR(static_cast<double>(h.odometry.size()), 4 * 30, 5);
  for (const auto& [t, m] : h.odometry) EXPECT_LE(t - static_cast<rt::TimeNs>(m.time_usec) * 1000, 25 * kMs);
  EXPECT_GT(h.link->status().tx.refused, 1000U);
}

TEST(LinkFaults, DamagedFramesChangeNothingAndTheLinkRecovers) {
  LinkHarness h;
  h.run(1);
  std::mt19937 random(11);
  for (int i = 0; i < 4000; ++i) {
    const std::size_t before = h.bus.inbox.size();
    h.heartbeat(false);
    mavlink::AttitudeQuaternion attitude;
    attitude.q1 = 1;
    h.send_mavlink(attitude);
    for (std::size_t k = before; k < h.bus.inbox.size(); ++k) {
      hal::CanFrame& f = h.bus.inbox[k];
      switch (random() % 20) {
        case 0:
          f.data[random() % 8] ^= static_cast<std::uint8_t>(1U << (random() % 8));
          break;  // bad CRC, toggle, id
        case 1:
          f.length = static_cast<std::uint8_t>(random() % 9);
          break;
        case 2:
          std::swap(f, h.bus.inbox[before + random() % (h.bus.inbox.size() - before)]);
          break;
        case 3:
          f.id ^= 1U << (random() % 29);
          break;
        case 4:
          f.extended = false;
          break;
        default:
          break;
      }
    }
    h.step();
  }
  EXPECT_GT(h.link->status().reception.errors(), 500U);
  AutopilotInput input;
  int taken = 0;
  while (h.inputs.try_pop(&input)) {
    if (input.kind != InputKind::kAttitude) continue;
    ++taken;
    EXPECT_EQ(input.value[0], 1);
  }
  EXPECT_GT(taken, 100);
  const std::uint64_t before = h.link->endpoint().counters().inputs;
  for (int i = 0; i < 100; ++i) {
    h.heartbeat(false);
    mavlink::AttitudeQuaternion attitude;
    attitude.q1 = 1;
    h.send_mavlink(attitude);
    h.run(0.01);
    while (h.inputs.try_pop(&input)) {
    }
  }
  EXPECT_GE(h.link->endpoint().counters().inputs - before, 99U) << "within a second all is well again";
}

// ---- time -----------------------------------------------------------------------------------------------------------

TEST(LinkLatency, TimesyncBothWaysAndTheDelayToSet) {
  LinkHarness h;
  const rt::TimeNs autopilot_ahead = 77 * rt::kNsPerSecond, one_way = 3 * kMs;
  std::vector<std::pair<rt::TimeNs, mavlink::Timesync>> flying;
  std::size_t seen = 0;
  for (int i = 0; i < 20000; ++i) {
    if (i % 1000 == 0) h.heartbeat(false);
    h.run(0.001);
    h.decode_sent();
    for (; seen < h.timesyncs.size(); ++seen) {
      mavlink::Timesync answer = h.timesyncs[seen].second;
      answer.tc1 = h.timesyncs[seen].first + one_way + autopilot_ahead;
      flying.emplace_back(h.timesyncs[seen].first + 2 * one_way, answer);
    }
    while (!flying.empty() && flying.front().first <= h.now) {
      h.send_mavlink(flying.front().second);
      flying.erase(flying.begin());
    }
  }
  const TimeSync& sync = h.link->endpoint().time_sync();
  EXPECT_TRUE(sync.synchronised(h.now));
  EXPECT_NEAR(rt::to_ms(sync.offset_ns() - autopilot_ahead), 0, 1.5);
  const LatencySummary& l = h.link->status().latency;
  // 5 ms of odometry, 3 ms of way, 40 frames at 1 Mbit/s beyond those of a TIMESYNC (about 5 ms).
  EXPECT_NEAR(l.p50_ms, 5 + 3 + 5, 1.6);
  EXPECT_NEAR(l.viso_delay_ms, l.min_ms - 2450.0 / 921.6, 0.51);
  EXPECT_FALSE(l.grew);
  EXPECT_EQ(h.link->status().condition.reasons & kNoTimesync, 0);
  mavlink::Timesync question;
  question.ts1 = 123456789;
  h.send_mavlink(question);
  const rt::TimeNs asked = h.now;
  h.run(0.01);
  h.decode_sent();
  const auto answer =
      std::find_if(h.timesyncs.begin(), h.timesyncs.end(), [](const auto& m) { return m.second.ts1 == 123456789; });
  ASSERT_NE(answer, h.timesyncs.end());
  EXPECT_EQ(answer->second.tc1, asked);
}

TEST(LinkLatency, GrowthIsTold) {
  LatencyMonitor monitor;
  LatencyPath path;
  for (int i = 0; i < 600; ++i) monitor.add(0, 20 * kMs, path);
  EXPECT_FALSE(monitor.summary().grew);
  for (int i = 0; i < 512; ++i) monitor.add(0, 28 * kMs, path);
  EXPECT_FALSE(monitor.summary().grew) << "8 ms may be";
  for (int i = 0; i < 512; ++i) monitor.add(0, 40 * kMs, path);
  EXPECT_TRUE(monitor.summary().grew);
}

TEST(LinkLatency, AnswersThatAnswerNothingAreRefused) {
  TimeSync sync;
  const auto question = sync.question(10 * kMs);
  EXPECT_TRUE(question.tc1 == 0 && question.ts1 == 10 * kMs);
  mavlink::Timesync answer = question;
  answer.tc1 = 99;
  answer.ts1 = 11 * kMs;
  EXPECT_FALSE(sync.take_answer(answer, 20 * kMs)) << "never asked";
  answer.ts1 = 10 * kMs;
  EXPECT_FALSE(sync.take_answer(answer, 2000 * kMs)) << "too late";
  EXPECT_TRUE(sync.take_answer(answer, 20 * kMs));
  EXPECT_FALSE(sync.take_answer(answer, 21 * kMs)) << "twice";
}

TEST(LinkNode, StepsDoNotAllocate) {
  LinkHarness h;
  h.serve_storage = false;
  h.run(1);
  std::vector<hal::CanFrame> noise;
  std::mt19937 random(13);
  const rt::HeapCounts before = rt::rt_heap_counts();
  for (int i = 0; i < 1000; ++i) {
    if (i % 33 == 0) h.poses.write(good_pose(h.now - 5 * kMs));
    if (i % 100 == 0) {  // made outside the scope below
      h.heartbeat(i % 200 == 0);
      dronecan::GetSetRequest get;
      get.index = static_cast<std::uint16_t>(random() % kParameters);
      h.request(get);
      h.request(dronecan::GetNodeInfoRequest{});
      h.request(dronecan::ExecuteOpcodeRequest{0, 0});
    }
    if (i == 500) h.bus.state_now = hal::CanState::kBusOff;
    if (i == 700) h.bus.state_now = hal::CanState::kActive;
    rt::RtScope scope;
    h.step();
  }
  const rt::HeapCounts after = rt::rt_heap_counts();
  EXPECT_EQ(after.allocations, before.allocations);
  EXPECT_EQ(after.frees, before.frees);
}

}  // namespace
}  // namespace godwit::link
