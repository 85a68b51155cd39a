// What an event is on a disc that is well, full, forbidden, planted with traps, or left behind by a program that died.
#include "firmware_app/output/event_folder.h"

#include <csignal>
#include <fcntl.h>
#include <filesystem>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <limits>
#include <sys/file.h>
#include <sys/resource.h>
#include <unistd.h>

#include "hal/camera/replay/replay_camera.h"
#include "hal/imu/replay/imu_record.h"
#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace {
namespace fs = std::filesystem;
using testing::HasSubstr;

constexpr int kWidth = 96, kHeight = 64;
constexpr std::uint64_t kPictures = 6;

/// Pictures with their number in every pixel.
struct Pictures {
  std::vector<std::uint8_t> pixels = std::vector<std::uint8_t>(static_cast<std::size_t>(kWidth) * kHeight);
  std::pair<rt::FrameMeta, rt::ImageView> operator()(std::uint64_t n) {
    std::fill(pixels.begin(), pixels.end(), static_cast<std::uint8_t>(n));
    rt::FrameMeta meta;
    meta.t_capture_ns = 5'000'000'000 + static_cast<rt::TimeNs>(n) * 33'000'000;
    meta.sequence = static_cast<std::uint32_t>(2 * n);
    return {meta, {pixels.data(), kWidth, kHeight, kWidth}};
  }
};

EventFolders::Options options(const std::string& folder) {
  EventFolders::Options o;
  o.folder = folder;
  o.budget_bytes = 100'000'000;
  o.calibration =
      "model: pinhole\nwidth: 96\nheight: 64\nfx: 90\nfy: 90\ncx: 48\ncy: 32\ndistortion_model: none\ndistortion: []\n";
  o.info = {{"version", "1.2.3"}, {"configuration", "[camera]\n"}};
  return o;
}

const std::vector<hal::ImuSample>& samples() {
  static const std::vector<hal::ImuSample> some = [] {
    std::vector<hal::ImuSample> out(20);
    for (std::size_t i = 0; i < out.size(); ++i) {
      out[i].t_ns = 5'000'000'000 + static_cast<rt::TimeNs>(i) * 10'000'000;
      out[i].gyro_rad_s = {0.1 / 3, 0, -0.5};
      out[i].accel_m_s2 = {0, 0, -9.81};
    }
    return out;
  }();
  return some;
}

