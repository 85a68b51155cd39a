#include <cmath>
#include <filesystem>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

#include "firmware_app/output/event_line.h"
#include "firmware_app/output/run_writer.h"
#include "firmware_app/output/statistics.h"
#include "tests/support/file_size_limit.h"
#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace output_test {

using test::FileSizeLimit;
using test::read_file;
using test::TempFolder;
using test::write_file;
using testing::HasSubstr;
namespace fs = std::filesystem;

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  return lines;
}

std::vector<std::string> fields_of(const std::string& line) {
  std::vector<std::string> fields(1);
  bool quoted = false;
  for (const char c : line) {
    if (c == '"')
      quoted = !quoted;
    else if (c == ',' && !quoted)
      fields.emplace_back();
    else
      fields.back() += c;
  }
  return fields;
}

std::string field(const std::string& header, const std::string& line, const std::string& name) {
  const auto names = fields_of(header), values = fields_of(line);
  EXPECT_EQ(names.size(), values.size()) << line;
  for (std::size_t i = 0; i < names.size() && i < values.size(); ++i) {
    if (names[i] == name) return values[i];
  }
  ADD_FAILURE() << "no column " << name;
  return {};
}

TEST(MeasuredFigure, HoldsWhatAWholeNumberCan) {
  EXPECT_EQ(measured_figure(2.6), 3);
  EXPECT_EQ(measured_figure(-2.6), -3);
  EXPECT_EQ(measured_figure(5.7e11), std::numeric_limits<std::int32_t>::max());
  EXPECT_EQ(measured_figure(-5.7e11), -std::numeric_limits<std::int32_t>::max());
  EXPECT_EQ(measured_figure(std::nan("")), std::numeric_limits<std::int32_t>::max());
}

FrameRecord tracked_frame(std::uint32_t sequence) {
  FrameRecord r;
  r.sequence = sequence;
  r.tracked = r.has_pose = true;
  r.map_id = 1;
  r.features = 123;
  r.state = vo::State::kTracking;
  r.t_source_ns = 1403636584763555584 + static_cast<rt::TimeNs>(sequence) * 50'000'000;
  r.wall_ns = 2'000'000;
  r.thread_cpu_ns = 1'500'000;
  r.mapper_cpu_ns = 500'000;
  r.t_world_cam = {0.1, -1e-17, 1.0 / 3.0};
  r.q_world_cam = {0, 0, 0, 1};
  return r;
}

TEST(RunWriter, NamesThatAreNoTextGiveValidJson) {
  const test::TempFolder folder;
  RunWriter writer;
  ASSERT_TRUE(writer.open(folder.path(), false).ok());
  RunDescription description;
  description.sequence = "caf\xC3\xA9 \xFF\xC0\xAF \xE2\x82";
  ASSERT_TRUE(writer.finish(description).ok());
  const auto summary = nlohmann::json::parse(read_file(folder / "summary.json"));
  const std::string sequence = summary["sequence"];
  EXPECT_EQ(sequence.find("caf\xC3\xA9 \xEF\xBF\xBD"), 0u) << sequence;
}

TEST(Statistics, PercentilesInterpolateAsNumpy) {
  const Statistics s = statistics_of({4, 1, 3, 2});
  EXPECT_DOUBLE_EQ(s.median, 2.5);
  EXPECT_DOUBLE_EQ(s.p95, 3.85);
  EXPECT_DOUBLE_EQ(s.p99, 3.97);
  EXPECT_EQ(s.max, 4);
  EXPECT_EQ(s.mean, 2.5);
  EXPECT_EQ(statistics_of({7}).p99, 7);
  EXPECT_EQ(statistics_of({}).max, 0);
  EXPECT_GT(peak_memory_mb(), 1.0);
}

