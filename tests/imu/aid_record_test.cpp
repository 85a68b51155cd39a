#include "hal/aid/replay/aid_record.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "hal/aid/replay/replay_aids.h"

namespace godwit::hal::aid_record_test {
namespace {

using testing::HasSubstr;

TEST(AidRecord, ReadsWhatTheSimulatorWrites) {
  const auto range =
      parse_aid(AidKind::kRange, "t,range_m,valid,truth_m\n1.05,15.0,1,15.1\n1.10,0.0,0,15.1\n", "range.csv");
  ASSERT_TRUE(range.ok()) << range.error().message;
  ASSERT_EQ(range.value().size(), 1u) << "no echo, no reading";
  EXPECT_EQ(range.value()[0].t_ns, 1050000000);
  EXPECT_EQ(range.value()[0].value[2], 15.0);
  const auto gnss = parse_aid(AidKind::kSatellites,
                              "t,fix,x,y,z,vx,vy,vz,sigma_m\n1,1,2,3,4,5,6,7,0.6\n2,0,0,0,0,0,0,0,0\n", "gnss.csv");
  ASSERT_TRUE(gnss.ok()) << gnss.error().message;
  ASSERT_EQ(gnss.value().size(), 1u) << "no fix, no reading";
  EXPECT_EQ(gnss.value()[0].value, (std::array<double, 3>{2, 3, 4}));
  EXPECT_EQ(gnss.value()[0].sigma, 0.6);
  EXPECT_EQ(gnss.value()[0].velocity, (std::array<double, 2>{5, 6}));
  EXPECT_EQ(gnss.value()[0].velocity_sigma, kSatelliteVelocitySigma);
  const auto sure = parse_aid(AidKind::kSatellites,
                              "t,fix,x,y,z,vx,vy,vz,sigma_m,speed_sigma_m_s\n1,1,2,3,4,5,6,7,0.6,0.05\n", "gnss.csv");
  ASSERT_TRUE(sure.ok()) << sure.error().message;
  EXPECT_EQ(sure.value()[0].velocity_sigma, 0.05);
  // The standard atmosphere: 89874.6 Pa at 1000 m.
  // Yawed by a right angle and then nose up by 0.2.
  const auto attitude = parse_aid(
      AidKind::kAttitude, "t,qw,qx,qy,qz,off_deg\n1,0.7035741,-0.0705929,0.0705929,0.7035741,0\n", "attitude.csv");
  ASSERT_TRUE(attitude.ok()) << attitude.error().message;
  EXPECT_NEAR(attitude.value()[0].value[0], std::sin(0.2), 1e-6);
  EXPECT_NEAR(attitude.value()[0].value[1], 0, 1e-6);
  EXPECT_NEAR(attitude.value()[0].value[2], -std::cos(0.2), 1e-6);
  EXPECT_EQ(attitude.value()[0].sigma, kAttitudeSigmaRad);
  const auto baro = parse_aid(AidKind::kBarometer, "t,pressure_pa,true_pressure_pa\n1,89874.6,0\n", "baro.csv");
  ASSERT_TRUE(baro.ok()) << baro.error().message;
  EXPECT_NEAR(baro.value()[0].value[2], 1000, 0.5);
}

TEST(AidRecord, WhatCannotBeReadIsNamed) {
  const auto word = [](AidKind kind, const char* text) {
    const auto r = parse_aid(kind, text, "FILE");
    return r.ok() ? std::string("it was read") : r.error().message;
  };
  EXPECT_THAT(word(AidKind::kRange, "time,metres\n1,2\n"), HasSubstr("columns begin with t,range_m,valid"));
  EXPECT_THAT(word(AidKind::kRange, "t,range_m,valid\n1,nan,1\n"), HasSubstr("number 2 of the line"));
  EXPECT_THAT(word(AidKind::kRange, "t,range_m,valid\n1,-3,1\n"), HasSubstr("above 0 m"));
  EXPECT_THAT(word(AidKind::kRange, "t,range_m,valid\n1,3,1\n1,3,1\n"), HasSubstr("not above the one before"));
  EXPECT_THAT(word(AidKind::kBarometer, "t,pressure_pa\n1,1013.25\n"), HasSubstr("[Pa]")) << "hectopascals";
  EXPECT_THAT(word(AidKind::kSatellites, "t,fix,x,y,z,vx,vy,vz,sigma_m\n1,1,2,3,4,0,0,0,0\n"), HasSubstr("sigma"));
  EXPECT_THAT(word(AidKind::kSatellites, "t,fix,x,y,z,vx,vy,vz,sigma_m,speed_sigma_m_s\n1,1,2,3,4,0,0,0,1,0\n"),
              HasSubstr("0 m/s"));
  EXPECT_THAT(word(AidKind::kSatellites, "t,fix,x,y,z,vx,vy,vz,sigma_m\nsoon,1,2,3,4,0,0,0,1\n"),
              HasSubstr("not a time"));
  EXPECT_THAT(word(AidKind::kAttitude, "t,qw,qx,qy,qz\n1,1,1,0,0\n"), HasSubstr("length 1"));
  EXPECT_THAT(word(AidKind::kAttitude, "t,qw,qx,qy,qz\n1,nan,0,0,0\n"), HasSubstr("number 2 of the line"));
  const auto missing = read_aid_record("/nowhere", {AidKind::kRange});
  ASSERT_FALSE(missing.ok());
  EXPECT_THAT(missing.error().message, HasSubstr("/nowhere/range.csv"));
}

TEST(AidRecord, AFileThatBreaksOffIsReadUpToThere) {
  std::string words;
  const auto range = parse_aid(AidKind::kRange, "t,range_m,valid\n1,3,1\n2,4", "range.csv", &words);
  ASSERT_TRUE(range.ok()) << range.error().message;
  EXPECT_EQ(range.value().size(), 1u);
  EXPECT_THAT(words, HasSubstr("range.csv:3: "));
}

TEST(AidRecord, TheListOfKindsIsCheckedWordByWord) {
  const auto both = parse_aid_kinds("gnss,range");
  ASSERT_TRUE(both.ok());
  EXPECT_EQ(both.value(), (std::vector<AidKind>{AidKind::kSatellites, AidKind::kRange}));
  EXPECT_FALSE(parse_aid_kinds("gps").ok());
  EXPECT_FALSE(parse_aid_kinds("range,range").ok());
}

TEST(ReplayAids, NothingComesBeforeItsTimeNorBeforeTheCamera) {
  ReplayTime time;
  ReplayAids aids({{AidKind::kRange, 100, {0, 0, 5}, 0.1}, {AidKind::kRange, 200, {0, 0, 6}, 0.1}}, &time);
  AidSample s;
  EXPECT_FALSE(aids.next_until(10'000, &s)) << "nobody knows when that was";
  time.pin(50, 1050);
  EXPECT_FALSE(aids.next_until(1099, &s));
  ASSERT_TRUE(aids.next_until(1100, &s));
  EXPECT_EQ(s.t_ns, 1100);
  EXPECT_EQ(s.value[2], 5);
  EXPECT_FALSE(aids.next_until(1150, &s));
  EXPECT_TRUE(aids.next_until(1200, &s));
  EXPECT_FALSE(aids.next_until(9'999, &s)) << "that was all";
}

}  // namespace
}  // namespace godwit::hal::aid_record_test
