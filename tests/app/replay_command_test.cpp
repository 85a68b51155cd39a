// The tool as a user runs it: arguments, refusals, exit codes, files.
#include <filesystem>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <sstream>
#include <sys/stat.h>

#include "tests/support/run_command.h"
#include "tests/support/tiny_sequence.h"

namespace godwit::app::replay_command_test {
namespace {

namespace fs = std::filesystem;
using godwit::test::Outcome;
using godwit::test::read_file;
using godwit::test::run_command;
using godwit::test::TempFolder;
using godwit::test::write_file;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

Outcome godwit(const std::string& arguments, const std::string& before = "") {
  return run_command(before + "'" GODWIT_TOOL "' " + arguments);
}

std::size_t count_lines(const std::string& file) {
  const std::string text = read_file(file);
  return static_cast<std::size_t>(std::count(text.begin(), text.end(), '\n'));
}

class Replay : public testing::Test {
 protected:
  void SetUp() override { godwit::test::write_tiny_tum(sequence(), 12); }
  std::string sequence() const { return folder_ / "sequence"; }
  std::string out() const { return folder_ / "out"; }
  Outcome replay(const std::string& more) {
    return godwit("replay '" + sequence() + "' --out '" + out() + "' " + more);
  }
  nlohmann::json summary() const { return nlohmann::json::parse(read_file(out() + "/summary.json")); }
  TempFolder folder_;
};

TEST(Tool, TellsItsVersionAndHelp) {
  EXPECT_EQ(godwit("--version").exit_code, 0);
  EXPECT_THAT(godwit("--version").text, testing::MatchesRegex("godwit [0-9]+\\.[0-9]+\\.[0-9]+ "
                                                              "\\(commit ([0-9a-f]{12}(-dirty)?|unknown)\\)\n"));
  const Outcome help = godwit("--help");
  EXPECT_EQ(help.exit_code, 0);
  EXPECT_THAT(help.text, AllOf(HasSubstr("replay"), HasSubstr("Exit codes: 0 done")));
  const Outcome replay_help = godwit("replay --help");
  EXPECT_EQ(replay_help.exit_code, 0);
  for (const char* option : {"SEQUENCE", "--config", "--out", "--pace", "--sequential", "--start", "--frames",
                             "--detector", "--gate", "--imu", "--model", "--view", "--view-every"}) {
    EXPECT_THAT(replay_help.text, HasSubstr(option));
  }
}

TEST(Tool, WrongArgumentsAreRefusedWithCode2) {
  for (const char* arguments :
       {"", "fly", "replay", "replay x --pace slow", "replay x --start -1", "replay x --frames 0",
        "replay x --frames many", "replay x --unknown", "replay x --detector perhaps"}) {
    EXPECT_EQ(godwit(arguments).exit_code, 2) << arguments;
  }
}

TEST_F(Replay, TellsTheStateAndWhyInTheLog) {
  for (const char* mode : {"--sequential", "", "--pace real"}) {
    EXPECT_THAT(replay(mode).text, HasSubstr("godwit: t=0.00 s INITIALISING: ")) << mode;
    const auto first = summary()["events"][0];
    EXPECT_EQ(first["t"], 0.0);
    EXPECT_EQ(first["what"], "state");
    EXPECT_EQ(first["before"], "");
    EXPECT_EQ(first["which"], "INITIALISING");
    EXPECT_NE(first["why"], "");
  }
}

TEST_F(Replay, WhateverBecomesOfItsLogItFliesToItsEnd) {
  const std::string code = folder_ / "code";
  const std::string flown = "'" GODWIT_TOOL "' replay '" + sequence() + "' --pace real --out '" + out() + "' ";
  // Its output goes nowhere, its log to `log` and its exit code into a file.
  const auto with_log = [&](const std::string& log) {
    return std::string(flown).append(log).append("; echo $? >'").append(code).append("'");
  };
  for (const std::string& command : {with_log(">/dev/null 2>&-"), with_log(">/dev/null 2>/dev/full"),
                                     std::string("{ ").append(with_log("2>&1 >/dev/null")).append("; } | true")}) {
    fs::remove_all(out());
    run_command("{ " + command + "; }");
    EXPECT_EQ(read_file(code), "0\n") << command;
    EXPECT_EQ(count_lines(out() + "/frames.csv"), 13u) << command;
  }
}

TEST(Simulator, FaultsOfItsInertialSensorAreDrawnBySeed) {
  const TempFolder folder;
  const auto readings = [&](const std::string& name, const std::string& more) {
    EXPECT_EQ(godwit("sim street --frames 2 --seed 3 --out '" + folder / name + "' " + more).exit_code, 0);
    return read_file(folder / name + "/imu.txt");
  };
  const std::string sound = readings("sound", ""), faulty = readings("faulty", "--imu-faults");
  EXPECT_NE(sound, faulty);
  EXPECT_EQ(faulty, readings("again", "--imu-faults"));
  EXPECT_EQ(read_file(folder / "sound/groundtruth.txt"), read_file(folder / "faulty/groundtruth.txt"));
}

TEST_F(Replay, WatchesTheImuBesideTheCamera) {
  EXPECT_THAT(replay("--imu watch").text, HasSubstr("no IMU: neither imu.txt nor mav0/imu0/data.csv is there"));
  EXPECT_THAT(replay("--imu on").text, HasSubstr("no IMU: neither imu.txt nor mav0/imu0/data.csv is there"));
  std::string samples;
  for (int i = -10; i <= 20; ++i) samples += std::to_string(100 + 0.01 * i) + "001 0 0 0 0 0 -9.81\n";
  write_file(sequence() + "/imu.txt", samples);
  for (const char* mode : {"--sequential", "", "--pace real"}) {
    const Outcome outcome = replay(std::string("--imu watch ") + mode);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.text;
    EXPECT_THAT(outcome.text, HasSubstr("IMU: 21 samples, 0 gaps, 0 dropped")) << mode;
    EXPECT_EQ(summary()["imu"]["samples"], 21);
    EXPECT_EQ(summary()["imu"]["gaps"], 0);
  }
  EXPECT_THAT(replay("--imu watch --loop 2").text, HasSubstr("nobody measured the way back"));
}

TEST_F(Replay, ARecordingThatBreaksOffIsFlownAsFarAsItIsWhole) {
  std::string list = read_file(sequence() + "/rgb.txt");
  write_file(sequence() + "/rgb.txt", list.substr(0, list.rfind(' ')));
  write_file(sequence() + "/imu.txt", "100.0 0 0 0 0 0 -9.8\n100.1 0 0 0 0 0 -9.8\n100.2 0 0");
  const Outcome run = replay("--imu watch --sequential");
  EXPECT_EQ(run.exit_code, 0) << run.text;
  EXPECT_THAT(run.text, AllOf(HasSubstr("rgb.txt:13: no file name behind the time; the file breaks off there"),
                              HasSubstr("imu.txt:3: '' is not"), HasSubstr("11 frames")));
}

TEST_F(Replay, WritesALineForEachPictureInBothModes) {
  for (const char* mode : {"--sequential", "", "--pace real"}) {
    const Outcome outcome = replay(mode);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.text;
    EXPECT_THAT(outcome.text, HasSubstr("12 frames"));
    EXPECT_EQ(count_lines(out() + "/frames.csv"), 13u) << mode;
    for (const char* file : {"trajectory.tum", "pose.csv", "summary.json"}) EXPECT_TRUE(fs::exists(out() + "/" + file));
    EXPECT_THAT(read_file(out() + "/frames.csv"), HasSubstr("\n100.050000001,"));
    EXPECT_THAT(outcome.text, Not(HasSubstr("\r"))) << "no progress bar where there is no terminal";
  }
}

TEST_F(Replay, StartAndFramesChooseAPart) {
  ASSERT_EQ(replay("--sequential --start 3 --frames 4").exit_code, 0);
  EXPECT_EQ(count_lines(out() + "/frames.csv"), 5u);
  EXPECT_EQ(summary()["start"], 3);
  const Outcome beyond = replay("--start 12");
  EXPECT_EQ(beyond.exit_code, 2);
  EXPECT_THAT(beyond.text, HasSubstr("lists 12 pictures"));
}

TEST_F(Replay, TheImuIsUsedWhereTheCalibrationSaysHowTheCameraSitsOnIt) {
  std::string samples;
  for (int i = -10; i <= 60; ++i) samples += std::to_string(100 + 0.01 * i) + "001 0 0 0 0 0 -9.81\n";
  write_file(sequence() + "/imu.txt", samples);
  const Outcome without = replay("--imu on --sequential");
  EXPECT_EQ(without.exit_code, 2);
  EXPECT_THAT(without.text, HasSubstr("without T_body_cam"));
  write_file(sequence() + "/camera.yaml",
             read_file(sequence() + "/camera.yaml") + "T_body_cam: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n");
  for (const char* mode : {"--sequential", ""}) {
    const Outcome outcome = replay(std::string("--imu on ") + mode);
    EXPECT_EQ(outcome.exit_code, 0) << outcome.text;
    EXPECT_THAT(outcome.text, Not(HasSubstr("not used")));
    EXPECT_THAT(outcome.text, HasSubstr("12 frames, 0 tracked")) << "nothing has shown metres";
    EXPECT_EQ(count_lines(out() + "/trajectory.tum"), 1u);
  }
}

TEST_F(Replay, WhatIsOffIsOff) {
  EXPECT_EQ(replay("--detector off --gate off --imu off --sequential").exit_code, 0);
}

TEST_F(Replay, TheGateFliesAlongWithAndWithoutTheDetector) {
  EXPECT_EQ(replay("--gate on --sequential").exit_code, 0);
  EXPECT_EQ(replay("--gate on --detector on").exit_code, 0);
}

TEST_F(Replay, ViewWritesAPictureForEveryNthFrame) {
  const std::string view = folder_ / "view";
  const Outcome outcome = replay("--sequential --view '" + view + "' --view-every 5");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.text;
  EXPECT_THAT(outcome.text, HasSubstr("3 pictures of what was seen in " + view));
  for (const char* name : {"/000000.png", "/000005.png", "/000010.png"}) EXPECT_TRUE(fs::exists(view + name)) << name;
  const Outcome real = replay("--pace real --view '" + view + "'");
  EXPECT_EQ(real.exit_code, 2);
  EXPECT_THAT(real.text, HasSubstr("leave --pace real out"));
  write_file(folder_ / "file", "");
  const Outcome nowhere = replay("--view '" + std::string(folder_ / "file") + "/view'");
  EXPECT_EQ(nowhere.exit_code, 2);
  EXPECT_THAT(nowhere.text, HasSubstr("--view: "));
}

TEST_F(Replay, TheDetectorFliesAlongAndItsModelIsChecked) {
  EXPECT_EQ(replay("--detector on --sequential").exit_code, 0);
  EXPECT_EQ(replay("--detector on").exit_code, 0);
  const Outcome alone = replay("--model x.onnx");
  EXPECT_EQ(alone.exit_code, 2);
  EXPECT_THAT(alone.text, HasSubstr("add --detector on"));
  const Outcome missing = replay("--detector on --model nosuch.onnx");
  EXPECT_EQ(missing.exit_code, 2);
  EXPECT_THAT(missing.text, HasSubstr("nosuch"));
}

TEST_F(Replay, WhatIsNoRegularFileIsNeitherWaitedForNorReadWithoutEnd) {
  fs::remove(sequence() + "/rgb/0004.png");
  fs::remove(sequence() + "/rgb/0006.png");
  ASSERT_EQ(mkfifo((sequence() + "/rgb/0004.png").c_str(), 0600), 0);
  fs::create_symlink("/dev/zero", sequence() + "/rgb/0006.png");
  const Outcome outcome = replay("--sequential");
  EXPECT_EQ(outcome.exit_code, 0);
  EXPECT_THAT(outcome.text,
              AllOf(HasSubstr("2 pictures were not flown: 2 bad"), HasSubstr("0004.png: not a regular file")));
  const Outcome config = replay("--config /dev/zero");
  EXPECT_EQ(config.exit_code, 2);
  EXPECT_THAT(config.text, HasSubstr("/dev/zero: not a regular file"));
}

TEST_F(Replay, NumbersOutOfRangeAreToldWithWhatIsAllowed) {
  for (const char* option : {"--frames 0", "--frames -3", "--view-every 0", "--loop x"}) {
    const Outcome outcome = replay(option);
    EXPECT_EQ(outcome.exit_code, 2) << option;
    EXPECT_THAT(outcome.text, HasSubstr("whole numbers from 1 to ")) << option;
  }
  EXPECT_THAT(replay("--start -1").text, HasSubstr("'-1': whole numbers from 0 to 1000000000 are allowed"));
  for (const char* seed : {"-1", "99999999999999999999999"}) {
    const Outcome outcome = godwit(std::string("fly street --out '") + out() + "' --seed " + seed);
    EXPECT_EQ(outcome.exit_code, 2) << seed;
    EXPECT_THAT(outcome.text, HasSubstr("whole numbers from 0 to 1000000000 are allowed")) << seed;
  }
  EXPECT_THAT(godwit("replay '" + sequence() + "' --out ''").text, HasSubstr("--out: a folder is needed"));
}

TEST_F(Replay, BadPicturesAreCountedToldAndDoNotEndTheRun) {
  fs::remove(sequence() + "/rgb/0004.png");
  write_file(sequence() + "/rgb/0006.png", "text");
  const Outcome outcome = replay("--sequential");
  EXPECT_EQ(outcome.exit_code, 0);
  EXPECT_THAT(outcome.text, AllOf(HasSubstr("2 pictures were not flown: 2 bad"), HasSubstr("0004.png: No such file")));
  EXPECT_EQ(count_lines(out() + "/frames.csv"), 13u);
  EXPECT_EQ(summary()["bad_pictures"], 2);
}

TEST_F(Replay, ASequenceOfOnePictureThatIsTextEndsCleanly) {
  write_file(sequence() + "/rgb.txt", "1.0 rgb/0000.png\n");
  write_file(sequence() + "/rgb/0000.png", "text");
  const Outcome outcome = replay("");
  EXPECT_EQ(outcome.exit_code, 0) << outcome.text;
  EXPECT_THAT(outcome.text, AllOf(HasSubstr("1 frames, 0 tracked"), HasSubstr("no pose was found")));
}

TEST_F(Replay, ABadSequenceOrCalibrationIsRefusedAndNothingIsWritten) {
  EXPECT_THAT(godwit("replay '" + (folder_ / "absent") + "' --out '" + out() + "'").text,
              HasSubstr("absent: No such file"));
  write_file(sequence() + "/camera.yaml", "model: pinhole\nwidth: 160\nheight: 120\nfx: .nan\n");
  const Outcome calibration = replay("");
  EXPECT_EQ(calibration.exit_code, 2);
  EXPECT_THAT(calibration.text, HasSubstr("camera.yaml:4: fx: the number is not finite"));
  write_file(sequence() + "/camera.yaml", godwit::test::tiny_camera_yaml());
  write_file(sequence() + "/rgb.txt", "");
  const Outcome index = replay("");
  EXPECT_EQ(index.exit_code, 2);
  EXPECT_THAT(index.text, HasSubstr("rgb.txt: lists no pictures"));
  EXPECT_FALSE(fs::exists(out()));
}

TEST_F(Replay, ABadConfigurationIsRefusedWithAllItsMistakes) {
  write_file(folder_ / "c.toml", "[pipeline]\nmapper_delay_frames = 0\nspeed = 3\n");
  const Outcome outcome = replay("--config '" + (folder_ / "c.toml") + "'");
  EXPECT_EQ(outcome.exit_code, 2);
  EXPECT_THAT(outcome.text,
              AllOf(HasSubstr("c.toml:2: pipeline.mapper_delay_frames"), HasSubstr("c.toml:3: pipeline.speed")));
  write_file(folder_ / "good.toml", "[pipeline]\nmapper_delay_frames = 3\n");
  EXPECT_EQ(replay("--sequential --config '" + (folder_ / "good.toml") + "'").exit_code, 0);
}

TEST_F(Replay, AgainstMoversTheFileSaysWhatAndAFlagWins) {
  const auto with = [&](const std::string& text, const std::string& flags) {
    write_file(folder_ / "c.toml", text);
    return replay("--sequential --config '" + (folder_ / "c.toml") + "' " + flags);
  };
  const std::string broken = "[detector]\nenabled = true\nmodel = \"nosuch.onnx\"\n";
  const Outcome file = with(broken, "");
  EXPECT_EQ(file.exit_code, 2) << "the file turns the network on";
  EXPECT_THAT(file.text, HasSubstr("nosuch.onnx: no such file"));
  EXPECT_EQ(with(broken, "--detector off").exit_code, 0) << "a flag wins";
  const std::string unsaid = "[detector]\nmodel = \"nosuch.onnx\"\n";
  EXPECT_EQ(with(unsaid, "").exit_code, 0) << "what the file does not say is off";
  EXPECT_EQ(with(unsaid, "--detector on").exit_code, 2);
  const Outcome own = with("[detector]\nenabled = true\n", "--model other.onnx");
  EXPECT_EQ(own.exit_code, 2);
  EXPECT_THAT(own.text, HasSubstr("other.onnx: no such file"));
  EXPECT_EQ(with("[gate]\nenabled = true\n", "--gate off").exit_code, 0);
}

TEST_F(Replay, TooFewSlotsToFlyAreRefusedAndTheFewestAllowedEnd) {
  write_file(folder_ / "c.toml", "[pipeline]\nframe_slots = 8\n");
  const Outcome few = replay("--config '" + (folder_ / "c.toml") + "'");
  EXPECT_EQ(few.exit_code, 2);
  EXPECT_THAT(few.text, AllOf(HasSubstr("frame_slots"), HasSubstr("at least 28")));
  write_file(folder_ / "c.toml", "[pipeline]\nframe_slots = 28\n");
  EXPECT_EQ(replay("--config '" + (folder_ / "c.toml") + "'").exit_code, 0);
}

TEST_F(Replay, AnUnwritableFolderIsAFailureWithItsReason) {
  write_file(out(), "a file is in the way");
  const Outcome outcome = replay("--sequential");
  EXPECT_EQ(outcome.exit_code, 1);
  EXPECT_THAT(outcome.text, HasSubstr("out: cannot be created"));
}

TEST_F(Replay, AFullDiskIsAFailureAndLeavesNoFile) {
  const Outcome outcome = godwit("replay '" + sequence() + "' --sequential --out '" + out() + "'", "ulimit -f 1; ");
  EXPECT_EQ(outcome.exit_code, 1) << outcome.text;
  EXPECT_THAT(outcome.text, HasSubstr("cannot be written: File too large"));
  EXPECT_TRUE(fs::is_empty(out()));
}

TEST_F(Replay, AnInterruptLeavesNoFile) {
  // A sequence that lasts 50 s at real pace; the interrupt comes long before its end.
  std::string index;
  for (int i = 0; i < 1000; ++i) index += std::to_string(100 + i) + " rgb/0000.png\n";
  write_file(sequence() + "/rgb.txt", index);
  const Outcome outcome = godwit("replay '" + sequence() + "' --pace real --out '" + out() + "'", "timeout -s INT 1 ");
  EXPECT_THAT(outcome.text, HasSubstr("interrupted; nothing was written"));
  EXPECT_TRUE(fs::is_empty(out()));
}

TEST_F(Replay, TwoSequentialRunsAreEqualToTheBit) {
  ASSERT_EQ(replay("--sequential").exit_code, 0);
  const std::string first = read_file(out() + "/trajectory.tum") + read_file(out() + "/pose.csv");
  ASSERT_EQ(replay("--sequential").exit_code, 0);
  EXPECT_EQ(first, read_file(out() + "/trajectory.tum") + read_file(out() + "/pose.csv"));
}

TEST_F(Replay, LinkOptionsThatCannotBeFollowedAreRefusedWithTheReason) {
  const auto refused = [&](const std::string& more, const std::string& why) {
    const Outcome outcome = replay(more);
    EXPECT_EQ(outcome.exit_code, 2) << more;
    EXPECT_THAT(outcome.text, HasSubstr(why)) << more;
    EXPECT_FALSE(fs::exists(out() + "/summary.json")) << more;
  };
  refused("--pace real --can foo", "--can: CAN bus \"foo\": expected multicast:N or socketcan:IFACE");
  refused("--pace real --can multicast:77", "multicast takes a bus number 0 to 9");
  refused("--pace real --can multicast:0:nowhere", "is no IPv4 address of a network interface");
  refused("--pace real --can socketcan:nosuch0", "CAN bus socketcan:nosuch0: ");
  refused("--pace real --mavlink serial:/dev/nosuch:921600", "/dev/nosuch: No such file or directory");
  refused("--pace real --mavlink serial:/dev/null:1234", "the baud rate must be");
  refused("--pace real --mavlink udp:here:14550", "here is no IPv4 address");
  refused("--can multicast:0", "add --pace real");
  refused("--sequential --can multicast:0", "add --pace real");
  refused("--pace real --bench-metric", "it goes with --can or --mavlink");
  refused("--pace real --imu on --bench-metric --mavlink udp:127.0.0.1:14550", "leave one of them out");
  write_file(folder_ / "px4.toml", "[link]\nprofile = \"px4\"\n");
  refused("--pace real --can multicast:0 --config " + (folder_ / "px4.toml"), "PX4 takes no MAVLink through CAN");
  write_file(folder_ / "state.toml", "[link]\nstate_folder = \"/no/such/folder\"\n");
  refused("--pace real --can multicast:9:127.0.0.1 --config " + (folder_ / "state.toml"),
          "state folder /no/such/folder: No such file or directory");
}

// Nobody listens; what is sent is looked at by the tests of the link.
TEST_F(Replay, TheLinksFiguresAreInTheSummary) {
  const Outcome outcome = replay("--pace real --can multicast:9:127.0.0.1");
  ASSERT_EQ(outcome.exit_code, 0) << outcome.text;
  EXPECT_THAT(outcome.text, HasSubstr("link: the camera looks front, the top of its picture is up"));
  EXPECT_THAT(outcome.text, HasSubstr("ODOMETRY sent"));
  const auto link = summary()["link"];
  EXPECT_EQ(link["node_id"], 42);
  EXPECT_GT(link["odometry_sent"], 0);
  ASSERT_EQ(replay("").exit_code, 0);
  EXPECT_FALSE(summary().contains("link"));
}

}  // namespace
}  // namespace godwit::app::replay_command_test
