#include "firmware_app/commands/fly_command.h"

#include <Eigen/Core>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <map>
#include <string>
#include <vector>

#include "firmware_app/program/exit_code.h"
#include "tests/sim/file_content.h"
#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace {
namespace fs = std::filesystem;
using test::content;

/// A short flight past houses and people, made and drawn in a fraction of a street's time.
constexpr const char* kLittleStreet = R"(
max_duration_s = 8
[world]
kind = "residential"
ground_texels = 512
[flight]
start_m = [22, 102.4]
start_height_m = 8
[[flight.leg]]
kind = "path"
speed_m_s = 3
points_m = [[60, 102.4]]
[camera]
width = 320
height = 240
fx = 225
)";

class Fly : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = temp_.path() / "flight";
    fs::create_directories(folder_);
    std::ofstream(folder_ / "little-street.toml") << kLittleStreet;
    arguments_.flight.scenario = "little-street";
    arguments_.flight.folder = folder_.string();
    arguments_.run.sequential = true;
    arguments_.run.start = 60;
    arguments_.run.frames = 60;
  }
  void TearDown() override { fs::remove_all(folder_); }
  int run(const char* name) {
    arguments_.run.out = (folder_ / name).string();
    return run_fly(arguments_, stop_);
  }
  test::TempFolder temp_;  // of its own: tests run side by side
  fs::path folder_;
  FlyArguments arguments_;
  std::atomic<bool> stop_{false};
};

TEST_F(Fly, TwoSequentialFlightsAreEqualToTheBitAndBringTheTruth) {
  ASSERT_EQ(run("a"), kExitDone);
  ASSERT_EQ(run("b"), kExitDone);
  const std::string trajectory = content(folder_ / "a/trajectory.tum");
  EXPECT_EQ(trajectory, content(folder_ / "b/trajectory.tum"));
  EXPECT_GT(std::count(trajectory.begin(), trajectory.end(), '\n'), 10) << "an odometry that never starts";
  const std::string truth = content(folder_ / "a/groundtruth.txt");
  EXPECT_EQ(std::count(truth.begin(), truth.end(), '\n'), 8 * 200 + 2);
  EXPECT_EQ(content(folder_ / "a/boxes.csv"), content(folder_ / "b/boxes.csv"));
  EXPECT_GT(content(folder_ / "a/boxes.csv").size(), 1000u);
}

TEST_F(Fly, PicturesRenderedAheadAreTheSame) {
  arguments_.run.frames = 30;
  ASSERT_EQ(run("live"), kExitDone);
  arguments_.render_ahead = true;
  ASSERT_EQ(run("ahead"), kExitDone);
  EXPECT_EQ(content(folder_ / "live/trajectory.tum"), content(folder_ / "ahead/trajectory.tum"));
  EXPECT_EQ(content(folder_ / "live/boxes.csv"), content(folder_ / "ahead/boxes.csv"));
}

TEST_F(Fly, TrueBoxesAsMasksReachTheOdometry) {
  ASSERT_EQ(run("bare"), kExitDone);
  arguments_.truth_masks = true;
  ASSERT_EQ(run("masked"), kExitDone);
  const std::string masked = content(folder_ / "masked/trajectory.tum");
  EXPECT_GT(std::count(masked.begin(), masked.end(), '\n'), 10);
  EXPECT_NE(content(folder_ / "bare/trajectory.tum"), masked);
}

/// Places of a trajectory, or of the truth at its times, and their length [m].
double way_of(const fs::path& trajectory, const fs::path& truth, double* true_way) {
  std::ifstream told(trajectory), file(truth);
  std::string line;
  std::map<long, Eigen::Vector3d> places;
  while (std::getline(file, line)) {
    double t = 0;
    Eigen::Vector3d p;
    if (std::sscanf(line.c_str(), "%lf %lf %lf %lf", &t, &p.x(), &p.y(), &p.z()) == 4) places[std::lround(t * 200)] = p;
  }
  std::vector<Eigen::Vector3d> way, flown;
  while (std::getline(told, line)) {
    double t = 0;
    Eigen::Vector3d p;
    if (std::sscanf(line.c_str(), "%lf %lf %lf %lf", &t, &p.x(), &p.y(), &p.z()) != 4) continue;
    way.push_back(p);
    flown.push_back(places.at(std::lround(t * 200)));
  }
  *true_way = flown.empty() ? 0 : (flown.back() - flown.front()).norm();
  return way.empty() ? 0 : (way.back() - way.front()).norm();
}

