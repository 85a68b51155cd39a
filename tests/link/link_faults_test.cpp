// A bad bus.
#include <gtest/gtest.h>
#include <random>

#include "firmware_app/link/link_node.h"
#include "tests/link/fake_bus.h"

namespace godwit::link {
namespace link_faults_test {

constexpr rt::TimeNs kMs = rt::kNsPerMs;

// One fault in each transfer of the autopilot's, of which the tunnel's have ten frames.
struct Fault {
  const char* name;
  void (*harm)(std::vector<hal::CanFrame>* frames);
  std::uint64_t dronecan::ReassemblyCounters::*counter;
  bool delivered;  ///< the transfer comes through all the same
};

std::uint8_t& tail_of(hal::CanFrame& frame) {
  return frame.data[frame.length - 1U];
}

class EachFault : public ::testing::TestWithParam<Fault> {
 protected:
  // A message every 10 ms; returns how many came through, none with a wrong value.
  int fly(LinkHarness& h, int messages, bool harmed) {
    int good = 0;
    for (int i = 0; i < messages; ++i) {
      const std::size_t before = h.bus.inbox.size();
      mavlink::AttitudeQuaternion attitude;
      attitude.q1 = 0.6F;
      attitude.q3 = 0.8F;
      attitude.rollspeed = attitude.pitchspeed = attitude.yawspeed = 0.25F;  // so that its end is not cut off as zeros
      h.send_mavlink(attitude);
      if (harmed) {
        std::vector<hal::CanFrame> frames(h.bus.inbox.begin() + static_cast<std::ptrdiff_t>(before), h.bus.inbox.end());
        EXPECT_GE(frames.size(), 6U);
        GetParam().harm(&frames);
        h.bus.inbox.resize(before);
        h.bus.inbox.insert(h.bus.inbox.end(), frames.begin(), frames.end());
      }
      h.run(0.01);
      AutopilotInput input;
      while (h.inputs.try_pop(&input)) {
        EXPECT_EQ(input.kind, InputKind::kAttitude);
        EXPECT_FLOAT_EQ(static_cast<float>(input.value[0]), 0.6F);
        EXPECT_FLOAT_EQ(static_cast<float>(input.value[2]), 0.8F);
        ++good;
      }
    }
    return good;
  }
};

TEST_P(EachFault, NothingWrongComesThroughTheCounterTellsAndAllIsWellAtOnce) {
  LinkHarness h;
  h.heartbeat(false);
  h.run(0.1);
  ASSERT_EQ(fly(h, 100, false), 100);
  const dronecan::ReassemblyCounters before = h.link->status().reception;
  const std::uint64_t sent = h.link->status().odometry_sent;
  const int through = fly(h, 200, true);
  const dronecan::ReassemblyCounters after = h.link->status().reception;
  EXPECT_GE(after.*GetParam().counter - before.*GetParam().counter, 190U);
  if (GetParam().delivered) {
    EXPECT_EQ(through, 200);
    EXPECT_EQ(after.errors(), before.errors());
  } else {
    EXPECT_LE(through, 1);
  }
  EXPECT_NEAR(static_cast<double>(h.link->status().odometry_sent - sent), 60, 2) << "poses go on meanwhile";
  // The first clean transfer may be taken for the rest of a harmed one; a second has a hundred.
  EXPECT_GE(fly(h, 100, false), 98);
  EXPECT_EQ(h.link->parameters().values(), fallback_values());
}

using Frames = std::vector<hal::CanFrame>;
using Counters = dronecan::ReassemblyCounters;
INSTANTIATE_TEST_SUITE_P(
    Bus, EachFault,
    ::testing::Values(
        Fault{"first_lost", [](Frames* f) { f->erase(f->begin()); }, &Counters::missed_start, false},
        Fault{"middle_lost", [](Frames* f) { f->erase(f->begin() + 2); }, &Counters::wrong_toggle, false},
        Fault{"last_lost", [](Frames* f) { f->pop_back(); }, &Counters::aborted, false},
        Fault{"frames_repeated",
              [](Frames* f) {
                Frames twice;
                for (const hal::CanFrame& frame : *f) twice.insert(twice.end(), 2, frame);
                *f = twice;
              },
              &Counters::repeated, true},
        Fault{"transfer_repeated",
              [](Frames* f) {
                const Frames once = *f;
                f->insert(f->end(), once.begin(), once.end());
              },
              &Counters::repeated, true},
        Fault{"reordered", [](Frames* f) { std::swap((*f)[2], (*f)[3]); }, &Counters::wrong_toggle, false},
        Fault{"wrong_toggle", [](Frames* f) { tail_of((*f)[3]) ^= 0x20; }, &Counters::wrong_toggle, false},
        Fault{"bad_crc", [](Frames* f) { (*f)[4].data[3] ^= 0x10; }, &Counters::bad_crc, false},
        Fault{"id_changes_within", [](Frames* f) { tail_of((*f)[3]) ^= 0x07; }, &Counters::wrong_transfer_id, false},
        Fault{"cut_short", [](Frames* f) { (*f)[2].length = 5; }, &Counters::malformed, false}),
    [](const auto& one) { return std::string(one.param.name); });

// The same transfer again and again, as a sender that hangs repeats it.
TEST(LinkFaults, AStaleTransferIdIsTakenOnce) {
  LinkHarness h;
  h.heartbeat(false);
  h.run(0.1);
  const std::uint64_t before = h.link->endpoint().counters().inputs;
  for (int i = 0; i < 150; ++i) {
    h.tunnel_id = 9;
    h.sender.sequence = 1;
    mavlink::AttitudeQuaternion attitude;
    attitude.q1 = 1;
    h.send_mavlink(attitude);
    h.run(0.01);
  }
  EXPECT_EQ(h.link->endpoint().counters().inputs - before, 1U);
  EXPECT_GT(h.link->status().reception.repeated, 140U);
  for (int i = 0; i < 10; ++i) {
    mavlink::AttitudeQuaternion attitude;
    attitude.q1 = 1;
    h.send_mavlink(attitude);
    h.run(0.01);
  }
  EXPECT_EQ(h.link->endpoint().counters().inputs - before, 11U);
}

class Silenced : public ::testing::TestWithParam<hal::CanState> {};

TEST_P(Silenced, DropsWholeOldPosesAndRecoversAtOnce) {
  LinkHarness h;
  h.run(2);
  h.bus.state_now = GetParam();
  h.run(3);
  EXPECT_GT(h.link->status().tx.poses_replaced, 55U) << "counted once a second";
  EXPECT_EQ(h.link->status().condition.reasons & kBusTrouble, kBusTrouble);
  EXPECT_EQ(h.link->status().bus_state, GetParam());
  EXPECT_GT(h.link->status().bus.send_failed, 0U);
  h.bus.state_now = hal::CanState::kActive;
  const rt::TimeNs back = h.now;
  h.run(3);
  EXPECT_EQ(h.link->status().condition.reasons & kBusTrouble, 0);
  h.decode_sent();
  int after = 0;
  rt::TimeNs first = 0;
  for (const auto& [t, m] : h.odometry) {
    if (t < back) continue;
    if (after++ == 0) first = t;
    EXPECT_LE(t - static_cast<rt::TimeNs>(m.time_usec) * 1000, 250 * kMs) << "no old pose leaves";
  }
  EXPECT_GT(after, 85);
  EXPECT_LE(first - back, 40 * kMs);
  EXPECT_EQ(h.parser.counters().bad_crc, 0U) << "no half message";
}

INSTANTIATE_TEST_SUITE_P(BusIs, Silenced, ::testing::Values(hal::CanState::kBusOff, hal::CanState::kGone),
                         [](const auto& one) { return one.param == hal::CanState::kGone ? "gone" : "off"; });

TEST(LinkFaults, AnotherAutopilotsHeartbeatIsToldAndIgnored) {
  LinkHarness h;
  h.heartbeat(true);
  h.run(0.1);
  EXPECT_TRUE(h.link->status().armed);
  // A vehicle next door on the same line, disarmed; then one of ours that is no autopilot's.
  for (const auto& [system, component] : {std::pair<std::uint8_t, std::uint8_t>{9, 1}, {7, 25}}) {
    h.sender = {system, component, 0};
    h.heartbeat(false);
    h.run(0.1);
    EXPECT_TRUE(h.link->status().armed) << int(system);
  }
  EXPECT_EQ(h.link->status().mavlink.foreign_heartbeats, 2u);
  dronecan::RestartNodeRequest restart;
  restart.magic = dronecan::RestartNodeRequest::kMagic;
  h.request(restart);
  h.run(0.5);
  h.decode_sent();
  ASSERT_EQ(h.restarts.size(), 1u);
  EXPECT_FALSE(h.restarts[0].second.ok) << "in flight";
}

TEST(LinkFaults, WhoMayNotWriteChangesNothing) {
  for (const bool locked : {false, true}) {
    LinkConfig config;
    config.write_rules.locked = locked;
    config.write_rules.only_nodes = {100};
    LinkHarness h(config);
    h.run(0.1);
    dronecan::GetSetRequest set;
    dronecan::assign(&set.name, "VIO_RATE");
    set.value.tag = dronecan::Value::kInteger;
    set.value.integer = 25;
    h.request(set);  // by node 10
    dronecan::RestartNodeRequest restart;
    restart.magic = dronecan::RestartNodeRequest::kMagic;
    h.request(restart);
    dronecan::ExecuteOpcodeRequest save;
    save.opcode = dronecan::ExecuteOpcodeRequest::kSave;
    h.request(save);
    h.run(0.5);
    h.decode_sent();
    EXPECT_EQ(h.link->parameters().get(Parameter::kRate), 30);
    EXPECT_EQ(h.link->node().counters().refused_source, 3u);
    ASSERT_EQ(h.restarts.size(), 1u);
    EXPECT_FALSE(h.restarts[0].second.ok);
    h.send(set, {.priority = 24, .source = 100, .destination = kTestNode, .transfer_id = 9, .payload = {}});
    h.run(0.1);
    EXPECT_EQ(h.link->parameters().get(Parameter::kRate), locked ? 30 : 25);
  }
}

TEST(LinkFaults, AnotherNodeUnderOurIdIsAnError) {
  LinkHarness h;
  h.run(1);
  h.send(dronecan::NodeStatus{}, {.source = 43, .payload = {}});
  h.run(0.1);
  EXPECT_EQ(h.link->status().condition.health, dronecan::NodeHealth::kOk) << "any other";
  h.send(dronecan::NodeStatus{}, {.source = kTestNode, .payload = {}});
  h.run(0.1);
  EXPECT_EQ(h.link->status().condition.health, dronecan::NodeHealth::kError);
  EXPECT_EQ(h.link->status().condition.reasons & kSameNodeId, kSameNodeId);
  h.run(3.5);
  EXPECT_EQ(h.link->status().condition.health, dronecan::NodeHealth::kOk) << "it has gone";
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

}  // namespace link_faults_test
}  // namespace godwit::link
