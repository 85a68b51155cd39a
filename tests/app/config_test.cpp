#include "firmware_app/config/config.h"

#include <cstdlib>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware_app/config/config_schema.h"

namespace godwit::app::config_test {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::SizeIs;

TEST(Config, AnEmptyFileGivesTheDefaults) {
  const ConfigReport report = parse_config("", "c.toml");
  ASSERT_TRUE(report.ok());
  EXPECT_EQ(report.config.pipeline.frame_slots, Config{}.pipeline.frame_slots);
  EXPECT_EQ(report.config.pipeline.mapper_delay_frames, Config{}.pipeline.mapper_delay_frames);
}

TEST(Config, ReadsEveryKey) {
  const ConfigReport report = parse_config("[pipeline]\nframe_slots = 40\nmapper_delay_frames = 7\n", "c.toml");
  ASSERT_TRUE(report.ok()) << report.mistakes[0];
  EXPECT_EQ(report.config.pipeline.frame_slots, 40);
  EXPECT_EQ(report.config.pipeline.mapper_delay_frames, 7);
}

TEST(Config, TellsAllMistakesAtOnceInTheOrderOfTheFile) {
  const ConfigReport report = parse_config(
      "zebra = 1\n"
      "[pipeline]\n"
      "mapper_delay_frames = 99\n"
      "frame_slot = 5\n"
      "frame_slots = \"many\"\n"
      "[aardvark]\n"
      "x = 1\n",
      "c.toml");
  ASSERT_THAT(report.mistakes, SizeIs(5));
  EXPECT_THAT(report.mistakes[0], HasSubstr("c.toml:1: zebra: unknown key"));
  EXPECT_EQ(report.mistakes[1], "c.toml:3: pipeline.mapper_delay_frames: a whole number from 1 to 30 is allowed");
  EXPECT_THAT(report.mistakes[2],
              HasSubstr("c.toml:4: pipeline.frame_slot: unknown key; did you mean pipeline.frame_slots?"));
  EXPECT_EQ(report.mistakes[3], "c.toml:5: pipeline.frame_slots: a whole number from 0 to 128 is allowed");
  EXPECT_THAT(report.mistakes[4], HasSubstr("c.toml:6: aardvark: unknown section; allowed are [pipeline], [threads]"));
}

TEST(Config, WrongKindsOfValuesAreMistakes) {
  for (const char* value : {"1.5", "true", "[1]", "{a = 1}", "1979-05-27", "-1", "9223372036854775807", "nan"}) {
    const ConfigReport report = parse_config(std::string("[pipeline]\nframe_slots = ") + value + "\n", "c.toml");
    EXPECT_THAT(report.mistakes, ElementsAre(HasSubstr("c.toml:2: pipeline.frame_slots: a whole number"))) << value;
  }
  EXPECT_THAT(parse_config("pipeline = 3\n", "c.toml").mistakes,
              ElementsAre("c.toml:1: pipeline: a section, [pipeline], is allowed"));
}

TEST(Config, WhatIsNotTomlIsToldWithItsLine) {
  EXPECT_THAT(parse_config("[pipeline]\nframe_slots == 3\n", "c.toml").mistakes,
              ElementsAre(HasSubstr("c.toml:2: not TOML")));
  EXPECT_THAT(parse_config("a = 1\na = 2\n", "c.toml").mistakes, ElementsAre(HasSubstr("c.toml:2: not TOML")));
  EXPECT_THAT(parse_config("\xff\xfe", "c.toml").mistakes, ElementsAre(HasSubstr("not TOML")));
}

TEST(Config, AFileThatIsNotThereIsAMistake) {
  EXPECT_THAT(load_config("/nowhere/c.toml").mistakes, ElementsAre("/nowhere/c.toml: No such file or directory"));
  EXPECT_THAT(load_config("/").mistakes, SizeIs(1)) << "a folder is no file";
}

TEST(Config, ThreadsAndTheirContradictions) {
  const ConfigReport good =
      parse_config("[threads.tracker]\ncpus = [1, 0]\npriority = 50\n[threads.mapper]\npriority = 49\n", "c.toml");
  ASSERT_TRUE(good.ok()) << good.mistakes[0];
  EXPECT_EQ(good.config.threads.tracker.cpus, (std::vector<int>{1, 0}));
  EXPECT_EQ(good.config.threads.mapper.priority, 49);
  EXPECT_THAT(
      parse_config("[threads.tracker]\npriority = 50\n[threads.mapper]\npriority = 50\n", "c.toml").mistakes,
      ElementsAre(
          "c.toml:4: threads.mapper.priority: tracking comes first, with threads.tracker.priority = 50; 0 to 49 "
          "is allowed"));
  EXPECT_THAT(parse_config("[threads.tracker]\npriority = 99\n", "c.toml").mistakes,
              ElementsAre(HasSubstr("a whole number from 0 to 98")));
}

TEST(Config, TheSchedulersLimitsStandInOrder) {
  EXPECT_THAT(parse_config("[scheduler]\ndeadline_ms = 10\n", "c.toml").mistakes,
              ElementsAre(HasSubstr("c.toml: scheduler.tracker_p95_ms: 15 is not below scheduler.deadline_ms (10)")))
      << "a key that the file does not hold has no line";
}

TEST(Config, TheNetworkAndTheGate) {
  const ConfigReport good = parse_config(
      "[detector]\nenabled = false\nmodel = \"a.onnx\"\nsmall_model = \"b.onnx\"\nbackend = \"cuda_fp16\"\n"
      "min_score = 0.5\ntiled = true\nthreads = 2\n[gate]\nenabled = false\n",
      "c.toml");
  ASSERT_TRUE(good.ok()) << good.mistakes[0];
  EXPECT_FALSE(good.config.detector.enabled);
  EXPECT_EQ(good.config.detector.model, "a.onnx");
  EXPECT_EQ(good.config.detector.small_model, "b.onnx");
  EXPECT_EQ(good.config.detector.backend, detector::Backend::kCudaFp16);
  EXPECT_EQ(good.config.detector.min_score, 0.5);
  EXPECT_TRUE(good.config.detector.tiled);
  EXPECT_EQ(good.config.detector.threads, 2);
  EXPECT_FALSE(good.config.gate.enabled);
  EXPECT_THAT(parse_config("[detector]\nenabled = \"on\"\nbackend = \"gpu\"\nmin_score = 0\nthreads = 0\n"
                           "[gate]\nenabled = 1\n",
                           "c.toml")
                  .mistakes,
              ElementsAre("c.toml:2: detector.enabled: true or false is allowed",
                          "c.toml:3: detector.backend: \"cpu\", \"cuda\" or \"cuda_fp16\" is allowed",
                          "c.toml:4: detector.min_score: a number from 0.05 to 0.95 is allowed",
                          "c.toml:5: detector.threads: a whole number from 1 to 64 is allowed",
                          "c.toml:7: gate.enabled: true or false is allowed"));
}

TEST(Config, TheInertialSensorIsFlownByWhereThereIsOne) {
  const Config none;
  EXPECT_TRUE(none.imu.enabled);
  EXPECT_FALSE(none.imu.flown_by()) << "there is none";
  const auto sensor = [](const std::string& camera, const std::string& imu) {
    return parse_config("[camera]\nsource = \"" + camera + "\"\n[imu]\n" + imu, "c.toml");
  };
  for (const auto& [camera, imu] : {std::pair("v4l2", "mpu6000"), std::pair("v4l2", "iio"),
                                    std::pair("replay", "replay"), std::pair("sim", "sim")}) {
    const ConfigReport good =
        sensor(camera, std::string("source = \"") + imu + "\"\ncalibration = \"imu.yaml\"\ncoast_s = 0.5\n");
    ASSERT_TRUE(good.ok()) << good.mistakes[0];
    EXPECT_TRUE(good.config.imu.flown_by());
    EXPECT_EQ(good.config.imu.calibration, "imu.yaml");
    EXPECT_EQ(good.config.imu.coast_s, 0.5);
  }
  EXPECT_FALSE(sensor("v4l2", "source = \"iio\"\nenabled = false\n").config.imu.flown_by());
  EXPECT_THAT(sensor("v4l2", "source = \"sim\"\n").mistakes,
              ElementsAre("c.toml:4: imu.source: \"sim\" is the sensor of camera.source = \"sim\"; with another camera "
                          "\"mpu6000\", \"iio\" or \"none\" is allowed"));
  EXPECT_THAT(sensor("sim", "source = \"replay\"\n").mistakes, SizeIs(1));
  EXPECT_THAT(sensor("replay", "source = \"iio\"\n").mistakes,
              ElementsAre(HasSubstr("c.toml:4: imu.source: it measures what happens now")));
  EXPECT_TRUE(sensor("replay", "source = \"iio\"\nenabled = false\n").ok()) << "to be watched it may";
  EXPECT_THAT(parse_config("[imu]\nenabled = 1\ncoast_s = 11\n", "c.toml").mistakes,
              ElementsAre("c.toml:2: imu.enabled: true or false is allowed",
                          "c.toml:3: imu.coast_s: a number from 0 to 10 [s] is allowed"));
}

TEST(Config, AKeyInTheWrongSectionIsToldItsPlace) {
  EXPECT_THAT(parse_config("mapper_delay_frames = 2\n", "c.toml").mistakes,
              ElementsAre(HasSubstr("c.toml:1: mapper_delay_frames: unknown key; did you mean "
                                    "pipeline.mapper_delay_frames?")));
  EXPECT_THAT(parse_config("[pipeline.frame_slots_]\nx = 1\n", "c.toml").mistakes,
              ElementsAre("c.toml:1: pipeline.frame_slots_: a section is not allowed here"));
}

TEST(Config, TheCommentedFileHoldsEveryKeyWithItsDefault) {
  const ConfigReport report = load_config(GODWIT_CONFIG_FILE);
  ASSERT_TRUE(report.ok()) << report.mistakes[0];
  EXPECT_EQ(show_config(report.config), show_config(Config{}));
  Config any;
  for (const Key& key : config_keys(&any)) {
    EXPECT_THAT(report.lines, testing::Contains(testing::Key(key.name))) << "config/godwit.toml";
  }
}

TEST(Config, WhatIsShownReadsBackToTheSame) {
  std::string text;
  for (const std::string& line : show_config(Config{})) text += line + "\n";
  const ConfigReport report = parse_config(text, "c.toml");
  ASSERT_TRUE(report.ok()) << report.mistakes[0];
  EXPECT_EQ(show_config(report.config), show_config(Config{}));
}

TEST(Config, MinusNothingIsShownAsWhatItIsReadAs) {
  const ConfigReport report =
      parse_config("[link]\nmavlink = \"udp:127.0.0.1:14540\"\norigin = [47.4, -0.0, 488]\n", "godwit.toml");
  ASSERT_TRUE(report.ok());
  const std::vector<std::string> shown = show_config(report.config);
  std::string text;
  for (const std::string& line : shown) text += line + "\n";
  EXPECT_EQ(show_config(parse_config(text, "shown.toml").config), shown);
}

}  // namespace
}  // namespace godwit::app::config_test
