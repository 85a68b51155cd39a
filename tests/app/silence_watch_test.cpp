#include "firmware_app/pipeline/silence_watch.h"

#include <gtest/gtest.h>

namespace godwit::app::silence_watch_test {
namespace {

constexpr rt::TimeNs kLimit = 200 * rt::kNsPerMs;
constexpr rt::TimeNs at(double s) {
  return static_cast<rt::TimeNs>(s * 1e9);
}

TEST(SilenceWatch, ASilenceIsToldOnceWithItsLengthAndSoIsItsEnd) {
  SilenceWatch watch("no picture", "pictures again", kLimit);
  watch.heard(at(1));
  EXPECT_FALSE(watch.look(at(1.2))) << "at the limit it is none";
  const auto fell = watch.look(at(1.25));
  ASSERT_TRUE(fell);
  EXPECT_STREQ(fell->what, "no picture");
  EXPECT_EQ(fell->level, rt::LogLevel::kWarning);
  EXPECT_DOUBLE_EQ(fell->value, 0.25);
  EXPECT_DOUBLE_EQ(fell->limit, 0.2);
  EXPECT_TRUE(watch.silent());
  EXPECT_FALSE(watch.look(at(3)));
  watch.heard(at(4));
  const auto back = watch.look(at(4.01));
  ASSERT_TRUE(back);
  EXPECT_STREQ(back->what, "pictures again");
  EXPECT_EQ(back->level, rt::LogLevel::kInfo);
  EXPECT_DOUBLE_EQ(back->value, 3) << "from the last before to the first after";
  EXPECT_FALSE(watch.silent());
  EXPECT_EQ(watch.silences(), 1u);
}

TEST(SilenceWatch, WhatWasNeverHeardIsMissedFromTheFirstLookOn) {
  SilenceWatch watch("IMU silent", "IMU heard again", kLimit);
  EXPECT_FALSE(watch.look(at(100)));
  EXPECT_FALSE(watch.look(at(100.2)));
  EXPECT_TRUE(watch.look(at(100.21)));
}

}  // namespace
}  // namespace godwit::app::silence_watch_test
