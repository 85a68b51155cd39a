#include "hal/atomic_file.h"

#include <atomic>
#include <filesystem>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <string>
#include <sys/stat.h>
#include <thread>
#include <utility>
#include <vector>

#include "hal/rt/time.h"
#include "tests/support/file_size_limit.h"
#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace atomic_file_test {

using test::FileSizeLimit;
using test::read_file;
using test::TempFolder;
using test::write_file;
using testing::HasSubstr;
namespace fs = std::filesystem;

TEST(AtomicFile, AppearsOnlyWhenWhole) {
  const TempFolder folder;
  hal::AtomicFile file;
  ASSERT_TRUE(file.open(folder / "a.txt").ok());
  ASSERT_TRUE(file.write("hello\n").ok());
  EXPECT_FALSE(fs::exists(folder / "a.txt"));
  ASSERT_TRUE(file.commit().ok());
  EXPECT_EQ(read_file(folder / "a.txt"), "hello\n");
  EXPECT_FALSE(fs::exists(folder / "a.txt.part"));
}

TEST(AtomicFile, TwoRunsDoNotMixAndALinkIsNotFollowed) {
  const TempFolder folder;
  hal::AtomicFile first, second, third;
  ASSERT_TRUE(first.open(folder / "a").ok());
  const auto refused = second.open(folder / "a");
  ASSERT_FALSE(refused.ok());
  EXPECT_THAT(refused.error().message, HasSubstr("another run writes it"));
  ASSERT_TRUE(first.write("whole").ok());
  ASSERT_TRUE(first.commit().ok());
  EXPECT_EQ(read_file(folder / "a"), "whole");
  write_file(folder / "b.part", "left by a run that was killed");
  ASSERT_TRUE(second.open(folder / "b").ok());
  ASSERT_TRUE(second.commit().ok());
  EXPECT_EQ(read_file(folder / "b"), "");
  write_file(folder / "victim", "precious");
  fs::create_symlink(folder / "victim", folder / "c.part");
  ASSERT_TRUE(third.open(folder / "c").ok());
  ASSERT_TRUE(third.write("own").ok());
  ASSERT_TRUE(third.commit().ok());
  EXPECT_EQ(read_file(folder / "victim"), "precious");
  EXPECT_EQ(read_file(folder / "c"), "own");
  EXPECT_FALSE(fs::is_symlink(folder / "c"));
}

TEST(AtomicFile, AnotherNameOfAFileLaidThereCostsThatFileNothing) {
  const TempFolder folder;
  write_file(folder / "victim", "precious");
  fs::create_hard_link(folder / "victim", folder / "a.part");
  hal::AtomicFile file;
  ASSERT_TRUE(file.open(folder / "a").ok());
  ASSERT_TRUE(file.write("own").ok());
  ASSERT_TRUE(file.commit().ok());
  EXPECT_EQ(read_file(folder / "victim"), "precious");
  EXPECT_EQ(read_file(folder / "a"), "own");
}

TEST(AtomicFile, WhoBeginsAsAnotherEndsEmptiesNothing) {
  const TempFolder folder;
  const std::string whole(1000, 'x'), name = folder / "a";
  std::atomic<bool> done{false};
  std::vector<std::thread> beginners;
  beginners.reserve(4);
  for (int i = 0; i < 4; ++i) {
    beginners.emplace_back([&] {
      while (!done) static_cast<void>(hal::AtomicFile().open(name));
    });
  }
  const rt::TimeNs give_up_ns = rt::monotonic_now_ns() + 3 * rt::kNsPerSecond;
  int committed = 0, cut_short = 0;
  while (rt::monotonic_now_ns() < give_up_ns) {
    hal::AtomicFile file;
    if (!file.open(name).ok()) continue;
    if (!file.write(whole).ok() || !file.commit().ok()) continue;
    ++committed;
    for (int look = 0; look < 20; ++look) cut_short += fs::file_size(name) != whole.size() ? 1 : 0;
  }
  done = true;
  for (std::thread& beginner : beginners) beginner.join();
  EXPECT_GT(committed, 0);
  EXPECT_EQ(cut_short, 0);
}

// As root, --json /dev/full put a plain file in the place of the machine's own.
TEST(AtomicFile, DevicesPipesAndFoldersStayWhatTheyAre) {
  const TempFolder folder;
  ASSERT_EQ(mkfifo((folder / "pipe").c_str(), 0600), 0);
  fs::create_symlink("/dev/null", folder / "device");
  fs::create_directory(folder / "folder");
  const std::pair<const char*, const char*> cases[] = {
      {"pipe", "is no plain file"}, {"device", "is no plain file"}, {"folder", "is a folder"}};
  for (const auto& [name, why] : cases) {
    hal::AtomicFile file;
    const auto opened = file.open(folder / name);
    ASSERT_FALSE(opened.ok()) << name;
    EXPECT_THAT(opened.error().message, HasSubstr(std::string(name) + ": " + why));
    EXPECT_FALSE(fs::exists(folder / (std::string(name) + ".part")));
  }
  EXPECT_TRUE(fs::is_fifo(folder / "pipe"));
  EXPECT_TRUE(fs::is_symlink(folder / "device"));
}

TEST(AtomicFile, LeavesNothingWhenAbandoned) {
  const TempFolder folder;
  {
    hal::AtomicFile file;
    ASSERT_TRUE(file.open(folder / "a.txt").ok());
    ASSERT_TRUE(file.write("half").ok());
  }
  EXPECT_TRUE(fs::is_empty(folder.path()));
}

TEST(AtomicFile, AFullDiskIsToldAndLeavesNothing) {
  const TempFolder folder;
  hal::AtomicFile file;
  ASSERT_TRUE(file.open(folder / "a.txt").ok());
  std::string error;
  {
    const FileSizeLimit limit(10'000);
    const std::string block(4096, 'x');
    for (int i = 0; i < 100 && error.empty(); ++i) {
      const auto written = file.write(block);
      if (!written.ok()) error = written.error().message;
    }
  }
  EXPECT_THAT(error, HasSubstr("a.txt: cannot be written: File too large"));
  EXPECT_TRUE(fs::is_empty(folder.path()));
}

TEST(AtomicFile, AFailureInTheLastFlushIsTold) {
  const TempFolder folder;
  hal::AtomicFile file;
  ASSERT_TRUE(file.open(folder / "a.txt").ok());
  ASSERT_TRUE(file.write("buffered").ok()) << "still in memory";
  const FileSizeLimit limit(3);
  const auto committed = file.commit();
  ASSERT_FALSE(committed.ok());
  EXPECT_THAT(committed.error().message, HasSubstr("cannot be written"));
  EXPECT_TRUE(fs::is_empty(folder.path()));
}

}  // namespace atomic_file_test
}  // namespace godwit::app
