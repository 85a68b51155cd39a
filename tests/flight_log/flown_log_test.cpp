// A flight log read back to fly by it: what is whole, and the words for what is not.
#include "firmware_app/output/flown_log.h"

#include <filesystem>
#include <fstream>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware_app/output/flight_log.h"
#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace {
namespace fs = std::filesystem;

using test::TempFolder;
using testing::HasSubstr;

constexpr rt::TimeNs kFrameNs = 33'333'333;

FrameRecord frame(std::uint64_t number) {
  FrameRecord r;
  r.sequence = static_cast<std::uint32_t>(number * 2);  // every other picture was not flown
  r.t_source_ns = static_cast<rt::TimeNs>(number) * kFrameNs;
  r.t_capture_ns = 5 * rt::kNsPerSecond + r.t_source_ns;
  r.has_pose = number > 3;
  r.t_world_cam = {0.1 * static_cast<double>(number), -0.0, 1.0 / 3.0};
  r.q_world_cam = {0, 0, 0.6, 0.8};
  r.order.number = number;
  r.order.room = static_cast<std::int32_t>(number % 9);
  r.order.deltas = static_cast<std::int32_t>(number % 2);
  r.order.feature_share = number > 5 ? 0.7 : 1.0;
  r.order.readings = number * 7;
  r.order.t_reading_ns = r.t_capture_ns - 1;
  r.order.t_detection_ns = number % 4 == 0 ? frame(number - 2).t_capture_ns : 0;
  return r;
}

FoundBoxes found(std::uint64_t number) {
  FoundBoxes out;
  out.t_capture_ns = frame(number).t_capture_ns;
  for (int i = 0; i < static_cast<int>(number % 3); ++i)
    out.boxes.push({1.5F + static_cast<float>(i), 2, 30.25F, 40, 0.1F * static_cast<float>(i + 1), i});
  return out;
}

/// A flight of so many frames; what `spoil` says true of is not handed to the log.
template <typename Spoil>
fs::path write(const fs::path& folder, std::uint64_t frames, Spoil spoil) {
  FlightLogOptions options;
  options.folder = folder.string();
  options.machine = false;
  FlightLog log(options);
  for (std::uint64_t n = 1; n <= frames; ++n) {
    if (!spoil(n)) log.frame(frame(n));
    // It comes after the frame that was masked with it, as it may.
    if (n % 4 == 0 && !spoil(n + 1000)) log.detection(found(n - 2));
  }
  EXPECT_EQ(log.finish(60 * rt::kNsPerSecond).dropped, 0u);
  fs::path last;
  for (const auto& entry : fs::directory_iterator(folder)) last = std::max(last, entry.path());
  return last;
}

fs::path write(const fs::path& folder, std::uint64_t frames) {
  return write(folder, frames, [](std::uint64_t) { return false; });
}

/// Its first bytes in a file of their own, in a folder of their own.
fs::path cut(const fs::path& file, std::size_t bytes, const fs::path& folder) {
  fs::create_directories(folder);
  std::ofstream(folder / "000001.ulg", std::ios::binary) << test::read_file(file).substr(0, bytes);
  return folder / "000001.ulg";
}

TEST(FlownLog, ComesBackToTheBit) {
  const TempFolder folder;
  const auto read = read_flown_log(write(folder.path(), 20));
  ASSERT_TRUE(read) << read.error().message;
  const FlownLog& log = read.value();
  EXPECT_EQ(log.gap, "");
  ASSERT_EQ(log.frames.size(), 20u);
  for (std::uint64_t n = 1; n <= 20; ++n) {
    const FrameRecord flown = frame(n);
    const FlownFrame& f = log.frames[n - 1];
    EXPECT_EQ(f.sequence, flown.sequence);
    EXPECT_EQ(f.t_source_ns, flown.t_source_ns);
    EXPECT_EQ(f.t_capture_ns, flown.t_capture_ns);
    EXPECT_EQ(f.order.number, n);
    EXPECT_EQ(f.order.room, flown.order.room);
    EXPECT_EQ(f.order.deltas, flown.order.deltas);
    EXPECT_EQ(f.order.feature_share, flown.order.feature_share);
    EXPECT_EQ(f.order.readings, flown.order.readings);
    EXPECT_EQ(f.order.t_reading_ns, flown.order.t_reading_ns);
    EXPECT_EQ(f.order.t_detection_ns, flown.order.t_detection_ns);
    ASSERT_EQ(f.has_pose, flown.has_pose);
    if (!f.has_pose) continue;
    EXPECT_EQ(f.t_world_cam, flown.t_world_cam);
    EXPECT_EQ(f.q_world_cam, flown.q_world_cam);
    if (f.order.t_detection_ns == 0) continue;
    const FoundBoxes boxes = found(n - 2);
    const FoundBoxes& back = log.detections.at(f.order.t_detection_ns);
    ASSERT_EQ(back.boxes.count, boxes.boxes.count);
    for (std::size_t i = 0; i < boxes.boxes.view().size(); ++i) {
      const detector::Box &a = back.boxes.box[i], &b = boxes.boxes.box[i];
      EXPECT_EQ(a.x0, b.x0);
      EXPECT_EQ(a.y0, b.y0);
      EXPECT_EQ(a.x1, b.x1);
      EXPECT_EQ(a.y1, b.y1);
      EXPECT_EQ(a.score, b.score);
      EXPECT_EQ(a.class_id, b.class_id);
      EXPECT_EQ(a.track, -1);
    }
  }
}

