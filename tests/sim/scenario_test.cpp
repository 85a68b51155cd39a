#include "hal/sim/flight/scenario.h"

#include <Eigen/LU>
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/sim/test_scenario.h"
#include "tests/support/temp_folder.h"

namespace godwit::sim {
namespace {
using testing::HasSubstr;

class ScenarioFile : public testing::Test {
 protected:
  std::filesystem::path write(const std::string& text) const {
    const std::filesystem::path file = folder_ / "test.toml";
    std::ofstream(file) << text;
    return file;
  }
  std::string error(const std::string& text) const {
    const rt::Result<Scenario> read = read_scenario(write(text));
    return read.ok() ? "(no error)" : read.error().message;
  }
  godwit::test::TempFolder temporary_;
  const std::filesystem::path folder_ = temporary_.path();
  const std::string leg_ = "[[flight.leg]]\nkind = \"hover\"\nduration_s = 2\n";
};

TEST_F(ScenarioFile, TheSmallestOneIsAHover) {
  const rt::Result<Scenario> read = read_scenario(write(leg_));
  ASSERT_TRUE(read.ok()) << read.error().message;
  EXPECT_EQ(read.value().name, "test");
  ASSERT_EQ(read.value().trajectory.legs.size(), 1u);
  EXPECT_EQ(read.value().trajectory.legs[0].kind, LegKind::kHover);
  // The axis lies 40 degrees below the nose, the picture's right is the right wing.
  const Mat3& R = read.value().camera.rig.R_body_cam;
  EXPECT_NEAR(std::atan2(R(2, 2), R(0, 2)) * 180 / 3.14159265358979, 40, 1e-6);
  EXPECT_NEAR(R(1, 0), 1, 1e-12);
  EXPECT_NEAR(R.determinant(), 1, 1e-12);
}

TEST_F(ScenarioFile, UnknownKeysAreNamedWithLineAndWhatIsAllowed) {
  const std::string e = error("[world]\nkind = \"plaza\"\nreleif_m = 3\n" + leg_);
  EXPECT_THAT(e, HasSubstr("test.toml:3: world.releif_m: is unknown"));
  EXPECT_THAT(e, HasSubstr("relief_m"));
  EXPECT_THAT(error("wrld = 3\n" + leg_), HasSubstr("test.toml:1: wrld: is unknown"));
  EXPECT_THAT(error(leg_ + "speed = 3\n"), HasSubstr("test.toml:4: flight.leg[0].speed: is unknown"));
}

TEST_F(ScenarioFile, AbsurdValuesAreRefusedWithTheirRange) {
  EXPECT_THAT(error(leg_ + "[camera]\npitch_down_deg = 200\n"),
              HasSubstr("test.toml:5: camera.pitch_down_deg: 200 is out of range; allowed: -45 to 90"));
  EXPECT_THAT(error(leg_ + "[camera]\nfx = 0\n"), HasSubstr("camera.fx: 0 is out of range"));
  EXPECT_THAT(error(leg_ + "[camera]\nfx = nan\n"), HasSubstr("camera.fx: nan is out of range"));
  EXPECT_THAT(error(leg_ + "[camera]\nwidth = 640.5\n"),
              HasSubstr("camera.width: must be a whole number from 64 to 1280"));
  EXPECT_THAT(error(leg_ + "[camera]\nfps = \"thirty\"\n"), HasSubstr("camera.fps: must be a number"));
  EXPECT_THAT(error(leg_ + "[camera]\ndistortion = [0.1, 0.2]\n"),
              HasSubstr("camera.distortion: must be a list of 5 numbers"));
  EXPECT_THAT(error(leg_ + "[camera]\ndistortion = [-1.5, 0, 0, 0, 0]\n"),
              HasSubstr("camera.distortion: folds the picture"));
  EXPECT_THAT(error(leg_ + "[camera]\nreadout_ms = 35\n"),
              HasSubstr("camera.readout_ms: is longer than the time between"));
  EXPECT_THAT(error(leg_ + "[world]\nkind = \"moon\"\n"),
              HasSubstr("world.kind: 'moon' is unknown; allowed: residential, fields, snow"));
  EXPECT_THAT(error(leg_ + "[world]\nnight = 1\n"), HasSubstr("world.night: must be true or false"));
  EXPECT_THAT(error(leg_ + "[range]\nmin_m = 9\nmax_m = 5\n"), HasSubstr("range.min_m: must be below max_m"));
  EXPECT_THAT(error(leg_ + "[world]\nground_texels = 1000\n"), HasSubstr("must be 512, 1024, 2048 or 4096"));
  EXPECT_THAT(error(leg_ + "[faults]\ngap_every_s = 1\ngap_s = 2\n"), HasSubstr("faults.gap_s: must be shorter"));
}

TEST_F(ScenarioFile, SensorFaultsAreKeysAndAbsentByDefault) {
  const rt::Result<Scenario> plain = read_scenario(write(leg_));
  ASSERT_TRUE(plain.ok());
  const ImuModel& none = plain.value().imu;
  EXPECT_EQ(none.delay_ms + none.clock_jitter_ms + none.mounting_error_deg + none.gyro_bias_ramp + none.accel_bias_ramp,
            0);
  const rt::Result<Scenario> read = read_scenario(
      write(leg_ + "[imu]\ndelay_ms = 3\nclock_jitter_ms = 0.5\nmounting_error_deg = 1.5\ngyro_bias_ramp = 1e-4\n"
                   "accel_bias_ramp = 1e-3\n[baro]\nrate_hz = 50\nnoise_pa = 3\ndelay_ms = 40\n"));
  ASSERT_TRUE(read.ok()) << read.error().message;
  EXPECT_EQ(read.value().imu.delay_ms, 3);
  EXPECT_EQ(read.value().imu.clock_jitter_ms, 0.5);
  EXPECT_EQ(read.value().imu.mounting_error_deg, 1.5);
  EXPECT_EQ(read.value().imu.gyro_bias_ramp, 1e-4);
  EXPECT_EQ(read.value().imu.accel_bias_ramp, 1e-3);
  EXPECT_EQ(read.value().baro.rate_hz, 50);
  EXPECT_EQ(read.value().baro.noise_pa, 3);
  EXPECT_EQ(read.value().baro.delay_ms, 40);
  const rt::Result<Scenario> leaning = read_scenario(write(leg_ + "[attitude]\nrate_hz = 20\nwander_deg = 3\n"));
  ASSERT_TRUE(leaning.ok()) << leaning.error().message;
  EXPECT_EQ(leaning.value().attitude.rate_hz, 20);
  EXPECT_EQ(leaning.value().attitude.wander_deg, 3);
  EXPECT_THAT(error(leg_ + "[attitude]\nwander = 5\n"), HasSubstr("attitude.wander: is unknown"));
  EXPECT_THAT(error(leg_ + "[imu]\ndelay_ms = -1\n"), HasSubstr("imu.delay_ms: -1 is out of range; allowed: 0 to 50"));
  EXPECT_THAT(error(leg_ + "[baro]\nrate = 5\n"), HasSubstr("baro.rate: is unknown"));
}

TEST_F(ScenarioFile, LegsSayWhatTheyNeed) {
  EXPECT_THAT(error("[flight]\nsway = 1\n"), HasSubstr("at least one [[flight.leg]]"));
  EXPECT_THAT(error("[[flight.leg]]\nkind = \"dash\"\nspeed_m_s = 5\n"),
              HasSubstr("flight.leg[0].distance_m: is needed here"));
  EXPECT_THAT(error("[[flight.leg]]\nkind = \"warp\"\n"), HasSubstr("'warp' is unknown; allowed: take_off"));
  EXPECT_THAT(error("[[flight.leg]]\nduration_s = 1\n"), HasSubstr("flight.leg[0].kind: is missing"));
  EXPECT_THAT(error("[[flight.leg]]\nkind = \"path\"\nspeed_m_s = 3\npoints_m = [[1, 2, 3]]\n"),
              HasSubstr("each point must be [x, y]"));
  EXPECT_THAT(error("[[flight.leg]]\nkind = \"hover\"\nduration_s = 1\nheight_m = 3\n"),
              HasSubstr("height_m: is unknown"));
}

TEST_F(ScenarioFile, AllMistakesAreToldAtOnce) {
  const std::string e = error(leg_ + "[camera]\nfps = -1\n[imu]\nrate_hz = 1\nfoo = 2\n");
  EXPECT_THAT(e, HasSubstr("camera.fps"));
  EXPECT_THAT(e, HasSubstr("imu.rate_hz"));
  EXPECT_THAT(e, HasSubstr("imu.foo"));
}

TEST_F(ScenarioFile, FilesThatAreNone) {
  EXPECT_THAT(read_scenario(folder_ / "none.toml").error().message, HasSubstr("none.toml: no such file"));
  EXPECT_THAT(read_scenario(folder_).error().message, HasSubstr("no such file"));
  EXPECT_THAT(error("[world\n"), HasSubstr("test.toml:1: not TOML"));
  EXPECT_THAT(error(std::string("\0\1\2", 3)), HasSubstr("not TOML"));
  write(leg_);
  EXPECT_THAT(find_scenario("fest", folder_).error().message, HasSubstr("no scenario 'fest'; there are: test"));
  EXPECT_TRUE(find_scenario("test", folder_).ok());
  EXPECT_THAT(find_scenario("test", folder_ / "empty").error().message, HasSubstr("holds none"));
}

TEST(Scenarios, ThereAreAllFourteen) {
  EXPECT_THAT(list_scenarios(GODWIT_SCENARIO_DIR),
              testing::IsSupersetOf({"street", "survey", "corridor", "take-off-and-land", "hover-in-crowd", "night",
                                     "glare", "flicker-100hz", "low-texture", "half-the-picture-moving", "vibration",
                                     "dropped-frames", "rangefinder-jumps", "gnss-loss"}));
}

}  // namespace
}  // namespace godwit::sim
