// The track that is told: of one frame of coordinates, in bounded memory.
#include "firmware_app/output/live_track.h"

#include <gtest/gtest.h>
#include <limits>
#include <nlohmann/json.hpp>

namespace godwit::app {
namespace {

using Json = nlohmann::json;

FrameRecord at(double x, std::uint32_t map) {
  FrameRecord r;
  r.tracked = r.has_pose = true;
  r.map_id = map;
  r.t_world_cam = {x, 2, 3};
  return r;
}

Json told(LiveTrack* track) {
  static rt::TimeNs now_ns = rt::kNsPerSecond;
  now_ns += rt::kNsPerSecond;
  std::string line;
  track->add_line(now_ns, &line);
  EXPECT_EQ(line.find('\n'), line.size() - 1) << "one line";
  std::string again;
  track->add_line(now_ns, &again);
  EXPECT_EQ(again, "") << "once a second";
  return Json::parse(line)["track"];
}

TEST(LiveTrack, WithoutAPoseThereIsNone) {
  LiveTrack track;
  FrameRecord none;
  track.frame(none);
  FrameRecord absurd = at(std::numeric_limits<double>::quiet_NaN(), 1);
  track.frame(absurd);
  EXPECT_EQ(told(&track)["places"], Json::array());
}

TEST(LiveTrack, EndsWhereTheCameraIsHoweverLongItIs) {
  LiveTrack track;
  for (int i = 0; i <= 100'000; ++i) track.frame(at(i, 1));
  const Json j = told(&track);
  EXPECT_LE(j["places"].size(), LiveTrack::kPlaces + 1);
  EXPECT_GT(j["places"].size(), LiveTrack::kPlaces / 2);
  EXPECT_EQ(j["places"][0], Json({0, 2, 3}));
  EXPECT_EQ(j["places"].back(), Json({100'000, 2, 3}));
  double before = -1;
  for (const Json& p : j["places"]) {
    EXPECT_LE(p[0].get<double>() - before, 257) << "evenly";
    EXPECT_GE(p[0].get<double>(), before);
    before = p[0].get<double>();
  }
}

TEST(LiveTrack, OtherCoordinatesBeginAnew) {
  LiveTrack track;
  for (int i = 0; i < 10; ++i) track.frame(at(i, 1));
  for (int i = 0; i < 5; ++i) track.frame(at(i, 2));
  Json j = told(&track);
  EXPECT_EQ(j["number"], 2);
  EXPECT_FALSE(j["metric"].get<bool>());
  EXPECT_EQ(j["places"].size(), 6u);
  // Metres outlive a map.
  for (std::uint32_t map = 2; map < 5; ++map) {
    FrameRecord r = at(map, map);
    r.metric = true;
    r.frame_id = 1;
    track.frame(r);
  }
  j = told(&track);
  EXPECT_TRUE(j["metric"].get<bool>());
  EXPECT_EQ(j["number"], 1);
  EXPECT_EQ(j["places"].size(), 4u);
}

}  // namespace
}  // namespace godwit::app
