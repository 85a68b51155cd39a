// What of the bus becomes an aid, when it was measured, and what is refused with which reason.
#include "firmware_app/autopilot/bus_aids.h"

#include <Eigen/Geometry>
#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <memory>
#include <string>

#include "firmware_app/autopilot/aid_watch.h"
#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"

namespace godwit::app {
namespace bus_aids_test {

using link::AutopilotInput;
using link::InputKind;
constexpr rt::TimeNs kMs = rt::kNsPerMs;

class Bus {
 public:
  explicit Bus(const BusAidsOptions& options = {}) : aids(options, ring.get()) {}

  /// Comes at t, measured `age` before; 0: it does not say.
  AutopilotInput range(rt::TimeNs t_ns, rt::TimeNs age_ns, double distance_m) {
    AutopilotInput in;
    in.kind = InputKind::kRange;
    in.from_autopilot = true;
    in.source = 1;
    in.t_arrival_ns = t_ns;
    in.t_measured_ns = age_ns == 0 ? 0 : t_ns - age_ns;
    in.value = {distance_m, link::kLooksDown, 0.2, 40, 0, 0, 0};
    return in;
  }
  AutopilotInput pressure(rt::TimeNs t_ns, double pa) {
    AutopilotInput in = range(t_ns, 0, 0);
    in.kind = InputKind::kPressure;
    in.value = {pa, 0, 0, 0, 0, 0, 0};
    return in;
  }
  AutopilotInput fix(rt::TimeNs t_ns, double latitude, double longitude, double height, double type = 3,
                     double sigma = 1) {
    AutopilotInput in = range(t_ns, 0, 0);
    in.kind = InputKind::kSatellites;
    in.value = {latitude, longitude, height, type, sigma, sigma, 0};
    return in;
  }
  /// Body (front, right, down) to north, east, down by yaw, pitch and roll.
  AutopilotInput attitude(rt::TimeNs t_ns, double yaw, double pitch, double roll) {
    AutopilotInput in = range(t_ns, 10 * kMs, 0);
    in.kind = InputKind::kAttitude;
    const Eigen::Quaterniond q(Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()) *
                               Eigen::AngleAxisd(pitch, Eigen::Vector3d::UnitY()) *
                               Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitX()));
    in.value = {q.w(), q.x(), q.y(), q.z(), 0, 0, 0};
    return in;
  }
  /// The sample that comes of one message; false: none does.
  bool give(const AutopilotInput& in) {
    EXPECT_TRUE(ring->try_push(in));
    return aids.next_until(std::numeric_limits<rt::TimeNs>::max(), &sample);
  }
  std::string why(hal::AidKind kind) const { return aids.heard(kind).why; }

  std::unique_ptr<link::InputRing> ring = std::make_unique<link::InputRing>();
  BusAids aids;
  hal::AidSample sample;
};

TEST(BusAids, AMeasurementHasItsOwnTimeOrItsArrivalLessTheDelay) {
  Bus b;
  ASSERT_TRUE(b.give(b.range(1000 * kMs, 35 * kMs, 12.5)));
  EXPECT_EQ(b.sample.kind, hal::AidKind::kRange);
  EXPECT_EQ(b.sample.t_ns, 965 * kMs);
  EXPECT_EQ(b.sample.value[2], 12.5);
  EXPECT_NEAR(b.sample.sigma, 0.125, 1e-9);
  ASSERT_TRUE(b.give(b.range(1100 * kMs, 0, 12.5)));
  EXPECT_EQ(b.sample.t_ns, 1080 * kMs) << "nobody says when";
  // A clock that runs ahead by less than half a bad round trip.
  ASSERT_TRUE(b.give(b.range(1200 * kMs, -5 * kMs, 12.5)));
  EXPECT_EQ(b.sample.t_ns, 1200 * kMs);
}

