// Of which sources a program says it is made.
#include "firmware_app/config/version.h"

#include <gtest/gtest.h>

#include "firmware_app/config/link_settings.h"

namespace godwit::app {
namespace version_test {

TEST(Version, WordsSayTheCommitAndWhetherFilesDifferFromIt) {
  EXPECT_EQ(version_words({"0.1.0", "5cbb52e0a1b2", false}), "0.1.0 (commit 5cbb52e0a1b2)");
  EXPECT_EQ(version_words({"0.1.0", "5cbb52e0a1b2", true}), "0.1.0 (commit 5cbb52e0a1b2-dirty)");
  EXPECT_EQ(version_words({"0.1.0", "unknown", false}), "0.1.0 (commit unknown)");
}

TEST(Version, TheBusHearsItInFigures) {
  const Version v{"12.34.5", "5cbb52e0a1b2", false};
  EXPECT_EQ(vcs_commit(v), 0x5cbb52e0u);
  EXPECT_EQ(major_of(v), 12);
  EXPECT_EQ(minor_of(v), 34);
  EXPECT_EQ(vcs_commit({"0.1.0", "unknown", false}), 0u) << "then GetNodeInfo says that there is none";
  const link::dronecan::NodeIdentity identity = link_settings(Config{}, std::nullopt).link.identity;
  EXPECT_EQ(identity.vcs_commit, vcs_commit(version()));
  EXPECT_EQ(identity.software_major, major_of(version()));
  EXPECT_EQ(identity.software_minor, minor_of(version()));
}

}  // namespace version_test
}  // namespace godwit::app
