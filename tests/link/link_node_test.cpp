#include "firmware_app/link/link_node.h"

#include <cmath>
#include <gtest/gtest.h>
#include <random>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"
#include "tests/link/fake_bus.h"

namespace godwit::link {
namespace link_node_test {

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

TEST(LinkNode, BusLoadStaysBelowAQuarter) {
  LinkHarness h;
  h.run(5);
  EXPECT_LT(h.link->status().bus_load_percent, 25);
  EXPECT_GT(h.link->status().bus_load_percent, 15);
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

TEST(LinkNode, GetNodeInfoTellsVersionAndCommit) {
  for (const std::uint32_t commit : {0x5cbb52e0u, 0u}) {
    LinkConfig config;
    config.identity.software_major = 3;
    config.identity.software_minor = 14;
    config.identity.vcs_commit = commit;
    LinkHarness h(config);
    h.run(0.1);
    h.request(dronecan::GetNodeInfoRequest{});
    h.run(0.1);
    h.decode_sent();
    ASSERT_EQ(h.infos.size(), 1U);
    const dronecan::SoftwareVersion& software = h.infos[0].second.software;
    EXPECT_EQ(software.major, 3);
    EXPECT_EQ(software.minor, 14);
    EXPECT_EQ(software.vcs_commit, commit);
    EXPECT_EQ(software.flags, commit != 0 ? dronecan::SoftwareVersion::kHasVcsCommit : 0) << "unknown is said as such";
  }
}

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

}  // namespace link_node_test
}  // namespace godwit::link