TEST(BusAids, WhatIsStaleOrOfTheFutureOrTheSameAgainIsRefused) {
  Bus b;
  EXPECT_FALSE(b.give(b.range(9000 * kMs, 800 * kMs, 12.5)));
  EXPECT_EQ(b.why(hal::AidKind::kRange), "old on arrival [ms]");
  EXPECT_EQ(b.aids.heard(hal::AidKind::kRange).value, 800);
  EXPECT_FALSE(b.give(b.range(9100 * kMs, -800 * kMs, 12.5)));
  EXPECT_EQ(b.why(hal::AidKind::kRange), "measured in the future [ms]");
  EXPECT_TRUE(b.give(b.range(9200 * kMs, 10 * kMs, 12.5)));
  EXPECT_FALSE(b.give(b.range(9300 * kMs, 110 * kMs, 12.5)));
  EXPECT_EQ(b.why(hal::AidKind::kRange), "no newer than the one before");
  EXPECT_EQ(b.aids.heard(hal::AidKind::kRange).used, 1u);
  EXPECT_EQ(b.aids.heard(hal::AidKind::kRange).refused, 3u);
}

TEST(BusAids, TheTrackerGetsWhatWasMeasuredUpToItsPictureAndTheRestLater) {
  Bus b;
  for (int i = 0; i < 3; ++i) b.ring->try_push(b.range((1000 + 50 * i) * kMs, 10 * kMs, 10 + i));
  EXPECT_FALSE(b.aids.next_until(980 * kMs, &b.sample));
  ASSERT_TRUE(b.aids.next_until(1050 * kMs, &b.sample));
  EXPECT_EQ(b.sample.value[2], 10);
  ASSERT_TRUE(b.aids.next_until(1050 * kMs, &b.sample));
  EXPECT_EQ(b.sample.value[2], 11);
  EXPECT_FALSE(b.aids.next_until(1050 * kMs, &b.sample));
  ASSERT_TRUE(b.aids.next_until(1100 * kMs, &b.sample));
  EXPECT_EQ(b.sample.value[2], 12);
  EXPECT_FALSE(b.aids.next_until(9000 * kMs, &b.sample));
}

TEST(BusAids, NothingThatTheAutopilotMadeOfItsSensorsIsTaken) {
  Bus b;
  for (const InputKind kind : {InputKind::kLocalPosition, InputKind::kGlobalPosition, InputKind::kAttitude,
                               InputKind::kImu, InputKind::kArmed, InputKind::kBusTime}) {
    AutopilotInput in = b.fix(1000 * kMs, 47, 8, 400);
    in.kind = kind;
    EXPECT_FALSE(b.give(in)) << static_cast<int>(kind);
  }
  for (int i = 0; i < hal::kAidKinds; ++i) EXPECT_EQ(b.aids.heard(static_cast<hal::AidKind>(i)).t_heard_ns, 0);
}

TEST(BusAids, OfTheAutopilotsAttitudeOnlyTheVerticalIsTakenAndOnlyWhereNobodyElseTellsIt) {
  Config config;
  ASSERT_FALSE(config.imu.flown_by());
  Bus b(bus_aids_options(config));
  ASSERT_TRUE(b.give(b.attitude(1000 * kMs, 0, 0, 0)));
  EXPECT_EQ(b.sample.kind, hal::AidKind::kAttitude);
  EXPECT_EQ(b.sample.t_ns, 990 * kMs);
  EXPECT_EQ(b.sample.sigma, hal::kAttitudeSigmaRad);
  EXPECT_NEAR(b.sample.value[2], -1, 1e-12) << "level: up is against the body's down";
  rt::TimeNs t_ns = 1000 * kMs;
  for (const double yaw : {0.0, 1.0, -2.5}) {
    // Nose up: up leans to the front. Right side down: up leans to the left.
    ASSERT_TRUE(b.give(b.attitude(t_ns += 100 * kMs, yaw, 0.3, 0)));
    EXPECT_NEAR(b.sample.value[0], std::sin(0.3), 1e-12) << "whatever the heading, which may be ours";
    EXPECT_NEAR(b.sample.value[2], -std::cos(0.3), 1e-12);
    ASSERT_TRUE(b.give(b.attitude(t_ns += 100 * kMs, yaw, 0, 0.2)));
    EXPECT_NEAR(b.sample.value[1], -std::sin(0.2), 1e-12);
  }
  AutopilotInput stretched = b.attitude(5000 * kMs, 0, 0, 0);
  stretched.value[0] = 1.04;
  EXPECT_FALSE(b.give(stretched));
  EXPECT_EQ(b.why(hal::AidKind::kAttitude), "no attitude: its quaternion has the length");
  AutopilotInput old = b.attitude(6000 * kMs, 0, 0, 0);
  old.t_measured_ns = 5000 * kMs;
  EXPECT_FALSE(b.give(old));
  EXPECT_EQ(b.why(hal::AidKind::kAttitude), "old on arrival [ms]");

  config.imu.source = Config::Imu::Source::kReplay;
  config.imu.enabled = true;
  Bus with_imu(bus_aids_options(config));
  EXPECT_FALSE(with_imu.give(with_imu.attitude(1000 * kMs, 0, 0, 0)));
  config = {};
  config.aids.attitude = false;
  Bus off(bus_aids_options(config));
  EXPECT_FALSE(off.give(off.attitude(1000 * kMs, 0, 0, 0)));
}

