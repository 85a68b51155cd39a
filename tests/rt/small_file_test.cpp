#include "hal/rt/small_file.h"

#include <fstream>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include "tests/support/temp_folder.h"

namespace godwit::rt {
namespace {

TEST(SmallFile, IsReadWholeAndNothingElseIs) {
  const test::TempFolder folder;
  std::ofstream(folder.path() / "some") << "twelve bytes";
  EXPECT_EQ(read_small_file(folder / "some", 12).value(), "twelve bytes");
  EXPECT_NE(read_small_file(folder / "some", 11).error().message.find("larger than 11 bytes"), std::string::npos);
  std::ofstream(folder.path() / "empty").flush();
  EXPECT_EQ(read_small_file(folder / "empty", 12).value(), "");
  ASSERT_EQ(mkfifo((folder / "pipe").c_str(), 0600), 0);
  EXPECT_FALSE(read_small_file(folder / "pipe", 12).ok()) << "and nobody waits for a writer";
  EXPECT_FALSE(read_small_file(folder.path(), 12).ok());
  EXPECT_FALSE(read_small_file("/dev/zero", 12).ok());
  EXPECT_FALSE(read_small_file(folder / "none", 12).ok());
}

}  // namespace
}  // namespace godwit::rt
