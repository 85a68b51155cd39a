// Innovations over time: all well where they are as large as they should be, less trust where not, and an end with a
// reason where that lasts.
#include "vo_core/inertial/self_check.h"

#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <random>
#include <string>

namespace godwit::vo {
namespace self_check_test {

constexpr rt::TimeNs kStep = rt::kNsPerSecond / 2;

/// Squared innovations of three degrees, their errors `factor` times what they should be, for so many seconds. True: it
/// was given up; *t_ns is then when.
bool feed(SelfCheck* check, CheckedBy by, double factor, double seconds, rt::TimeNs* t_ns, unsigned seed = 1) {
  std::mt19937 engine(seed);
  std::normal_distribution<double> normal;
  for (const rt::TimeNs end = *t_ns + static_cast<rt::TimeNs>(seconds * 1e9); *t_ns < end; *t_ns += kStep) {
    double squared = 0;
    for (int i = 0; i < 3; ++i) squared += std::pow(factor * normal(engine), 2);
    if (check->add(by, squared, 3, *t_ns)) return true;
  }
  return false;
}

TEST(SelfCheck, WhatFitsIsTrustedForEver) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    SelfCheck check;
    rt::TimeNs t = rt::kNsPerSecond;
    for (int minute = 0; minute < 10; ++minute) {
      EXPECT_FALSE(feed(&check, CheckedBy::kInertial, 1, 60, &t, seed * 100 + static_cast<unsigned>(minute)));
      EXPECT_GT(check.trust(), 0.9);
    }
    EXPECT_NEAR(check.mean(CheckedBy::kInertial), 1, 0.9);
  }
}

TEST(SelfCheck, DisagreementLowersTrustAndThenEndsWithAReason) {
  SelfCheck check;
  rt::TimeNs t = rt::kNsPerSecond;
  feed(&check, CheckedBy::kInertial, 1, 20, &t);
  EXPECT_FALSE(feed(&check, CheckedBy::kInertial, 2.2, 20, &t));
  EXPECT_LT(check.trust(), 0.8) << "doubted, and still told";
  EXPECT_GT(check.trust(), 0.1);
  const rt::TimeNs worse = t;
  EXPECT_TRUE(feed(&check, CheckedBy::kInertial, 6, 30, &t));
  EXPECT_LT(rt::to_seconds(t - worse), 10);
  EXPECT_NE(std::string(check.reason()).find("inertial"), std::string::npos);
  EXPECT_GT(check.value(), 9);
  EXPECT_NEAR(check.trust(), 0.1, 1e-9) << "what begins anew is not trusted for that";
  t += kStep;
  EXPECT_FALSE(feed(&check, CheckedBy::kInertial, 1, 20, &t));
  EXPECT_GT(check.trust(), 0.9) << "until it fits";
}

TEST(SelfCheck, WhoMayOnlyDoubtEndsNothingAndIsForgotten) {
  SelfCheck check;
  rt::TimeNs t = rt::kNsPerSecond;
  for (int i = 0; i < 60; ++i, t += kStep) check.doubt(CheckedBy::kRange, 40, 1, t);
  EXPECT_NEAR(check.trust(), 0.1, 1e-9);
  EXPECT_STREQ(check.reason(), "") << "nothing was given up";
  check.forget_older(CheckedBy::kRange, t - 5 * kStep);
  EXPECT_NEAR(check.trust(), 0.1, 1e-9) << "it was heard since";
  check.forget_older(CheckedBy::kBarometer, t);
  EXPECT_NEAR(check.trust(), 0.1, 1e-9) << "another one";
  check.forget_older(CheckedBy::kRange, t);
  EXPECT_EQ(check.trust(), 1);
}

TEST(SelfCheck, OneOutlierEndsNothing) {
  SelfCheck check;
  rt::TimeNs t = rt::kNsPerSecond;
  feed(&check, CheckedBy::kRange, 1, 20, &t);
  EXPECT_FALSE(check.add(CheckedBy::kRange, 1e12, 1, t += kStep));
  EXPECT_FALSE(feed(&check, CheckedBy::kRange, 1, 30, &t));
  EXPECT_GT(check.trust(), 0.9);
}

TEST(SelfCheck, TheOneThatFitsLeastCountsAndIsNamed) {
  SelfCheck check;
  rt::TimeNs t = rt::kNsPerSecond;
  bool ended = false;
  for (int i = 0; i < 60 && !ended; ++i, t += kStep) {
    EXPECT_FALSE(check.add(CheckedBy::kInertial, 3, 3, t));
    EXPECT_FALSE(check.add(CheckedBy::kSatellites, 2, 2, t));
    ended = check.add(CheckedBy::kBarometer, 40, 1, t);
  }
  EXPECT_TRUE(ended);
  EXPECT_NE(std::string(check.reason()).find("barometer"), std::string::npos);
}

TEST(SelfCheck, WhatIsNoNumberIsTheWorstAndStaysANumber) {
  SelfCheck check;
  const double kNan = std::numeric_limits<double>::quiet_NaN();
  bool ended = false;
  for (int i = 0; i < 20; ++i) {
    ended = check.add(CheckedBy::kInertial, kNan, 3, rt::kNsPerSecond + i * kStep) || ended;
    ended = check.add(CheckedBy::kRange, -1, 1, rt::kNsPerSecond + i * kStep) || ended;
    EXPECT_TRUE(std::isfinite(check.trust()) && std::isfinite(check.mean(CheckedBy::kInertial)));
  }
  EXPECT_TRUE(ended);
}

}  // namespace self_check_test
}  // namespace godwit::vo