TEST_F(Fly, AnAutopilotsAttitudeAndARangefinderMakeMetresWithoutAnInertialSensor) {
  arguments_.run.start = 0;
  arguments_.run.frames = 0;
  arguments_.run.aids = "range,attitude";
  ASSERT_EQ(run("metres"), kExitDone);
  double true_way = 0;
  const double way = way_of(folder_ / "metres/trajectory.tum", folder_ / "metres/groundtruth.txt", &true_way);
  ASSERT_GT(true_way, 5) << "most of the flight";
  EXPECT_NEAR(way / true_way, 1, 0.2) << "over ground with houses on it";
  const std::string summary = content(folder_ / "metres/summary.json");
  EXPECT_NE(summary.find("\"starting_height\": 0.0"), std::string::npos) << summary;
  EXPECT_NE(content(folder_ / "metres/frames.csv").find("waiting for the autopilot's attitude"), std::string::npos);

  // A vertical alone is no scale.
  arguments_.run.aids = "attitude";
  ASSERT_EQ(run("nothing"), kExitDone);
  const std::string trajectory = content(folder_ / "nothing/trajectory.tum");
  EXPECT_EQ(std::count(trajectory.begin(), trajectory.end(), '\n'), 1);
  EXPECT_NE(content(folder_ / "nothing/frames.csv").find("nobody tells the scale well enough"), std::string::npos);
  arguments_.run.aids = "range";
  EXPECT_EQ(run("refused"), kExitRefused) << "and a length without a vertical is none";
}

TEST_F(Fly, OtherSensorsLieBesideTheFlight) {
  arguments_.run.frames = 2;
  ASSERT_EQ(run("a"), kExitDone);
  const auto lines = [&](const char* name) {
    const std::string text = content(folder_ / "a" / name);
    return std::count(text.begin(), text.end(), '\n');
  };
  EXPECT_EQ(lines("imu.csv"), 8 * 200 + 2);
  EXPECT_EQ(lines("groundtruth_body.txt"), 8 * 200 + 2);
  EXPECT_EQ(lines("range.csv"), 8 * 20 + 2);
  EXPECT_EQ(lines("gnss.csv"), 8 * 5 + 2);
  EXPECT_EQ(lines("baro.csv"), 8 * 25 + 2);
  EXPECT_EQ(lines("attitude.csv"), 8 * 10 + 2);
  // Readings stay near what an ideal sensor would have read: noise and start bias only.
  std::ifstream imu(folder_ / "a/imu.csv");
  std::string line;
  std::getline(imu, line);
  double t = 0, v[12] = {};
  char comma = 0;
  while (imu >> t) {
    for (double& x : v) imu >> comma >> x;
    for (int i = 0; i < 3; ++i) {
      ASSERT_NEAR(v[i], v[6 + i], 0.02) << t;
      ASSERT_NEAR(v[3 + i], v[9 + i], 0.5) << t;
    }
  }
  EXPECT_NEAR(t, 8, 0.01);
}

TEST_F(Fly, RefusesWhatItCannotFly) {
  arguments_.flight.scenario = "litle-street";
  EXPECT_EQ(run("a"), kExitRefused);
  arguments_.flight.scenario = "little-street";
  arguments_.run.start = 1'000'000;
  EXPECT_EQ(run("a"), kExitRefused);
  arguments_.run.start = 0;
  arguments_.run.pace = "real";
  EXPECT_EQ(run("a"), kExitRefused) << "sequential has no pace";
  EXPECT_FALSE(fs::exists(folder_ / "a/summary.json"));
}

}  // namespace
}  // namespace godwit::app
