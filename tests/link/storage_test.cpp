// What the link keeps over a restart: reset counter, parameters, one owner of the folder.
#include "firmware_app/link/storage.h"

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <gtest/gtest.h>
#include <string>
#include <sys/stat.h>

#include "firmware_app/link/saved_parameters.h"
#include "hal/rt/time.h"

namespace godwit::link {
namespace storage_test {

class StorageTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (std::filesystem::temp_directory_path() / "godwit-link-XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder = name;
  }
  void TearDown() override { std::filesystem::remove_all(folder); }
  bool save(Storage& storage, const StorageRequest& request) {
    EXPECT_TRUE(storage.request(request));
    storage.serve();
    StorageReply reply;
    EXPECT_TRUE(storage.reply(&reply));
    EXPECT_EQ(reply.ticket, request.ticket);
    return reply.ok;
  }
  std::string folder;
};

TEST_F(StorageTest, KeepsAndErases) {
  Storage storage(folder);
  auto fresh = storage.load(fallback_values());
  ASSERT_TRUE(fresh.ok());
  EXPECT_FALSE(fresh.value().has_parameters);
  EXPECT_EQ(fresh.value().reset_counter, 0);
  StorageRequest request;
  request.ticket = 5;
  request.parameters = fallback_values();
  request.parameters[0] = 33;
  EXPECT_TRUE(save(storage, request));
  request.kind = StorageRequest::Kind::kReserveResets;
  request.reset_counter = 255;
  EXPECT_TRUE(save(storage, request));
  auto kept = storage.load(fallback_values());
  ASSERT_TRUE(kept.ok());
  EXPECT_TRUE(kept.value().has_parameters);
  EXPECT_EQ(kept.value().parameters[0], 33);
  EXPECT_EQ(kept.value().reset_counter, 0) << "it goes round";
  request.kind = StorageRequest::Kind::kEraseParameters;
  EXPECT_TRUE(save(storage, request));
  EXPECT_TRUE(save(storage, request)) << "nothing left to erase is no failure";
  EXPECT_FALSE(storage.load(fallback_values()).value().has_parameters);
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder), {}), 2) << "no half-written files stay";
}

TEST_F(StorageTest, DamagedFilesNameThemselvesAndGroundNobody) {
  const auto message = [&](const char* file, const char* text) {
    std::ofstream(folder + "/" + file) << text;
    const auto loaded = Storage(folder).load(fallback_values());
    std::filesystem::remove(folder + "/" + file);
    EXPECT_TRUE(loaded.ok()) << text;
    if (!loaded.ok() || loaded.value().warnings.empty()) return std::string();
    EXPECT_EQ(loaded.value().parameters[0], fallback_values()[0]) << "the configuration's";
    return loaded.value().warnings[0];
  };
  EXPECT_NE(message("link_parameters.txt", "# x\nVIO_RATE abc\n").find("link_parameters.txt:2:"), std::string::npos);
  EXPECT_NE(message("link_parameters.txt", "VIO_RATE 999\n").find("20 to 40"), std::string::npos);
  EXPECT_NE(message("link_parameters.txt", "VIO_RATE 30 30\n").find(":1:"), std::string::npos);
  EXPECT_NE(message("link_parameters.txt", "VIO_RATE\n").find(":1:"), std::string::npos);
  EXPECT_EQ(message("link_parameters.txt", "VIO_FROM_THE_FUTURE 7\n"), "");
  EXPECT_NE(message("link_reset_counter.txt", "300\n").find("link_reset_counter.txt"), std::string::npos);
  EXPECT_NE(message("link_reset_counter.txt", "").find("link_reset_counter.txt"), std::string::npos);
}

TEST_F(StorageTest, OnlyWhatWasChangedIsSavedAndTheRestFollowsTheFile) {
  Storage storage(folder);
  ASSERT_TRUE(storage.load(fallback_values()).ok());
  StorageRequest request;
  request.parameters = request.defaults = fallback_values();
  request.parameters[0] = 33;
  EXPECT_TRUE(save(storage, request));
  ParameterValues other = fallback_values();
  const auto require_pose = static_cast<std::size_t>(Parameter::kRequirePose);
  other[require_pose] = 1;  // the file asks for a pose from now on
  const StoredState state = storage.load(other).value();
  EXPECT_EQ(state.parameters[require_pose], 1);
  EXPECT_EQ(state.parameters[0], 33);
  const auto told = overrides(other, state);
  ASSERT_EQ(told.size(), 1u);
  EXPECT_EQ(told[0], "VIO_RATE 33, saved over the bus, overrides 30 of the configuration");
}

