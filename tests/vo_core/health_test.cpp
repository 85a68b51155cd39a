// The states of the odometry, driven by made-up evidence.
#include "vo_core/tracking/health.h"

#include <gtest/gtest.h>
#include <string>

namespace godwit::vo {
namespace health_test {

using Kind = FrameEvidence::Kind;
constexpr rt::TimeNs kFrame = 33 * rt::kNsPerMs;

class HealthTest : public testing::Test {
 protected:
  State step(Kind kind, int measurements = 0, bool inertial = false, rt::TimeNs dt = kFrame) {
    now_ += dt;
    return health_.step({kind, measurements, inertial, now_});
  }
  void begin() {
    step(Kind::kNoMap);
    step(Kind::kFirstMap, 120);
  }
  /// Flown in for longer than any map is searched for.
  void fly_long() { step(Kind::kPose, 120, false, 2 * options_.give_up_ns); }
  HealthOptions options_;
  Health health_{options_};
  rt::TimeNs now_ = rt::kNsPerSecond;
};

TEST_F(HealthTest, ARefusedPoseIsToldByWhatItFailedBy) {
  begin();
  FrameEvidence e;
  e.kind = Kind::kNoPose;
  e.measurements = 44;  // enough, but
  e.refusal = {"too little speaks for the pose [nats]", 8, 20};
  e.t_capture_ns = 3600 * rt::kNsPerSecond;
  EXPECT_EQ(health_.step(e), State::kRelocalising);
  EXPECT_STREQ(health_.reason().text, "too little speaks for the pose [nats]");
  EXPECT_EQ(health_.reason().value, 8);
  EXPECT_EQ(health_.reason().limit, 20);
}

TEST_F(HealthTest, InitialisesUntilThereIsAMap) {
  EXPECT_EQ(step(Kind::kNoMap), State::kInitialising);
  EXPECT_EQ(step(Kind::kSamePicture), State::kInitialising);
  EXPECT_EQ(step(Kind::kNoMap, 0, false, 3600 * rt::kNsPerSecond), State::kInitialising) << "no time limit";
  EXPECT_EQ(step(Kind::kFirstMap, 90), State::kTracking);
  EXPECT_EQ(health_.reason().value, 90);
}

TEST_F(HealthTest, ALostPictureIsToldWithFigureAndLimitInTheSameFrame) {
  begin();
  EXPECT_EQ(step(Kind::kNoPose, 12), State::kRelocalising);
  EXPECT_EQ(std::string(health_.reason().text), "too few features");
  EXPECT_EQ(health_.reason().value, 12);
  EXPECT_EQ(health_.reason().limit, HealthOptions{}.min_measurements);
  EXPECT_EQ(step(Kind::kPose, 60), State::kTracking);
  EXPECT_EQ(health_.without_pose_ns(), 0);
}

TEST_F(HealthTest, AFoundPoseCountsWhenItIsProved) {
  begin();
  step(Kind::kNoPose);
  EXPECT_EQ(step(Kind::kUnproved, 80), State::kRelocalising);
  EXPECT_EQ(step(Kind::kPose, 80), State::kTracking);
  step(Kind::kNoPose);
  EXPECT_EQ(step(Kind::kFound, 80), State::kTracking) << "or where its picture alone proves it";
}

TEST_F(HealthTest, APoseOfFewFeaturesDoesNotCountAndSaysSo) {
  begin();
  EXPECT_EQ(step(Kind::kWeak, 25), State::kRelocalising);
  EXPECT_STREQ(health_.reason().text, "a pose of few features, not counted");
  EXPECT_EQ(health_.reason().value, 25);
  EXPECT_EQ(step(Kind::kPose, 31), State::kTracking);
}

TEST_F(HealthTest, CoastsOnInertialPosesForAShortTimeOnly) {
  begin();
  fly_long();
  rt::TimeNs coasted = 0;
  while (step(Kind::kNoPose, 0, true) == State::kCoasting) coasted += kFrame;
  EXPECT_EQ(health_.state(), State::kRelocalising);
  EXPECT_GT(coasted, options_.coast_ns - kFrame);
  EXPECT_LE(coasted, options_.coast_ns + kFrame);
  EXPECT_EQ(step(Kind::kNoPose, 0, true), State::kRelocalising) << "never back into coasting without a picture's pose";
  EXPECT_EQ(step(Kind::kPose, 50), State::kTracking);
  EXPECT_EQ(step(Kind::kNoPose, 0, true), State::kCoasting);
  EXPECT_EQ(step(Kind::kNoPose, 0, false), State::kRelocalising) << "the inertial pose is gone";
}

TEST_F(HealthTest, GivesUpOnceAndTellsHowLongItSearched) {
  begin();
  fly_long();
  int given_up = 0, frames = 0;
  while (given_up == 0 && frames < 1000) {
    ++frames;
    step(Kind::kNoPose, 3);
    given_up += health_.state() == State::kLost;
  }
  EXPECT_EQ(health_.state(), State::kLost);
  EXPECT_GE((frames - 1) * kFrame, options_.give_up_ns);
  EXPECT_LE((frames - 2) * kFrame, options_.give_up_ns);
  EXPECT_GE(health_.reason().value, health_.reason().limit);
  for (const Kind kind : {Kind::kNoPose, Kind::kUnproved, Kind::kWeak, Kind::kSamePicture})
    EXPECT_EQ(step(kind, 25), State::kLost) << "until another map stands";
  EXPECT_EQ(step(Kind::kPose, 70), State::kTracking) << "or this one is found after all";
  while (step(Kind::kNoPose) != State::kLost && frames < 2000) ++frames;
  EXPECT_LT(frames, 2000) << "and is searched for as before when it is lost again";
  EXPECT_EQ(step(Kind::kFirstMap, 70), State::kTracking);
}

TEST_F(HealthTest, OnlyPicturesThatShowSomethingAreASearch) {
  begin();
  fly_long();
  const auto without = [&](bool shows_nothing, bool expected) {
    FrameEvidence e;
    e.kind = Kind::kNoPose;
    e.t_capture_ns = now_ += kFrame;
    e.shows_nothing = shows_nothing;
    e.expected = expected;
    return health_.step(e) == State::kLost;
  };
  for (int i = 0; i < 1000; ++i) ASSERT_FALSE(without(true, false)) << "a covered lens";
  for (int i = 0; i < 1000; ++i) {
    ASSERT_NE(step(Kind::kSamePicture), State::kLost) << "a frozen camera";
  }
  EXPECT_GT(health_.without_pose_ns(), 60 * rt::kNsPerSecond);
  int frames = 0;
  while (!without(false, false) && frames < 1000) ++frames;
  EXPECT_NEAR(static_cast<double>(frames * kFrame), static_cast<double>(options_.give_up_ns), 2.0 * kFrame);
  // Whoever knows where the camera should be has looked in the right place at once.
  step(Kind::kFirstMap, 120);
  fly_long();
  for (frames = 0; !without(false, true) && frames < 1000;) ++frames;
  EXPECT_NEAR(static_cast<double>(frames * kFrame), static_cast<double>(options_.give_up_expected_ns), 2.0 * kFrame);
}

TEST_F(HealthTest, AMapIsSearchedForNoLongerThanItWasFlownIn) {
  const auto searched = [&] {
    rt::TimeNs t = 0;
    for (step(Kind::kNoPose); health_.state() != State::kLost && t < 100 * options_.give_up_ns; t += kFrame)
      step(Kind::kNoPose);
    return static_cast<double>(t);
  };
  begin();
  EXPECT_NEAR(searched(), static_cast<double>(options_.coast_ns), 2.0 * kFrame) << "but as long as it coasts";
  begin();
  for (int i = 0; i < 30; ++i) step(Kind::kPose, 60);
  for (int i = 0; i < 10; ++i) step(Kind::kNoPose);  // was found again: its search begins anew, its life goes on
  for (int i = 0; i < 30; ++i) step(Kind::kPose, 60);
  EXPECT_NEAR(searched(), 60.0 * kFrame, 3.0 * kFrame) << "what was searched was not flown";
  begin();
  fly_long();
  EXPECT_NEAR(searched(), static_cast<double>(options_.give_up_ns), 2.0 * kFrame);
  begin();
  EXPECT_NEAR(searched(), static_cast<double>(options_.coast_ns), 2.0 * kFrame) << "another map, another life";
}

TEST_F(HealthTest, AGapInTimeAloneGivesNothingUp) {
  begin();
  EXPECT_EQ(step(Kind::kNoPose, 0, false, 60 * rt::kNsPerSecond), State::kRelocalising)
      << "the search begins with the first picture after the gap";
}

TEST_F(HealthTest, ATimeThatGoesBackIsNoTimePassed) {
  begin();
  step(Kind::kNoPose);
  for (int i = 0; i < 100; ++i) step(Kind::kNoPose, 0, false, -10 * rt::kNsPerSecond);
  EXPECT_EQ(health_.state(), State::kRelocalising);
}

TEST_F(HealthTest, ARepeatedPictureLeavesTheStateAloneUntilItLasts) {
  begin();
  EXPECT_EQ(step(Kind::kSamePicture), State::kTracking);
  EXPECT_STREQ(health_.reason().text, "the picture is the one before, bit for bit");
  EXPECT_EQ(step(Kind::kPose, 100), State::kTracking);
  rt::TimeNs frozen = 0;
  while (step(Kind::kSamePicture) == State::kTracking && frozen < rt::kNsPerSecond) frozen += kFrame;
  EXPECT_EQ(health_.state(), State::kRelocalising);
  EXPECT_GT(frozen, options_.frozen_ns - kFrame);
  EXPECT_LE(frozen, options_.frozen_ns);
  EXPECT_EQ(step(Kind::kPose, 100), State::kTracking);
  // Nor does it make a pose of none.
  EXPECT_EQ(step(Kind::kNoPose), State::kRelocalising);
  EXPECT_EQ(step(Kind::kSamePicture), State::kRelocalising);
}

}  // namespace health_test
}  // namespace godwit::vo