TEST(BusAids, OneOfAKindIsUsedUntilItFallsSilent) {
  Bus b;
  ASSERT_TRUE(b.give(b.range(1000 * kMs, 0, 12)));
  AutopilotInput other = b.range(1500 * kMs, 0, 3);
  other.from_autopilot = false;
  other.source = 125;
  EXPECT_FALSE(b.give(other));
  EXPECT_EQ(b.why(hal::AidKind::kRange), "another source of the same is used");
  EXPECT_TRUE(b.give(b.pressure(1500 * kMs, 95000))) << "another kind";
  other.t_arrival_ns = 4100 * kMs;
  EXPECT_TRUE(b.give(other));
  EXPECT_FALSE(b.give(b.range(4200 * kMs, 0, 12)));
  EXPECT_EQ(b.aids.heard(hal::AidKind::kRange).source, 125);
}

TEST(BusAids, ARangefinderMustLookDown) {
  BusAidsOptions options;
  Bus b(options);
  AutopilotInput in = b.range(1000 * kMs, 0, 12);
  in.value[1] = 0;
  EXPECT_FALSE(b.give(in));
  EXPECT_EQ(b.why(hal::AidKind::kRange), "a range sensor that looks elsewhere than down: id");
  in.from_autopilot = false;
  in.sensor = 3;
  in.value[1] = link::kLooksUnknown;
  EXPECT_FALSE(b.give(in));
  EXPECT_EQ(b.why(hal::AidKind::kRange), "a range sensor that does not say where it looks (aids.range_sensor): id");
  EXPECT_EQ(b.aids.heard(hal::AidKind::kRange).value, 3);
  options.range_sensor = 3;
  Bus named(options);
  EXPECT_TRUE(named.give(in));
  in.sensor = 4;
  in.t_arrival_ns = 9000 * kMs;
  EXPECT_FALSE(named.give(in));
}

TEST(BusAids, PressureInAnotherUnitIsNoPressure) {
  Bus b;
  for (const double pa : {950.0, 95.0, 9.5e6, 0.0, -95000.0}) EXPECT_FALSE(b.give(b.pressure(1000 * kMs, pa))) << pa;
  EXPECT_EQ(b.why(hal::AidKind::kBarometer), "no air that flies has that pressure [Pa]");
  ASSERT_TRUE(b.give(b.pressure(2000 * kMs, 101325)));
  EXPECT_NEAR(b.sample.value[2], 0, 1e-6);
  ASSERT_TRUE(b.give(b.pressure(3000 * kMs, 89874.6)));
  EXPECT_NEAR(b.sample.value[2], 1000, 1);
}

