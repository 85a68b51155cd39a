#include "firmware_app/sim/looped_pictures.h"

#include <array>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "firmware_app/sim/picture_memory.h"

namespace godwit::app {
namespace looped_pictures_test {

/// Pictures of 4 x 2 pixels that hold their number; some are bad.
class Numbers final : public hal::Camera {
 public:
  explicit Numbers(int total, int bad = -1) : total_(total), bad_(bad) {}
  int width() const override { return 4; }
  int height() const override { return 2; }
  int channels() const override { return 1; }
  hal::CameraStatus next(const rt::MutableImageView& grey, std::uint8_t*, rt::TimeNs, hal::CapturedFrame*,
                         std::string*) override {
    if (next_ == total_) return hal::CameraStatus::kEnd;
    for (int y = 0; y < 2; ++y) {
      for (int x = 0; x < 4; ++x) grey.row(y)[x] = static_cast<std::uint8_t>(next_);
    }
    return next_++ == bad_ ? hal::CameraStatus::kBadFrame : hal::CameraStatus::kFrame;
  }

 private:
  const int total_, bad_;
  int next_ = 0;
};

const std::atomic<bool> kGo{false};

LoopedPictures::Options at_once(std::int64_t total) {
  LoopedPictures::Options o;
  o.total = total;
  o.real_pace = false;
  return o;
}

std::vector<int> fly(LoopedPictures* camera) {
  std::vector<int> seen;
  std::array<std::uint8_t, 16> pixels{};
  hal::CapturedFrame frame;
  rt::TimeNs last = 0;
  // A stride of its own: the copy goes row by row.
  while (camera->next({pixels.data(), 4, 2, 8}, nullptr, 0, &frame, nullptr) == hal::CameraStatus::kFrame) {
    EXPECT_EQ(frame.sequence, seen.size());
    if (last != 0) {
      EXPECT_EQ(frame.t_capture_ns - last, 33'333'333);
    }
    last = frame.t_capture_ns;
    EXPECT_EQ(pixels[0], pixels[11]) << "first and last pixel";
    seen.push_back(pixels[0]);
  }
  return seen;
}

TEST(LoopedPictures, GoForthAndBackInEvenSteps) {
  Numbers source(4);
  auto camera = LoopedPictures::record(&source, 10, at_once(11), kGo);
  ASSERT_TRUE(camera.ok());
  EXPECT_EQ(camera.value()->pictures(), 4);
  EXPECT_THAT(fly(camera.value().get()), testing::ElementsAre(0, 1, 2, 3, 2, 1, 0, 1, 2, 3, 2));
  EXPECT_THAT(fly(camera.value()->again(at_once(3)).get()), testing::ElementsAre(0, 1, 2));
}

TEST(LoopedPictures, BadPicturesAreLeftOutAndTooFewRefused) {
  Numbers source(4, 1);
  auto camera = LoopedPictures::record(&source, 3, at_once(4), kGo);
  ASSERT_TRUE(camera.ok());
  EXPECT_THAT(fly(camera.value().get()), testing::ElementsAre(0, 2, 3, 2));
  Numbers one(1);
  EXPECT_EQ(LoopedPictures::record(&one, 3, at_once(4), kGo).error().message,
            "the source has 1 pictures; a flight needs two at least");
  const std::atomic<bool> stop{true};
  EXPECT_FALSE(LoopedPictures::record(&source, 3, at_once(4), stop).ok());
}

TEST(LoopedPictures, AtRealPaceAPictureComesWhenItIsDueAndWaitingIsBounded) {
  Numbers source(2);
  LoopedPictures::Options options;
  options.interval_ns = 20 * rt::kNsPerMs;
  auto camera = LoopedPictures::record(&source, 2, options, kGo);
  ASSERT_TRUE(camera.ok());
  std::array<std::uint8_t, 8> pixels{};
  hal::CapturedFrame frame;
  int timeouts = 0;
  for (int frames = 0; frames < 3;) {
    const auto status = camera.value()->next({pixels.data(), 4, 2, 4}, nullptr, rt::kNsPerMs, &frame, nullptr);
    if (status == hal::CameraStatus::kTimeout) {
      ++timeouts;
      continue;
    }
    ++frames;
    EXPECT_GE(rt::monotonic_now_ns(), frame.t_capture_ns);
  }
  EXPECT_GT(timeouts, 3);
}

TEST(PictureMemory, WhatHasNoRoomIsToldInMegabytes) {
  EXPECT_TRUE(room_for_pictures(2, 640, 480).ok());
  const auto room = room_for_pictures(1'000'000'000, 640, 480);
  ASSERT_FALSE(room.ok());
  EXPECT_THAT(room.error().message, testing::StartsWith("1000000000 pictures need 292968750 MB, and "));
}

}  // namespace looped_pictures_test
}  // namespace godwit::app
