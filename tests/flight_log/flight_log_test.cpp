// What the flight log leaves on a disc that is well, full, forbidden or planted with traps. Files are read here by
// their framing alone; pyulog reads the fields (pyulog_test.py).
#include "firmware_app/output/flight_log.h"

#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <limits>
#include <map>
#include <sys/resource.h>
#include <unistd.h>

#include "hal/rt/time.h"
#include "tests/support/standing_thread.h"
#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace {
namespace fs = std::filesystem;

using test::TempFolder;

FlightLogOptions options(const fs::path& folder) {
  FlightLogOptions o;
  o.folder = folder.string();
  o.machine = false;
  o.info = {{"ver_sw", "test"}};
  return o;
}

FrameRecord frame(std::uint32_t i) {
  FrameRecord r;
  r.sequence = i;
  r.t_capture_ns = (i + 1) * 33 * rt::kNsPerMs;
  r.has_pose = r.tracked = i % 2 == 0;
  r.mapping.messages = i % 3 == 0 ? 1 : 0;
  return r;
}

std::vector<fs::path> files(const fs::path& folder) {
  std::vector<fs::path> out;
  for (const auto& entry : fs::directory_iterator(folder)) {
    if (entry.path().extension() == ".ulg") out.push_back(entry.path());
  }
  std::sort(out.begin(), out.end());
  return out;
}

/// Messages of each type in a file that must consist of whole messages to its last byte; samples must be as long as
/// their formats say.
std::map<char, int> messages(const fs::path& file) {
  const std::string bytes = test::read_file(file);
  std::map<char, int> count;
  EXPECT_GT(bytes.size(), 16u) << file;
  EXPECT_EQ(bytes.substr(0, 4), "ULog");
  std::size_t at = 16;
  while (at + 3 <= bytes.size()) {
    std::uint16_t size = 0;
    std::memcpy(&size, bytes.data() + at, 2);
    ++count[bytes[at + 2]];
    at += 3 + size;
  }
  EXPECT_EQ(at, bytes.size()) << file << " ends within a message";
  return count;
}

TEST(FlightLog, HoldsEveryFrameAndEvent) {
  const TempFolder folder;
  FlightLog log(options(folder.path() / "flights"));
  for (std::uint32_t i = 0; i < 60; ++i) log.frame(frame(i));
  rt::LogEntry entry;
  entry.what = "something";
  log.event(entry);
  const FlightLogReport report = log.finish(60 * rt::kNsPerSecond);
  EXPECT_EQ(report.dropped, 0u);
  EXPECT_EQ(report.trouble, "");
  const auto found = files(folder.path() / "flights");
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].filename(), "000001.ulg");
  auto count = messages(found[0]);
  EXPECT_EQ(fs::file_size(found[0]), report.written_bytes);
  // 60 frames, 30 poses, 20 of the mapper, the end; the log's own figures come once a second.
  EXPECT_GE(count['D'], 111);
  EXPECT_LE(count['D'], 111 + 60);
  EXPECT_EQ(count['L'], 1);
  EXPECT_EQ(count['F'], 12);
  EXPECT_EQ(count['A'], 12);
}

TEST(FlightLog, EachFlightHasAFileOfItsOwn) {
  const TempFolder folder;
  for (int flight = 0; flight < 3; ++flight) {
    FlightLog log(options(folder.path()));
    log.frame(frame(0));
    EXPECT_EQ(log.finish(60 * rt::kNsPerSecond).files, 1u);
  }
  EXPECT_EQ(files(folder.path()).size(), 3u);
}

TEST(FlightLog, BeginsANewFileAndGivesUpTheOldest) {
  const TempFolder folder;
  FlightLogOptions o = options(folder.path());
  o.file_bytes = 100'000;
  o.budget_bytes = 350'000;
  std::ofstream(folder.path() / "000007.ulg") << std::string(1000, 'x');
  std::ofstream(folder.path() / "notes.txt") << "keep";
  FlightLog log(o);
  FlightLogReport report;
  for (std::uint32_t i = 0; report.files < 6 && i < 100'000; ++i) {
    log.frame(frame(i));
    if (i % 100 == 0) usleep(1000);
    report = log.report();
  }
  report = log.finish(60 * rt::kNsPerSecond);
  ASSERT_GE(report.files, 6u);
  const auto left = files(folder.path());
  EXPECT_TRUE(fs::exists(folder.path() / "notes.txt"));
  EXPECT_FALSE(fs::exists(folder.path() / "000007.ulg"));
  EXPECT_EQ(left.back().filename(), "00000" + std::to_string(7 + report.files).substr(0, 1) + ".ulg")
      << "counted on from the highest number";
  std::uintmax_t sum = 0;
  for (const auto& file : left) sum += fs::file_size(file);
  // A file ends with the chunk that fills it: at most the buffer more.
  EXPECT_LE(sum, o.budget_bytes + o.buffer_bytes);
  for (const auto& file : left) messages(file);
}