EventFolders::Event event(EventKind kind = EventKind::kLoss) {
  EventFolders::Event e;
  e.causes = {{kind, 5'100'000'000, "why \"so\""}};
  e.end = kPictures;
  e.most_bytes = kPictures * kWidth * kHeight;
  e.samples = &samples();
  return e;
}

rt::Result<std::string> write(EventFolders* folders, const EventFolders::Event& e) {
  return folders->write(e, Pictures(), [](std::uint64_t) { return true; });
}

std::vector<std::string> names(const fs::path& folder) {
  std::vector<std::string> out;
  for (const auto& entry : fs::directory_iterator(folder)) out.push_back(entry.path().filename());
  std::sort(out.begin(), out.end());
  return out;
}

TEST(EventFolders, AnEventIsASequenceThatCanBeReplayed) {
  const test::TempFolder folder;
  EventFolders folders(options(folder / "events"));
  const auto written = write(&folders, event());
  ASSERT_TRUE(written.ok()) << written.error().message;
  EXPECT_EQ(written.value(), folder / "events/000001-loss");
  auto replay = hal::ReplayCamera::open(written.value(), {});
  ASSERT_TRUE(replay.ok()) << replay.error().message;
  EXPECT_EQ(replay.value()->total(), static_cast<std::int64_t>(kPictures));
  std::vector<std::uint8_t> pixels(static_cast<std::size_t>(kWidth) * kHeight);
  for (std::uint64_t n = 0; n < kPictures; ++n) {
    hal::CapturedFrame frame;
    std::string why;
    ASSERT_EQ(replay.value()->next({pixels.data(), kWidth, kHeight, kWidth}, nullptr, 0, &frame, &why),
              hal::CameraStatus::kFrame)
        << why;
    EXPECT_EQ(frame.t_source_ns, 5'000'000'000 + static_cast<rt::TimeNs>(n) * 33'000'000);
    EXPECT_EQ(pixels, std::vector<std::uint8_t>(pixels.size(), static_cast<std::uint8_t>(n)));
  }
  const auto record = hal::read_imu_record(written.value());
  ASSERT_TRUE(record.ok()) << record.error().message;
  ASSERT_EQ(record.value().samples.size(), samples().size());
  EXPECT_EQ(record.value().samples[3].gyro_rad_s, samples()[3].gyro_rad_s) << "to the bit";
  const std::string about = test::read_file(written.value() + "/event.json");
  for (const char* part : {"\"kind\": \"loss\"", "\"t_ns\": 5100000000", "why \\\"so\\\"", "\"version\": \"1.2.3\"",
                           "\"pictures\": 6", "\"pictures_missing\": 5", "\"samples\": 20"}) {
    EXPECT_THAT(about, HasSubstr(part));
  }
  EXPECT_EQ(test::read_file(written.value() + "/configuration.toml"), "[camera]\n");
  EXPECT_EQ(write(&folders, event(EventKind::kRequest)).value(), folder / "events/000002-request");
}

TEST(EventFolders, TheOldestMakeWayForTheBudget) {
  const test::TempFolder folder;
  EventFolders::Options o = options(folder / "events");
  fs::create_directories(folder.path() / "events" / "000001-notes");
  fs::create_directory_symlink(folder.path(), folder.path() / "events" / "000002-loss");
  std::uintmax_t one = 0;
  {
    EventFolders folders(o);
    const auto first = write(&folders, event());
    ASSERT_TRUE(first.ok()) << first.error().message;
    for (const auto& entry : fs::recursive_directory_iterator(first.value())) {
      if (entry.is_regular_file()) one += entry.file_size();
    }
    EXPECT_THAT(first.value(), HasSubstr("000003-loss")) << "a number that is there is not given again";
  }
  o.budget_bytes = event().most_bytes + 2 * one;
  EventFolders folders(o);
  for (int i = 0; i < 4; ++i) ASSERT_TRUE(write(&folders, event()).ok());
  EXPECT_EQ(names(folder / "events"),
            (std::vector<std::string>{"000001-notes", "000002-loss", "000005-loss", "000006-loss", "000007-loss"}))
      << "what is not ours stays";
  o.budget_bytes = 1000;
}

TEST(EventFolders, AnEventLargerThanAllAreAllowedIsRefused) {
  const test::TempFolder folder;
  EventFolders::Options o = options(folder / "events");
  o.budget_bytes = 1000;
  EventFolders folders(o);
  const auto written = write(&folders, event());
  ASSERT_FALSE(written.ok());
  EXPECT_THAT(written.error().message, HasSubstr("all of them are allowed"));
}

TEST(EventFolders, AFullDiscLeavesNothingHalf) {
  const test::TempFolder folder;
  signal(SIGXFSZ, SIG_IGN);
  EventFolders folders(options(folder / "events"));
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  const rlimit small{300, before.rlim_max};  // the list of readings is larger, a picture of one grey is not
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  const auto written = write(&folders, event());
  setrlimit(RLIMIT_FSIZE, &before);
  ASSERT_FALSE(written.ok());
  EXPECT_THAT(written.error().message, HasSubstr("cannot be written"));
  EXPECT_TRUE(names(folder / "events").empty());
  EXPECT_TRUE(write(&folders, event()).ok()) << "and the next one is";
}

TEST(EventFolders, ADiscThatIsNearlyFullIsLeftAlone) {
  const test::TempFolder folder;
  EventFolders::Options o = options(folder / "events");
  o.room.leave_bytes = std::numeric_limits<std::size_t>::max();
  o.room.leave_share = 1;
  EventFolders folders(o);
  const auto written = write(&folders, event());
  ASSERT_FALSE(written.ok());
  EXPECT_THAT(written.error().message, HasSubstr("nearly full"));
  EXPECT_TRUE(names(folder / "events").empty());
}

TEST(EventFolders, AFolderThatCannotBeMadeIsTold) {
  EventFolders folders(options("/proc/no/such"));
  const auto written = write(&folders, event());
  ASSERT_FALSE(written.ok());
  EXPECT_THAT(written.error().message, HasSubstr("/proc/no/such: cannot be made"));
}

TEST(EventFolders, WhoGivesUpLeavesNothingHalf) {
  const test::TempFolder folder;
  EventFolders folders(options(folder / "events"));
  const auto written = folders.write(event(), Pictures(), [](std::uint64_t n) { return n < 2; });
  ASSERT_FALSE(written.ok());
  EXPECT_TRUE(names(folder / "events").empty());
}

TEST(EventFolders, WhatADeadProgramBeganGoesAndAnotherPlaceIsLeftAlone) {
  const test::TempFolder folder;
  fs::create_directories(folder.path() / "events" / "000004-loss.part" / "mav0");
  fs::create_directories(folder.path() / "events" / "mine.part");
  const int other = open((folder / "events").c_str(), O_RDONLY | O_DIRECTORY);
  ASSERT_EQ(flock(other, LOCK_EX), 0);
  EventFolders folders(options(folder / "events"));
  const auto refused = write(&folders, event());
  ASSERT_FALSE(refused.ok());
  EXPECT_THAT(refused.error().message, HasSubstr("another program"));
  close(other);
  ASSERT_TRUE(write(&folders, event()).ok());
  EXPECT_EQ(names(folder / "events"), (std::vector<std::string>{"000001-loss", "mine.part"}));
}

}  // namespace
}  // namespace godwit::app