TEST(RunWriter, WritesALineForEveryPictureAndPosesForThoseThatHaveOne) {
  const TempFolder folder;
  RunWriter writer;
  ASSERT_TRUE(writer.open(folder / "out", false).ok());
  FrameRecord first = tracked_frame(0);
  first.tracked = first.has_pose = false;
  first.state = vo::State::kInitialising;
  first.reason.assign("parallax too small: 33 of 100");
  first.repeated = true;
  FrameRecord bad;
  bad.sequence = 2;
  bad.fate = FrameFate::kBadPicture;
  bad.t_source_ns = tracked_frame(2).t_source_ns;
  bad.reason.assign("rgb/2.png: \"cut off\", really");
  FrameRecord coasted = tracked_frame(3);
  coasted.tracked = false;
  coasted.state = vo::State::kCoasting;
  FrameRecord judged = tracked_frame(4);
  judged.t_capture_ns = 7'000'000'000;  // another clock than the source's
  judged.reference_id = 7;
  judged.t_reference_ns = judged.t_capture_ns - 550'000'000;
  judged.t_ref_cam = {0.5, 0, 0};
  judged.q_ref_cam = {0, 0, 0, 1};
  judged.reference_covariance.front() = 0.25;
  judged.reference_covariance.back() = 0.125;
  judged.median_depth = 3.5;
  judged.metric = true;
  judged.inertial.time_offset_s = 0.003;
  judged.frame_id = 2;
  judged.trust = 0.75;
  judged.keyframe_reason = "turned";
  judged.mapping.messages = 2;
  judged.mapping.points = 300;
  judged.mapping.adjustments = 1;
  judged.mapping.rms_after_px = 0.25;
  for (const FrameRecord& r : {first, tracked_frame(1), bad, coasted, judged}) ASSERT_TRUE(writer.take(r).ok());
  ASSERT_TRUE(writer.finish({"1.2.3", "a \"quoted\" folder", "sequential", "max", 7, ""}).ok());

  const auto trajectory = lines_of(read_file(folder / "out/trajectory.tum"));
  ASSERT_EQ(trajectory.size(), 3u) << "a comment and two tracked frames";
  EXPECT_EQ(trajectory[1], "1403636584.813555584 0.1 -1e-17 0.3333333333333333 0 0 0 1 1");

  const auto frames = lines_of(read_file(folder / "out/frames.csv"));
  ASSERT_EQ(frames.size(), 6u);
  EXPECT_THAT(frames[0], testing::StartsWith("t,ms,thread_cpu_ms,proc_cpu_ms,tracked,map_id,state,features,"));
  EXPECT_EQ(field(frames[0], frames[1], "t"), "1403636584.763555584");
  EXPECT_EQ(field(frames[0], frames[1], "tracked"), "0");
  EXPECT_EQ(field(frames[0], frames[1], "map_id"), "") << "empty when untracked";
  EXPECT_EQ(field(frames[0], frames[1], "reason"), "parallax too small: 33 of 100");
  EXPECT_EQ(field(frames[0], frames[2], "map_id"), "1");
  EXPECT_EQ(field(frames[0], frames[2], "ms"), "2.0000");
  EXPECT_EQ(field(frames[0], frames[2], "thread_cpu_ms"), "1.5000");
  EXPECT_EQ(field(frames[0], frames[2], "proc_cpu_ms"), "2.0000") << "tracking and mapping";
  EXPECT_EQ(field(frames[0], frames[2], "age_ms"), "") << "capture times of a replay are no moments of this clock";
  EXPECT_EQ(field(frames[0], frames[3], "fate"), "bad");
  EXPECT_EQ(field(frames[0], frames[3], "state"), "TRACKING") << "the state that holds meanwhile";
  EXPECT_EQ(field(frames[0], frames[4], "tracked"), "0") << "a coasted pose is not tracked";
  for (const std::string& line : {frames[1], frames[2], frames[5]})
    EXPECT_EQ(fields_of(line).size(), fields_of(frames[0]).size()) << line;
  EXPECT_EQ(field(frames[0], frames[2], "keyframe_reason"), "");
  EXPECT_EQ(field(frames[0], frames[2], "map_messages"), "") << "the mapper did nothing";
  EXPECT_EQ(field(frames[0], frames[5], "keyframe_reason"), "turned");
  EXPECT_EQ(field(frames[0], frames[5], "map_messages"), "2");
  EXPECT_EQ(field(frames[0], frames[5], "map_points"), "300");
  EXPECT_EQ(field(frames[0], frames[5], "ba_runs"), "1");
  EXPECT_EQ(field(frames[0], frames[5], "ba_rms_after_px"), "0.2500");

  const auto poses = lines_of(read_file(folder / "out/pose.csv"));
  ASSERT_EQ(poses.size(), 4u) << "two tracked and one coasted";
  EXPECT_EQ(field(poses[0], poses[2], "state"), "COASTING");
  EXPECT_EQ(fields_of(poses[0]).size(), 11u + 21u + 9u + 21u + 1u + 22u + 6u)
      << "pose, reference, depth, what is inertial, the earth";
  for (const std::string& line : poses) EXPECT_EQ(fields_of(line).size(), fields_of(poses[0]).size()) << line;
  EXPECT_EQ(field(poses[0], poses[1], "ref_id"), "0") << "no reference is told as none";
  EXPECT_EQ(field(poses[0], poses[1], "ref_t"), "");
  EXPECT_EQ(field(poses[0], poses[3], "ref_id"), "7");
  EXPECT_EQ(field(poses[0], poses[3], "ref_t"), "1403636584.413555584") << "in the source's time, 0.55 s before";
  EXPECT_EQ(field(poses[0], poses[3], "rtx"), "0.5");
  EXPECT_EQ(field(poses[0], poses[3], "rqw"), "1");
  EXPECT_EQ(field(poses[0], poses[3], "r00"), "0.25");
  EXPECT_EQ(field(poses[0], poses[3], "r55"), "0.125");
  EXPECT_EQ(field(poses[0], poses[3], "median_depth"), "3.5");
  EXPECT_EQ(field(poses[0], poses[3], "time_offset"), "0.003");
  EXPECT_EQ(field(poses[0], poses[3], "frame_id"), "2");
  EXPECT_EQ(field(poses[0], poses[3], "trust"), "0.75");
  EXPECT_EQ(field(poses[0], poses[1], "frame_id"), "") << "in no navigation frame";

  const auto summary = nlohmann::json::parse(read_file(folder / "out/summary.json"));
  EXPECT_EQ(summary["frames"], 5);
  EXPECT_EQ(summary["tracked"], 2);
  EXPECT_EQ(summary["tracked_share"], 0.4);
  EXPECT_EQ(summary["tracked_share_after_first_pose"], 0.5);
  EXPECT_EQ(summary["first_pose_after_frames"], 1);
  EXPECT_EQ(summary["first_pose_after_ms"], 50.0);
  EXPECT_EQ(summary["bad_pictures"], 1);
  EXPECT_EQ(summary["repeated_pictures"], 1);
  EXPECT_EQ(summary["pictures_hz"], 20.0) << "five pictures, 50 ms apart";
  EXPECT_EQ(summary["poses_hz"], 8.0) << "two of five";
  EXPECT_EQ(summary["sequence"], "a \"quoted\" folder");
}