TEST(FlightLog, AFullDiscLeavesWholeMessagesAndIsCounted) {
  const TempFolder folder;
  signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  const rlimit small{20'000, before.rlim_max};
  FlightLogReport report;
  {
    FlightLog log(options(folder.path()));
    ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
    for (std::uint32_t i = 0; report.dropped == 0 && i < 5000; ++i) {
      log.frame(frame(i));
      usleep(2000);
      report = log.report();
    }
    report = log.finish(60 * rt::kNsPerSecond);
  }
  setrlimit(RLIMIT_FSIZE, &before);
  EXPECT_GT(report.dropped, 0u);
  EXPECT_THAT(report.trouble, testing::HasSubstr("cannot be written"));
  for (const auto& file : files(folder.path())) messages(file);
}

// A disc that takes nothing for a while: what finds no room is counted and told where it is missing, nobody waits, and
// the memory is bounded.
TEST(FlightLog, ADiscThatStandsCostsMessagesThatAreCountedAndTold) {
  const TempFolder folder;
  FlightLogOptions o = options(folder.path());
  o.buffer_bytes = 50'000;
  FlightLog log(o);
  std::uint64_t put = 0;
  const auto log_frame = [&] { log.frame(frame(static_cast<std::uint32_t>(put++))); };
  for (int i = 0; log.report().files == 0 && i < 10'000; ++i) {
    log_frame();
    usleep(1000);
  }
  ASSERT_EQ(log.report().files, 1u);
  test::stop_thread("gw-flightlog");
  const std::uint64_t before = put;
  while (log.report().dropped == 0 && put < before + 5000) log_frame();
  const std::uint64_t kept = put - before;
  EXPECT_LT(kept, o.buffer_bytes / 50) << "a frame has more than 50 bytes";
  for (int i = 0; i < 500; ++i) log_frame();
  EXPECT_GE(log.report().dropped, 500u);
  const std::uint64_t written = log.report().written_bytes;
  test::let_thread_go();
  for (int i = 0; log.report().written_bytes == written && i < 30'000; ++i) usleep(1000);
  // The first that finds room again tells: what was written first may have made too little.
  for (std::uint64_t i = 0, dropped = 0; i < 30'000; ++i) {
    dropped = log.report().dropped;
    log_frame();
    if (log.report().dropped == dropped) break;
    usleep(1000);
  }
  const FlightLogReport report = log.finish(60 * rt::kNsPerSecond);
  EXPECT_EQ(report.files, 1u);
  EXPECT_EQ(report.trouble, "");
  auto count = messages(files(folder.path()).front());
  EXPECT_GE(count['O'], 1) << "says where messages are missing";
  // Frames, poses and the mapper's figures, all that were put: in the file or counted.
  const std::uint64_t all = put + (put + 1) / 2 + (put + 2) / 3;
  EXPECT_GE(static_cast<std::uint64_t>(count['D']) + report.dropped, all);
}

TEST(FlightLog, LeavesRoomOnTheDiscForOthers) {
  const TempFolder folder;
  FlightLogOptions o = options(folder.path());
  // No disc has more free than it is large.
  o.room.leave_bytes = std::numeric_limits<std::size_t>::max();
  o.room.leave_share = 1;
  FlightLog log(o);
  log.frame(frame(0));
  const FlightLogReport report = log.finish(60 * rt::kNsPerSecond);
  EXPECT_EQ(report.files, 0u);
  EXPECT_GE(report.dropped, 3u) << "a frame, its pose and the mapper's figures";
  EXPECT_TRUE(files(folder.path()).empty());
  EXPECT_THAT(report.trouble, testing::HasSubstr("nearly full"));
}

TEST(FlightLog, AFolderThatCannotBeMadeCostsTheLogAlone) {
  const TempFolder folder;
  FlightLog log(options(folder.path() / "not" / "there"));
  for (std::uint32_t i = 0; i < 10; ++i) log.frame(frame(i));
  const FlightLogReport report = log.finish(60 * rt::kNsPerSecond);
  EXPECT_EQ(report.written_bytes, 0u);
  EXPECT_GE(report.dropped, 10u);
  EXPECT_THAT(report.trouble, testing::HasSubstr("a file cannot be made"));
}

TEST(FlightLog, GoesOnWhenTheFolderIsThereAtLast) {
  const TempFolder folder;
  const fs::path late = folder.path() / "late";
  FlightLog log(options(late / "flights"));
  FlightLogReport report;
  for (std::uint32_t i = 0; report.dropped == 0 && i < 10'000; ++i) {
    log.frame(frame(i));
    usleep(1000);
    report = log.report();
  }
  fs::create_directory(late);
  for (std::uint32_t i = 0; report.files == 0 && i < 10'000; ++i) {
    log.frame(frame(i));
    usleep(1000);
    report = log.report();
  }
  log.finish(60 * rt::kNsPerSecond);
  const auto found = files(late / "flights");
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(messages(found[0])['O'], 1) << "says for how long nothing was written";
}

TEST(FlightLog, FollowsNoPlantedLink) {
  const TempFolder folder;
  std::ofstream(folder.path() / "victim") << "precious";
  fs::create_symlink(folder.path() / "victim", folder.path() / "000001.ulg");
  FlightLog log(options(folder.path()));
  log.frame(frame(0));
  log.finish(60 * rt::kNsPerSecond);
  EXPECT_EQ(test::read_file(folder / "victim"), "precious");
  EXPECT_TRUE(fs::exists(folder.path() / "000002.ulg"));
}

}  // namespace
}  // namespace godwit::app