TEST(FlownLog, AFrameThatIsMissingIsAGap) {
  const TempFolder folder;
  const auto read = read_flown_log(write(folder.path(), 20, [](std::uint64_t n) { return n == 12; }));
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read.value().frames.size(), 11u);
  EXPECT_EQ(read.value().gap, "frame 12 of the flight is missing");
}

TEST(FlownLog, ADetectionThatIsMissingIsAGap) {
  const TempFolder folder;
  const auto read = read_flown_log(write(folder.path(), 20, [](std::uint64_t n) { return n == 1008; }));
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read.value().frames.size(), 7u);
  EXPECT_EQ(read.value().gap, "the detection is missing that came in with frame 8");
}

TEST(FlownLog, WhereverItIsCutTheFramesBeforeAreThere) {
  const TempFolder folder;
  const fs::path whole = write(folder.path() / "whole", 20);
  const std::size_t bytes = fs::file_size(whole);
  std::size_t frames = 0, none = 0;
  for (std::size_t n = 0; n < bytes; n += 7) {
    const auto read = read_flown_log(cut(whole, n, folder.path() / "cut"));
    if (!read) {
      ++none;
      continue;
    }
    EXPECT_NE(read.value().gap, "") << n;
    EXPECT_GE(read.value().frames.size() + 4, frames) << n << ": but for frames that wait for their detection";
    frames = std::max(frames, read.value().frames.size());
  }
  EXPECT_GE(frames, 19u);
  EXPECT_GT(none, 10u);
}

TEST(FlownLog, BytesThatWereChangedAreNoFlight) {
  const TempFolder folder;
  const fs::path whole = write(folder.path() / "whole", 20);
  const std::string bytes = test::read_file(whole);
  std::uint32_t random = 1;
  for (int i = 0; i < 300; ++i) {
    std::string spoilt = bytes;
    for (int k = 0; k < 3; ++k) {
      random = random * 1664525 + 1013904223;
      spoilt[(random >> 8) % spoilt.size()] = static_cast<char>(random);
    }
    std::ofstream(folder.path() / "000001.ulg", std::ios::binary) << spoilt;
    const auto read = read_flown_log(folder.path() / "000001.ulg");
    if (read) {
      EXPECT_LE(read.value().frames.size(), 20u);
    }
  }
}

TEST(FlownLog, WhatComesBeforeAGapIsFlownOnRequest) {
  const TempFolder folder;
  auto read = read_flown_log(write(folder.path(), 20, [](std::uint64_t n) { return n == 12; }));
  ASSERT_TRUE(read);
  FlownLog log = read.value();
  // Frame 11 is picture 22; of picture 23 nothing is known.
  keep_first(24, &log);
  EXPECT_NE(log.gap, "");
  EXPECT_EQ(log.frames.size(), 11u);
  keep_first(23, &log);
  EXPECT_EQ(log.gap, "");
  EXPECT_EQ(log.frames.size(), 11u);
  log = read.value();
  keep_first(10, &log);
  EXPECT_EQ(log.gap, "");
  EXPECT_EQ(log.frames.size(), 4u);
}

TEST(FlownLog, AFlightGoesOnInTheNextFile) {
  const TempFolder folder;
  FlightLogOptions options;
  options.folder = folder.path().string();
  options.machine = false;
  options.file_bytes = 4000;
  std::uint64_t n = 0;
  {
    FlightLog log(options);
    while (log.report().files < 4 && n < 100'000) {
      log.frame(frame(++n));
      if (n % 4 == 0) log.detection(found(n - 2));
      if (n % 50 == 0) rt::sleep_until_ns(rt::monotonic_now_ns() + 20 * rt::kNsPerMs);
    }
    ASSERT_EQ(log.finish(60 * rt::kNsPerSecond).dropped, 0u);
  }
  const std::uint64_t flown = n;
  write(folder.path(), 3);  // the next flight
  const auto read = read_flown_log(folder.path() / "000001.ulg");
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_EQ(read.value().gap, "");
  EXPECT_EQ(read.value().frames.size(), flown);
  const auto late = read_flown_log(folder.path() / "000002.ulg");
  ASSERT_FALSE(late);
  EXPECT_THAT(late.error().message, HasSubstr("begins in an earlier file"));
}

TEST(FlownLog, AFlightThatWasKilledDoesNotGoOnInTheNext) {
  const TempFolder folder;
  const fs::path whole = write(folder.path() / "whole", 20);
  const fs::path killed = cut(whole, fs::file_size(whole) - 10, folder.path() / "killed");
  write(folder.path() / "killed", 30);
  const auto read = read_flown_log(killed);
  ASSERT_TRUE(read);
  EXPECT_EQ(read.value().frames.size(), 20u);
  EXPECT_THAT(read.value().gap, HasSubstr("breaks off within a message at byte"));
}

TEST(FlownLog, OtherFilesAreRefused) {
  const TempFolder folder;
  EXPECT_THAT(read_flown_log(folder.path() / "none.ulg").error().message, HasSubstr("No such file"));
  EXPECT_FALSE(read_flown_log(folder.path()));
  std::ofstream(folder.path() / "text.ulg") << "this is a text of more than sixteen bytes";
  EXPECT_THAT(read_flown_log(folder.path() / "text.ulg").error().message, HasSubstr("is no ULog file"));
  EXPECT_THAT(read_flown_log(write(folder.path() / "empty", 0)).error().message, HasSubstr("holds no frame"));
}

}  // namespace
}  // namespace godwit::app