TEST(BusAids, AFixIsAPlaceInAFrameOfItsOwnWhereItIsSureEnough) {
  Bus b;
  EXPECT_FALSE(b.give(b.fix(900 * kMs, 47, 8, 400, 2)));
  EXPECT_EQ(b.why(hal::AidKind::kSatellites), "no fix in three dimensions: its type");
  EXPECT_FALSE(b.give(b.fix(900 * kMs, 47, 8, 400, 9))) << "a number of a later version";
  EXPECT_FALSE(b.give(b.fix(900 * kMs, 47, 8, 400, 3, 0)));
  EXPECT_EQ(b.why(hal::AidKind::kSatellites), "a fix that does not say how sure it is");
  EXPECT_FALSE(b.give(b.fix(900 * kMs, 47, 8, 400, 3, 12)));
  EXPECT_EQ(b.why(hal::AidKind::kSatellites), "a fix that is too unsure: sigma [m]");
  ASSERT_TRUE(b.give(b.fix(1000 * kMs, 47, 179.9999, 400)));
  EXPECT_EQ(b.sample.value[0], 0);
  ASSERT_TRUE(b.give(b.fix(1200 * kMs, 47.001, -179.9999, 410)));
  EXPECT_NEAR(b.sample.value[1], 111.2, 0.4);
  EXPECT_NEAR(b.sample.value[0], 15.2, 0.1) << "across the date line";
  EXPECT_NEAR(b.sample.value[2], 10, 1e-9);
  EXPECT_EQ(b.sample.velocity_sigma, 0);
  AutopilotInput moving = b.fix(1400 * kMs, 47.001, -179.9999, 410);
  moving.value[6] = 3, moving.value[7] = -4, moving.value[8] = 0.2;
  ASSERT_TRUE(b.give(moving));
  EXPECT_EQ(b.sample.velocity, (std::array<double, 2>{3, -4})) << "east, north";
  EXPECT_EQ(b.sample.velocity_sigma, 0.2);
}

TEST(BusAids, WhatIsSwitchedOffIsNotHeard) {
  BusAidsOptions options;
  options.used[0] = false;
  Bus b(options);
  EXPECT_FALSE(b.give(b.range(1000 * kMs, 0, 12)));
  EXPECT_EQ(b.aids.heard(hal::AidKind::kRange).t_heard_ns, 0);
}

TEST(BusAids, TakesTheWholeRingWithoutAllocation) {
  Bus b;
  const rt::RtScope real_time;
  int taken = 0;
  for (int round = 0; round < 20; ++round) {
    for (int i = 0; i < 100; ++i) {
      b.ring->try_push(b.range((1000 + 100 * round + i) * kMs, 0, 12));
      b.ring->try_push(b.pressure((1000 + 100 * round + i) * kMs, 95000));
      b.ring->try_push(b.fix((1000 + 100 * round + i) * kMs, 47, 8, 400, i % 2 == 0 ? 3 : 1));
    }
    while (b.aids.next_until(100000 * kMs, &b.sample)) ++taken;
  }
  EXPECT_EQ(taken, 20 * (100 + 100 + 50));
}

TEST(AidWatch, SaysWhatIsHeardWhatFellSilentAndWhatIsRefusedOnce) {
  Bus b;
  AidWatch watch;
  std::vector<std::string> told;
  const auto look = [&](rt::TimeNs now_ns) {
    for (const AidNews& news : watch.look(b.aids, now_ns)) told.push_back((news.warning ? "! " : "") + news.words);
  };
  look(1000 * kMs);
  for (int t = 1000; t < 5000; t += 100) {
    b.give(b.range(t * kMs, 0, 12));
    b.give(b.pressure(t * kMs, 950));
    look(t * kMs);
  }
  look(9000 * kMs);
  EXPECT_EQ(told, (std::vector<std::string>{
                      "aids: rangefinder of the autopilot is heard and used",
                      "! aids: barometer is heard and not used: no air that flies has that pressure [Pa] 950",
                      "! aids: rangefinder of the autopilot fell silent"}));
  EXPECT_EQ(
      aid_report(b.aids),
      (std::vector<std::string>{
          "aids: rangefinder: 40 measurements taken of the autopilot",
          "aids: barometer: 0 measurements taken, 40 not, the last: no air that flies has that pressure [Pa] 950"}));
}

}  // namespace bus_aids_test
}  // namespace godwit::app