TEST(RunWriter, AtRealPaceTheAgeOfAPoseIsTold) {
  const TempFolder folder;
  RunWriter writer;
  ASSERT_TRUE(writer.open(folder.path(), true).ok());
  FrameRecord r = tracked_frame(0);
  r.t_capture_ns = 5'000'000'000;
  r.t_done_ns = 5'003'000'000;
  ASSERT_TRUE(writer.take(r).ok());
  ASSERT_TRUE(writer.finish({}).ok());
  const auto frames = lines_of(read_file(folder / "frames.csv"));
  EXPECT_EQ(field(frames[0], frames[1], "age_ms"), "3.0000");
  EXPECT_EQ(nlohmann::json::parse(read_file(folder / "summary.json"))["age_ms"]["median"], 3.0);
}

TEST(RunWriter, WhatBecameOfTheFixesIsInTheSummary) {
  const auto told = [](const EarthRecord& earth, bool metric) {
    const TempFolder folder;
    RunWriter writer;
    EXPECT_TRUE(writer.open(folder.path(), false).ok());
    FrameRecord r = tracked_frame(0);
    r.metric = metric;
    r.earth = earth;
    EXPECT_TRUE(writer.take(r).ok());
    EXPECT_TRUE(writer.finish({}).ok());
    return nlohmann::json::parse(read_file(folder / "summary.json"))["earth"];
  };
  EarthRecord earth;
  EXPECT_TRUE(told(earth, true).is_null()) << "none came";
  earth.fixes = 9;
  earth.fixes_refused = 2;
  EXPECT_EQ(told(earth, true),
            nlohmann::json::parse(R"({"north": "unknown", "fixes": 9, "fixes_used": 0, "fixes_refused": 2})"));
  EXPECT_TRUE(told(earth, false).is_null()) << "without metres";
  earth.known = true;
  earth.heading = M_PI / 2;
  earth.fixes_used = 7;
  EXPECT_EQ(told(earth, true)["north"], "known");
  EXPECT_EQ(told(earth, true)["heading_deg"], 90);
  EXPECT_EQ(told(earth, true)["fixes_used"], 7);
  earth.held = true;
  EXPECT_EQ(told(earth, true)["north"], "held");
  earth.broken = true;
  EXPECT_EQ(told(earth, true)["north"], "broken") << "what is held is no surer than that";
}