TEST_F(StorageTest, WhatWasSavedAndDoesNotFitIsDroppedAndTheFileFlies) {
  Storage storage(folder);
  ASSERT_TRUE(storage.load(fallback_values()).ok());
  const auto fits = [&](Parameter p, std::int64_t value, const LinkMeans& means) {
    StoredState state;
    state.parameters = fallback_values();
    state.has_parameters = true;
    state.parameters[static_cast<std::size_t>(p)] = value;
    drop_what_does_not_fit(fallback_values(), means, &state);
    EXPECT_NE(state.parameters == fallback_values(), state.warnings.empty());
    return state.warnings.empty();
  };
  EXPECT_FALSE(fits(Parameter::kProfile, 1, {true, false, true})) << "PX4 through the tunnel";
  EXPECT_TRUE(fits(Parameter::kProfile, 1, {true, true, true}));
  EXPECT_FALSE(fits(Parameter::kCanFd, 1, {true, false, false}));
  EXPECT_FALSE(fits(Parameter::kTelemetryFd, 1, {true, false, false}));
  EXPECT_TRUE(fits(Parameter::kCanFd, 1, {true, false, true}));
  EXPECT_FALSE(fits(Parameter::kNodeId, 10, {true, false, true})) << "the autopilot's";
  EXPECT_FALSE(fits(Parameter::kAutopilotNode, 42, {true, false, true})) << "ours";
}

TEST_F(StorageTest, TwoInOneFolderAreOneTooMany) {
  {
    Storage first(folder), second(folder);
    ASSERT_TRUE(first.load(fallback_values()).ok());
    const auto refused = second.load(fallback_values());
    ASSERT_FALSE(refused.ok());
    EXPECT_NE(refused.error().message.find("another godwit"), std::string::npos);
    EXPECT_TRUE(first.load(fallback_values()).ok()) << "it holds it already";
  }
  EXPECT_TRUE(Storage(folder).load(fallback_values()).ok()) << "free again";
}

TEST_F(StorageTest, AFolderThatCannotBeWrittenToGroundsNobody) {
  Storage storage("/proc/self");  // not even by root
  const auto state = storage.load(fallback_values());
  ASSERT_TRUE(state.ok()) << state.error().message;
  ASSERT_EQ(state.value().warnings.size(), 1u);
  EXPECT_NE(state.value().warnings[0].find("nothing can be kept"), std::string::npos);
}

TEST_F(StorageTest, PipesAndPlantedLinksNeitherHoldNorLead) {
  ASSERT_EQ(mkfifo((folder + "/link_parameters.txt").c_str(), 0600), 0);
  Storage storage(folder);
  const auto state = storage.load(fallback_values());  // would wait here for a writer
  ASSERT_TRUE(state.ok());
  EXPECT_EQ(state.value().warnings.size(), 1u);
  const std::string victim = folder + "/victim";
  std::ofstream(victim) << "precious";
  std::filesystem::create_symlink(victim, folder + "/link_reset_counter.txt.part");
  StorageRequest request;
  request.kind = StorageRequest::Kind::kReserveResets;
  EXPECT_TRUE(save(storage, request));
  std::string kept;
  std::ifstream(victim) >> kept;
  EXPECT_EQ(kept, "precious");
}

TEST_F(StorageTest, WhatIsPlantedInTheLocksPlaceGroundsNobody) {
  const std::string lock = folder + "/lock", victim = folder + "/victim";
  std::filesystem::create_symlink(victim, lock);
  {
    Storage storage(folder);
    const auto state = storage.load(fallback_values());
    ASSERT_TRUE(state.ok()) << state.error().message;
    ASSERT_EQ(state.value().warnings.size(), 1u);
    EXPECT_EQ(state.value().warnings[0].rfind(lock + ": ", 0), 0u) << state.value().warnings[0];
    EXPECT_FALSE(std::filesystem::exists(victim)) << "and the link is not followed";
  }
  std::filesystem::remove(lock);
  std::filesystem::create_directory(lock);
  EXPECT_TRUE(Storage(folder).load(fallback_values()).ok());
}

TEST_F(StorageTest, WhatCannotBeSavedSaysSo) {
  Storage nowhere(""), missing(folder + "/gone");
  StorageRequest request;
  EXPECT_FALSE(save(nowhere, request));
  EXPECT_NE(nowhere.last_error().find("state folder"), std::string::npos);
  EXPECT_FALSE(save(missing, request));
  EXPECT_NE(missing.last_error().find("gone"), std::string::npos);
  for (int i = 0; i < 8; ++i) EXPECT_TRUE(nowhere.request(request));
  EXPECT_FALSE(nowhere.request(request)) << "a full ring refuses";
}

}  // namespace storage_test
}  // namespace godwit::link
