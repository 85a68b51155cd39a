#include "hal/imu/replay/imu_record.h"

#include <cstdlib>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/temp_folder.h"

namespace godwit::hal::imu_record_test {
namespace {

using testing::HasSubstr;

constexpr const char* kAsl =
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y,w_RS_S_z,a_RS_S_x [m s^-2],a_RS_S_y,a_RS_S_z\n"
    "1403636579758555392,-0.099134701513277898,0.14730578886832138,0.02722713633111154,8.1476917083333333,"
    "-0.37592158333333331,-2.4026292499999999\n"
    "1403636579763555392,1e-3,0.2, 0.3 ,8,-0.5,-2.4\r\n";

TEST(ImuRecord, ReadsTheAslForm) {
  const auto r = parse_euroc_imu(kAsl, "data.csv");
  ASSERT_TRUE(r.ok()) << r.error().message;
  ASSERT_EQ(r.value().samples.size(), 2u);
  const ImuSample& first = r.value().samples[0];
  EXPECT_EQ(first.t_ns, 1403636579758555392);
  EXPECT_EQ(first.gyro_rad_s[0], -0.099134701513277898);
  EXPECT_EQ(first.accel_m_s2[2], -2.4026292499999999);
  EXPECT_EQ(r.value().samples[1].gyro_rad_s[2], 0.3);
  EXPECT_NEAR(r.value().rate_hz, 200, 1e-9);
}

TEST(ImuRecord, ReadsTheTextForm) {
  const auto r = parse_tum_imu("# t w a\n1403636582.768555392 -0.1 0.17 0.18 8.5 0.19 -3.2\n", "imu.txt");
  ASSERT_TRUE(r.ok()) << r.error().message;
  ASSERT_EQ(r.value().samples.size(), 1u);
  EXPECT_EQ(r.value().samples[0].t_ns, 1403636582768555392);
  EXPECT_EQ(r.value().samples[0].accel_m_s2[0], 8.5);
  EXPECT_EQ(r.value().rate_hz, 0) << "one sample has no rate";
}

TEST(ImuRecord, ALineThatCannotBeReadIsToldWithItsPlace) {
  const auto reason = [](const std::string& line) {
    const auto r = parse_euroc_imu("# head\n" + line + "\n", "data.csv");
    return r.ok() ? std::string("read") : r.error().message;
  };
  EXPECT_THAT(reason("12.5,0,0,0,0,0,0"), HasSubstr("data.csv:2: '12.5' is not a time in whole nanoseconds"));
  EXPECT_THAT(reason("12,0,0,0,0,0"), HasSubstr("'' is not an acceleration in m/s^2"));
  EXPECT_THAT(reason("12,0,x,0,0,0,0"), HasSubstr("'x' is not a rate in rad/s"));
  EXPECT_THAT(reason("12,0,nan,0,0,0,0"), HasSubstr("'nan' is not a rate"));
  EXPECT_THAT(reason("12,0,inf,0,0,0,0"), HasSubstr("'inf' is not a rate"));
  EXPECT_THAT(reason("12,0,0,180,0,0,0"), HasSubstr("at most 100")) << "degrees";
  EXPECT_THAT(reason("12,0,0,0,0,0,0,7"), HasSubstr("more than six readings: '7'"));
  EXPECT_THAT(parse_tum_imu("# nothing\n", "imu.txt").error().message, HasSubstr("imu.txt: holds no samples"));
}

TEST(ImuRecord, ARecordThatBreaksOffIsReadUpToThere) {
  const auto r = parse_euroc_imu("# head\n12,0,0,0,0,0,0\n13,0,0,0,0,0,0\n14,0,0,0", "data.csv");
  ASSERT_TRUE(r.ok()) << r.error().message;
  EXPECT_EQ(r.value().samples.size(), 2u);
  EXPECT_THAT(r.value().cut_off, HasSubstr("data.csv:4: '' is not an acceleration"));
  EXPECT_THAT(r.value().cut_off, HasSubstr("breaks off there, what comes before is used"));
}

TEST(ImuRecord, TimesThatRepeatOrGoBackAreLeftOutAndCounted) {
  const auto r = parse_tum_imu("1.0 0 0 0 0 0 0\n1.0 0 0 0 0 0 0\n0.5 0 0 0 0 0 0\n1.1 0 0 0 0 0 0\n", "imu.txt");
  ASSERT_TRUE(r.ok());
  EXPECT_EQ(r.value().samples.size(), 2u);
  EXPECT_EQ(r.value().time_repeated, 2u);
  EXPECT_THAT(
      r.value().warnings("here"),
      testing::ElementsAre("here: 2 of 4 inertial readings are no later than the one before: left out; the first is "
                           "line 2"));
}

// One wrong stamp, and all that came after it was left out up to that time.
TEST(ImuRecord, AReadingStampedFarAheadIsTheOneThatIsLeftOut) {
  for (const int wrong : {0, 3, 7}) {
    std::string text = "# head\n";
    for (int i = 0; i < 8; ++i)
      text += std::to_string(i + (i == wrong ? 100 : 0)) + ".5 " + std::to_string(i) + " 0 0 0 0 9.8\n";
    const auto r = parse_tum_imu(text, "imu.txt");
    ASSERT_TRUE(r.ok());
    // After the last nothing speaks against it.
    ASSERT_EQ(r.value().samples.size(), wrong < 7 ? 7u : 8u) << wrong;
    EXPECT_EQ(r.value().time_repeated, 0u) << wrong;
    if (wrong == 7) continue;
    EXPECT_EQ(r.value().ahead_line, wrong + 2);
    EXPECT_THAT(r.value().warnings("here"),
                testing::ElementsAre("here: 1 inertial readings are stamped more than a second ahead of those around: "
                                     "left out; the first is line " +
                                     std::to_string(wrong + 2)));
  }
}

TEST(ImuRecord, ReadingsThatNeverChangeAreTold) {
  std::string text;
  for (int i = 0; i < 40; ++i)
    text += std::to_string(i) + (i < 15 ? " 0 0 " + std::to_string(i) : " 1 2 3") + " 0 0 9.8\n";
  const auto r = parse_tum_imu(text, "imu.txt");
  ASSERT_TRUE(r.ok()) << r.error().message;
  EXPECT_EQ(r.value().samples.size(), 40u) << "what they are good for others decide";
  EXPECT_EQ(r.value().stuck, 6u);
  EXPECT_THAT(r.value().warnings("here"),
              testing::ElementsAre("here: the inertial sensor is stuck in 6 of 40 readings"));
}

TEST(ImuRecord, IsFoundWhereverACameraIs) {
  const test::TempFolder folder;
  EXPECT_THAT(read_imu_record(folder.path()).error().message, HasSubstr("no IMU: neither imu.txt nor"));
  test::write_file(folder / "mav0/imu0/data.csv", kAsl);
  std::filesystem::create_directories(folder.path() / "mav0/cam0");
  for (const char* place : {"", "mav0", "mav0/cam0"}) {
    const auto r = read_imu_record(folder / place);
    ASSERT_TRUE(r.ok()) << place << ": " << r.error().message;
    EXPECT_EQ(r.value().samples.size(), 2u) << place;
  }
  test::write_file(folder / "imu.txt", "1.0 0 0 0 0 0 0\n");
  EXPECT_EQ(read_imu_record(folder.path()).value().samples.size(), 1u) << "beside rgb.txt";
}

TEST(ImuRecord, ARealOneIsWhole) {
  const char* const shared = std::getenv("GODWIT_SHARED_DIR");
  const std::string folder = std::string(shared != nullptr ? shared : "") + "/data/euroc_mh01";
  const char* const ci = std::getenv("CI");
  if (!std::filesystem::exists(folder)) {
    if (ci != nullptr && std::string(ci) == "true") FAIL() << folder << " is not there";
    GTEST_SKIP() << folder << " is not there";
  }
  const auto r = read_imu_record(folder);
  ASSERT_TRUE(r.ok()) << r.error().message;
  EXPECT_EQ(r.value().samples.size(), 6790u);
  EXPECT_EQ(r.value().time_repeated, 0u);
  EXPECT_NEAR(r.value().rate_hz, 200, 0.01);
}

}  // namespace
}  // namespace godwit::hal::imu_record_test
