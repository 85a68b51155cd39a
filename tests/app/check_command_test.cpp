// `godwit check` as a program, which looks over the same file as godwitd.
#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <string>

#include "tests/app/small_flight.h"
#include "tests/support/run_command.h"
#include "tests/support/temp_folder.h"

namespace godwit::app::check_command_test {
namespace {

using testing::HasSubstr;

TEST(GodwitCheck, TellsEverythingAtOnceInTheOrderOfTheFile) {
  const test::TempFolder folder;
  const std::string config = write_config(folder,
                                          "[threads.tracker]\ncpus = [0, 1000]\n"
                                          "[scheduler]\ncalm_s = \"long\"\n"
                                          "[camera]\nsource = \"sim\"\nscenarios = \"" GODWIT_SCENARIO_DIR
                                          "\"\nscenario = \"nowhere\"\n"
                                          "[pipeline]\nframe_slots = 3\n"
                                          "[nosuch]\nx = 1\n");
  const auto [code, said] = test::run_command(GODWIT_TOOL " check --config " + config);
  EXPECT_EQ(code, 2);
  std::size_t at = 0;
  for (const char* line :
       {":2: threads.tracker.cpus: there is no processor 1000", ":4: scheduler.calm_s: a number",
        ":8: camera.scenario: no scenario 'nowhere'; there are: ", ":10: pipeline.frame_slots: 3 are too few",
        ":11: nosuch: unknown section", ": 5 mistakes"}) {
    const std::size_t found = said.find(config + line, at);
    ASSERT_NE(found, std::string::npos) << line << " in:\n" << said;
    at = found;
  }
}

TEST(GodwitCheck, ListsEveryKeyWithItsDefaultAndWhatIsAllowed) {
  const auto [code, said] = test::run_command(GODWIT_TOOL " check --keys");
  EXPECT_EQ(code, 0);
  EXPECT_THAT(said, HasSubstr("\ncan.node_id = 42  # a whole number from 0 to 125\n"));
  EXPECT_THAT(said, HasSubstr("\nlink.profile = \"ardupilot\"  # \"ardupilot\" or \"px4\"\n"));
  const auto [without, words] = test::run_command(GODWIT_TOOL " check");
  EXPECT_EQ(without, 2);
  EXPECT_THAT(words, HasSubstr("--config"));
}

TEST(GodwitCheck, ASimulatedCameraIsRefusedOnARealBus) {
  const test::TempFolder folder;
  const auto code = [&](const std::string& link) {
    return test::run_command(GODWIT_TOOL " check --config " + write_config(folder, kSmallFlight + link)).exit_code;
  };
  EXPECT_EQ(code("[can]\nbus = \"socketcan:can0\"\n"), 2);
  EXPECT_EQ(code("[can]\nbus = \"socketcan:vcan0\"\n"), 0);
  EXPECT_EQ(code("[link]\nmavlink = \"serial:/dev/ttyTHS0:921600\"\n"), 2);
  EXPECT_EQ(code("[link]\nmavlink = \"udp:127.0.0.1:14550\"\n"), 0);
}

TEST(GodwitCheck, WhatCannotBeSaidIsToldAndNoSuccess) {
  const test::TempFolder folder;
  const std::string check = GODWIT_TOOL " check --config " + write_config(folder, kSmallFlight);
  ASSERT_EQ(test::run_command(check).exit_code, 0);
  for (const std::string& command :
       {check, std::string(GODWIT_TOOL " --help"), std::string(GODWIT_TOOL " --version")}) {
    const auto [code, said] = test::run_command("( " + command + " >/dev/full )");
    EXPECT_EQ(code, 1) << command;
    EXPECT_THAT(said, HasSubstr("godwit: standard output: ")) << command;
  }
}

TEST(GodwitCheck, TheFolderOfTheLinkMustBeThere) {
  const test::TempFolder folder;
  const std::string config =
      write_config(folder, "[camera]\nsource = \"sim\"\nscenarios = \"" GODWIT_SCENARIO_DIR
                           "\"\n[can]\nbus = \"multicast:0\"\n[link]\nstate_folder = \"/nowhere\"\n");
  for (const char* program : {GODWIT_TOOL " check", GODWIT_DAEMON}) {
    const auto [code, said] = test::run_command(std::string(program) + " --config " + config);
    EXPECT_EQ(code, 2) << program;
    EXPECT_THAT(said, HasSubstr(config + ":7: link.state_folder: \"/nowhere\" is not there or no folder"));
  }
}

TEST(GodwitCheck, WhatWasSavedOverTheBusIsShownAndWhatDoesNotFitIsNamed) {
  const test::TempFolder folder;
  std::ofstream(folder / "link_parameters.txt") << "VIO_RATE 25\nVIO_PROFILE 1\n";
  const auto [code, said] =
      test::run_command(GODWIT_TOOL " check --config " +
                        write_config(folder, kSmallFlight + "[can]\nbus = \"multicast:0\"\n[link]\nstate_folder = \"" +
                                                 folder.path().string() + "\"\n"));
  EXPECT_EQ(code, 0) << said;
  EXPECT_THAT(said, HasSubstr("VIO_RATE 25, saved over the bus, overrides 30 of the configuration"));
  EXPECT_THAT(said,
              HasSubstr("warning: VIO_PROFILE 1, saved over the bus, is not used: PX4 takes no MAVLink through CAN"));
}

TEST(GodwitCheck, TheNetworksFilesMustBeThereAndGoTogether) {
  const test::TempFolder folder;
  const std::string own = folder / "own.onnx";
  std::ofstream(own) << "no network";
  const auto told = [&](const std::string& section, const std::string& words) {
    const std::string config = write_config(folder, kSmallFlight + "[detector]\n" + section);
    for (const char* program : {GODWIT_TOOL " check", GODWIT_DAEMON}) {
      const auto [code, said] = test::run_command(std::string(program) + " --config " + config);
      EXPECT_EQ(code, 2) << program;
      EXPECT_THAT(said, HasSubstr(config + words));
    }
  };
  told("model = \"/nowhere.onnx\"\n",
       ":7: detector.model: /nowhere.onnx: No such file or directory; without a network: detector.enabled = false");
  told("model = \"" + own + "\"\n", ":7: detector.model: " + (folder / "own.toml") + ": cannot be opened");
  told("small_model = \"/\"\n", ":7: detector.small_model: /: no file");
  std::filesystem::copy(GODWIT_MODEL_DIR "/cbam_yolov5n_416.toml", folder.path() / "own.toml");
  told("model = \"" + own + "\"\n", ":7: detector.model: " + own + ": not the network that " + (folder / "own.toml") +
                                        " describes: its SHA-256 is ");
  std::filesystem::copy(GODWIT_MODEL_DIR "/cbam_yolov5n_416.onnx", own,
                        std::filesystem::copy_options::overwrite_existing);
  told("small_model = \"" + own + "\"\n",
       ":7: detector.small_model: " + own + ": its input of 416 x 416 pixels is not smaller");
  // Wider than 416 and yet of fewer pixels: too large beside itself, small enough beside the square.
  const std::string wide = GODWIT_MODEL_DIR "/cbam_yolov5n_480x352.onnx";
  told("model = \"" + wide + "\"\nsmall_model = \"" + own + "\"\n",
       ":8: detector.small_model: " + own + ": its input of 416 x 416 pixels is not smaller than that of " + wide +
           ", 480 x 352");
  const std::string fits =
      write_config(folder, kSmallFlight + "[detector]\nmodel = \"" + own + "\"\nsmall_model = \"" + wide + "\"\n");
  EXPECT_THAT(test::run_command(GODWIT_TOOL " check --config " + fits).text,
              testing::Not(HasSubstr("detector.small_model")));
  std::ofstream(folder.path() / "own.toml", std::ios::app) << "size = 3\n";
  told("model = \"" + own + "\"\n", ":7: detector.model: " + (folder / "own.toml") + ":12: unknown key size");
}

TEST(GodwitCheck, SaysOkAndShowsEveryKey) {
  const test::TempFolder folder;
  const auto [code, said] =
      test::run_command(GODWIT_TOOL " check --show --config " + write_config(folder, kSmallFlight));
  EXPECT_EQ(code, 0);
  EXPECT_THAT(said, HasSubstr("camera.pictures = 2\n"));
  EXPECT_THAT(said, HasSubstr("scheduler.deadline_ms = 33.3\n"));
  EXPECT_THAT(said, HasSubstr(": ok\n"));
}

}  // namespace
}  // namespace godwit::app::check_command_test
