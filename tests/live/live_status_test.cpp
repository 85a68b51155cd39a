#include "firmware_app/output/live_status.h"

#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <nlohmann/json.hpp>
#include <thread>

namespace godwit::app {
namespace {

using Json = nlohmann::json;

Json told(LiveStatus* status) {
  const std::string line = status->snapshot(rt::monotonic_now_ns());
  EXPECT_EQ(line.find('\n'), std::string::npos) << "one line";
  return Json::parse(line);
}

FrameRecord frame(int i) {
  FrameRecord r;
  r.t_capture_ns = rt::monotonic_now_ns() - 20 * rt::kNsPerMs;
  r.t_delivered_ns = r.t_capture_ns + 15 * rt::kNsPerMs;
  r.t_done_ns = r.t_capture_ns + (18 + i % 3) * rt::kNsPerMs;
  r.wall_ns = rt::kNsPerMs;
  r.state = vo::State::kTracking;
  r.tracked = r.has_pose = true;
  r.features = 120;
  r.map_id = 2;
  r.t_world_cam = {1, 2, 3};
  r.covariance[0] = 0.01;
  r.reason.assign("tracking: 120 of 30");
  return r;
}

TEST(LiveStatus, BeforeThereIsAPictureNothingIsInvented) {
  LiveStatus status({"1.2.3", {}, nullptr});
  const Json j = told(&status);
  EXPECT_EQ(j["version"], "1.2.3");
  for (const char* key : {"state", "quality", "position", "age_ms", "temperature_c", "features"}) {
    EXPECT_TRUE(j[key].is_null()) << key;
  }
  EXPECT_EQ(j["frames"], 0);
  EXPECT_EQ(j["events"], Json::array());
}

TEST(LiveStatus, TellsTheFlightAsItIs) {
  LiveStatus status({"1.2.3", [] { return 73; }, nullptr});
  for (int i = 0; i < 60; ++i) status.frame(frame(i));
  FrameRecord dropped;
  dropped.fate = FrameFate::kDroppedLate;
  status.frame(dropped);
  const Json j = told(&status);
  EXPECT_EQ(j["state"], "TRACKING");
  EXPECT_EQ(j["reason"], "tracking: 120 of 30");
  EXPECT_EQ(j["quality"], 73);
  EXPECT_EQ(j["map"], 2);
  EXPECT_EQ(j["features"], 120);
  EXPECT_EQ(j["position"], Json({1.0, 2.0, 3.0}));
  EXPECT_NEAR(j["position_sigma"].get<double>(), 0.1, 1e-6);
  EXPECT_EQ(j["frames"], 61);
  EXPECT_EQ(j["tracked"], 60);
  EXPECT_EQ(j["not_flown"], 1);
  EXPECT_NEAR(j["age_ms"]["p50"].get<double>(), 19, 0.01);
  EXPECT_NEAR(j["age_ms"]["max"].get<double>(), 20, 0.01);
  EXPECT_NEAR(j["own_ms"]["p50"].get<double>(), 4, 0.01);
  EXPECT_GT(j["pictures_hz"].get<double>(), j["poses_hz"].get<double>());
  EXPECT_FALSE(j["metric"].get<bool>());
}

TEST(LiveStatus, WhatBecameOfTheFixes) {
  LiveStatus status({"1", {}, nullptr});
  FrameRecord r = frame(0);
  status.frame(r);
  EXPECT_TRUE(told(&status)["north"].is_null()) << "none came";
  r.earth.fixes = 9;
  status.frame(r);
  EXPECT_EQ(told(&status)["north"], "unknown");
  EXPECT_TRUE(told(&status)["north_sigma_deg"].is_null());
  r.earth.known = r.earth.held = true;
  r.earth.heading_sigma = 0.0175;
  r.earth.fixes_used = 5;
  r.earth.fixes_refused = 3;
  status.frame(r);
  const Json j = told(&status);
  EXPECT_EQ(j["north"], "held");
  EXPECT_NEAR(j["north_sigma_deg"].get<double>(), 1.0, 1e-9);
  EXPECT_EQ(j["fixes"], 9);
  EXPECT_EQ(j["fixes_used"], 5);
  EXPECT_EQ(j["fixes_refused"], 3);
}

TEST(LiveStatus, TheLastEventsAndTheRung) {
  LiveStatus status({"1", {}, nullptr});
  EXPECT_EQ(told(&status)["rung"], "full");
  for (int i = 0; i < 40; ++i) status.event({}, "line " + std::to_string(i));
  rt::LogEntry rung;
  rung.what = "rung down";
  rung.which = "small_detector";
  status.event(rung, "rung down\xFF");
  const Json j = told(&status);
  ASSERT_EQ(j["events"].size(), 12u);
  EXPECT_EQ(j["events"][0], "line 29");
  EXPECT_EQ(j["rung"], "small_detector");
  EXPECT_EQ(j["events_told"], 41) << "so many there were, of which these are the last";
}

TEST(LiveStatus, WhatIsNoNumberIsNull) {
  LiveStatus status({"1", {}, nullptr});
  FrameRecord r = frame(0);
  r.t_world_cam[1] = std::numeric_limits<double>::quiet_NaN();
  r.covariance[0] = std::numeric_limits<double>::infinity();
  status.frame(r);
  const Json j = told(&status);
  EXPECT_TRUE(j["position"][1].is_null());
  EXPECT_TRUE(j["position_sigma"].is_null());
}

TEST(LiveStatus, IsAskedWhileItIsFed) {
  LiveStatus status({"1", {}, nullptr});
  std::thread feeder([&] {
    for (int i = 0; i < 3000; ++i) {
      status.frame(frame(i));
      status.event({}, "line");
    }
  });
  for (int i = 0; i < 200; ++i) told(&status);
  feeder.join();
  EXPECT_EQ(told(&status)["frames"], 3000);
}

}  // namespace
}  // namespace godwit::app
