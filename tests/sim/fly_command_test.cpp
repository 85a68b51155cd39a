#include "firmware_app/commands/fly_command.h"

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <sstream>

#include "firmware_app/commands/exit_code.h"
#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace {
namespace fs = std::filesystem;

std::string content(const fs::path& file) {
  std::ifstream in(file);
  std::stringstream s;
  s << in.rdbuf();
  return s.str();
}

class Fly : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = temp_.path() / "flight";
    arguments_.flight.scenario = "street";
    arguments_.flight.folder = GODWIT_SCENARIO_DIR;
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
  EXPECT_EQ(std::count(truth.begin(), truth.end(), '\n'), 60 * 200 + 2);
  EXPECT_EQ(content(folder_ / "a/boxes.csv"), content(folder_ / "b/boxes.csv"));
  EXPECT_GT(content(folder_ / "a/boxes.csv").size(), 1000u);
}

TEST_F(Fly, RefusesWhatItCannotFly) {
  arguments_.flight.scenario = "stret";
  EXPECT_EQ(run("a"), kExitRefused);
  arguments_.flight.scenario = "street";
  arguments_.run.start = 1'000'000;
  EXPECT_EQ(run("a"), kExitRefused);
  arguments_.run.start = 0;
  arguments_.run.pace = "real";
  EXPECT_EQ(run("a"), kExitRefused) << "sequential has no pace";
  EXPECT_FALSE(fs::exists(folder_ / "a/summary.json"));
}

}  // namespace
}  // namespace godwit::app