TEST(RunWriter, ARunWithoutAnyPoseHasASummaryToo) {
  const TempFolder folder;
  RunWriter writer;
  ASSERT_TRUE(writer.open(folder.path(), false).ok());
  ASSERT_TRUE(writer.finish({}).ok());
  EXPECT_THAT(read_file(folder / "summary.json"), HasSubstr("\"first_pose_after_frames\": null,"));
}

TEST(RunWriter, ResultsOfAnEarlierRunDoNotOutliveAFailedOne) {
  const TempFolder folder;
  write_file(folder / "summary.json", "{}");
  write_file(folder / "frames.csv", "old");
  {
    RunWriter writer;
    ASSERT_TRUE(writer.open(folder.path(), false).ok());
    ASSERT_TRUE(writer.take(tracked_frame(0)).ok());
  }
  EXPECT_TRUE(fs::is_empty(folder.path())) << "neither old files nor half a new one";
}

TEST(RunWriter, AFullDiskEndsTheRunAndLeavesNothing) {
  const TempFolder folder;
  std::string error;
  {
    RunWriter writer;
    ASSERT_TRUE(writer.open(folder.path(), false).ok());
    const FileSizeLimit limit(20'000);
    for (std::uint32_t i = 0; i < 1000 && error.empty(); ++i) {
      const auto taken = writer.take(tracked_frame(i));
      if (!taken.ok()) error = taken.error().message;
    }
  }
  EXPECT_THAT(error, HasSubstr("cannot be written: File too large"));
  EXPECT_TRUE(fs::is_empty(folder.path()));
}

TEST(RunWriter, ADiskThatFillsUpInTheLastFlushLeavesNothingEither) {
  const TempFolder folder;
  std::string error;
  {
    RunWriter writer;
    ASSERT_TRUE(writer.open(folder.path(), false).ok());
    FrameRecord untracked = tracked_frame(0);
    untracked.tracked = untracked.has_pose = false;
    for (int i = 0; i < 10; ++i) ASSERT_TRUE(writer.take(untracked).ok()) << "buffered";
    const FileSizeLimit limit(512);  // trajectory.tum, a line of comment, still fits
    const auto finished = writer.finish({});
    ASSERT_FALSE(finished.ok());
    error = finished.error().message;
  }
  EXPECT_THAT(error, HasSubstr("frames.csv: cannot be written: File too large"));
  EXPECT_TRUE(fs::is_empty(folder.path()));
}

TEST(RunWriter, RefusesAFolderThatCannotBe) {
  const TempFolder folder;
  write_file(folder / "file", "x");
  RunWriter in_file;
  EXPECT_FALSE(in_file.open(folder / "file", false).ok());
  RunWriter below_file;
  const auto opened = below_file.open(folder / "file/below", false);
  ASSERT_FALSE(opened.ok());
  EXPECT_THAT(opened.error().message, HasSubstr("file/below: cannot be created"));
}

TEST(EventLine, SaysWhatWhyFigureAndLimit) {
  const rt::TimeNs first = rt::kNsPerSecond;
  const rt::TimeNs t = 13'430 * rt::kNsPerMs;
  using rt::LogLevel;
  EXPECT_EQ(event_line({t, LogLevel::kWarning, "state", "COASTING", "matched features", 12, 30, "TRACKING"}, first),
            "t=12.43 s TRACKING -> COASTING: matched features 12, limit 30");
  EXPECT_EQ(event_line({first, LogLevel::kInfo, "state", "INITIALISING", "first view", 0, 0}, first),
            "t=0.00 s INITIALISING: first view");
  EXPECT_EQ(event_line({t, LogLevel::kWarning, "IMU silent", "", "for [s]", 0.52, 0.5}, first),
            "t=12.43 s IMU silent: for [s] 0.52, limit 0.5");
  EXPECT_EQ(event_line({t, LogLevel::kWarning, "rung down", "small_input", "slips", 2, 2, "full"}, first),
            "t=12.43 s rung down full -> small_input: slips 2, limit 2");
}

}  // namespace output_test
}  // namespace godwit::app
