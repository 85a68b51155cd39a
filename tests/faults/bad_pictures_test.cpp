// Every kind of bad picture in the middle of tum_fr1_xyz: nothing wrong is told, and it goes on afterwards.
#include <array>
#include <cstdio>
#include <gtest/gtest.h>
#include <numbers>
#include <random>

#include "tests/faults/fault_run.h"

namespace godwit::test::bad_pictures_test {
namespace {

constexpr int kStart = 100;  ///< first picture of the sequence that is flown
constexpr int kFault = 80;   ///< pictures before the fault
constexpr int kAfter = 45;   ///< and after it
constexpr double kWrongMetres = 0.05, kWrongDegrees = 3.0;

struct Outcome {
  int tracked_in_fault = 0;
  int wrong = 0;          ///< tracked frames that are off, or show nothing of the scene
  int back_after = -1;    ///< frames from the end of the fault to the first tracked one; -1: never
  int tracked_after = 0;  ///< tracked frames after the fault
  std::uint32_t map_before = 0, map_after = 0;
};

class BadPictures : public testing::Test {
 protected:
  void SetUp() override {
    std::string folder;
    need_sequence("tum_fr1_xyz", &folder);
    if (folder.empty()) return;
    recording_ = Recording::load(folder, kStart, kFault + 60 + kAfter);
    width_ = recording_.calibration.width;
    height_ = recording_.calibration.height;
  }

  /// The pictures as recorded.
  std::vector<Shown> plain() const {
    std::vector<Shown> out;
    for (std::size_t i = 0; i < recording_.pictures.size(); ++i)
      out.push_back({&recording_.pictures[i], recording_.times[i], static_cast<int>(i)});
    return out;
  }

  /// Keeps a picture alive for the run.
  const Pixels* keep(Pixels p) {
    made_.push_back(std::make_unique<Pixels>(std::move(p)));
    return made_.back().get();
  }

  /// Every pixel through a function of value and place.
  template <typename Change>
  const Pixels* changed(const Pixels& from, const Change& change) {
    Pixels p(from.size());
    for (int y = 0; y < height_; ++y)
      for (int x = 0; x < width_; ++x) {
        const auto i = static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) + static_cast<std::size_t>(x);
        p[i] = static_cast<std::uint8_t>(std::clamp(static_cast<double>(change(from[i], x, y)), 0.0, 255.0));
      }
    return keep(std::move(p));
  }

  /// Uniform grey with a sensor's noise.
  const Pixels* noisy(int grey) {
    Pixels p(static_cast<std::size_t>(width_) * static_cast<std::size_t>(height_));
    for (auto& v : p) v = static_cast<std::uint8_t>(std::clamp(grey + static_cast<int>(random_() % 5) - 2, 0, 255));
    return keep(std::move(p));
  }

  Outcome fly_and_judge(const std::vector<Shown>& shown, std::size_t fault_end, std::size_t fault = kFault) const {
    const auto records = fly(recording_.calibration, shown);
    EXPECT_EQ(records.size(), shown.size());
    Outcome o;
    for (std::size_t i = 0; i < fault; ++i)
      if (records[i].tracked) o.map_before = records[i].map_id;
    const auto e = errors(recording_, shown, records, o.map_before, [fault](std::size_t i) { return i < fault; });
    for (std::size_t i = 0; i < records.size(); ++i) {
      const app::FrameRecord& r = records[i];
      EXPECT_FALSE(r.fate == app::FrameFate::kProcessed && r.reason.view().empty())
          << "frame " << i << " gives no reason";
      // A picture shown again carries no pose and leaves the state alone until it lasts.
      const bool again = i > 0 && shown[i].pixels != nullptr && shown[i].pixels == shown[i - 1].pixels;
      EXPECT_EQ(r.tracked, !again && r.state == vo::State::kTracking) << i;
      if (!r.tracked) continue;
      if (i >= fault && i < fault_end) ++o.tracked_in_fault;
      if (shown[i].truth_index < 0) ++o.wrong;
      if (e[i].known && (e[i].metres > kWrongMetres || e[i].degrees > kWrongDegrees)) {
        ++o.wrong;
        std::printf("  frame %zu: %.3f m and %.2f deg off, %d features\n", i, e[i].metres, e[i].degrees, r.features);
      }
      if (i >= fault_end) {
        if (o.back_after < 0) o.back_after = static_cast<int>(i - fault_end);
        ++o.tracked_after;
        o.map_after = r.map_id;
      }
    }
    std::printf("  tracked in the fault %d of %zu, wrong %d, back after %d, then %d of %zu\n", o.tracked_in_fault,
                fault_end - fault, o.wrong, o.back_after, o.tracked_after, records.size() - fault_end);
    return o;
  }

  void expect_back(const Outcome& o) const {
    EXPECT_EQ(o.wrong, 0);
    EXPECT_GE(o.back_after, 0);
    EXPECT_LE(o.back_after, 30);
    EXPECT_EQ(o.map_after, o.map_before);
    EXPECT_GE(o.tracked_after, kAfter - 31);
  }

  Recording recording_;
  int width_ = 0, height_ = 0;
  std::mt19937 random_{7};

 private:
  std::vector<std::unique_ptr<Pixels>> made_;
};

TEST_F(BadPictures, ExposureJumpsAreTrackedThrough) {
  auto shown = plain();
  for (std::size_t i = kFault; i < kFault + 60; ++i) {
    const double gain = (i / 10) % 2 == 0 ? 0.55 : 1.3;
    shown[i].pixels = changed(*shown[i].pixels, [&](int v, int, int) { return gain * v + 5.0; });
  }
  const Outcome o = fly_and_judge(shown, kFault + 60);
  expect_back(o);
  // Of six jumps three cost their own picture (58 before first maps were aligned anew with their own warp).
  EXPECT_GE(o.tracked_in_fault, 57);
}

TEST_F(BadPictures, FlickerInBandsIsTrackedThrough) {
  auto shown = plain();
  for (std::size_t i = kFault; i < kFault + 60; ++i) {
    const double phase = 2.1 * static_cast<double>(i);
    shown[i].pixels = changed(*shown[i].pixels, [&](int v, int, int y) {
      return v * (1.0 + 0.2 * std::sin(phase + 2.0 * std::numbers::pi * y / height_));
    });
  }
  const Outcome o = fly_and_judge(shown, kFault + 60);
  expect_back(o);
  EXPECT_GE(o.tracked_in_fault, 54);
}

TEST_F(BadPictures, BlurredFramesTellNothingWrong) {
  constexpr int kReach = 12;  // a smear of 25 pixels along the rows
  constexpr std::array kFaults{60u, 70u, 80u, 90u, 100u};
  int at_once = 0;
  for (const std::size_t fault : kFaults) {
    auto shown = plain();
    for (std::size_t i = fault; i < fault + 10; ++i) {
      const Pixels& from = *shown[i].pixels;
      shown[i].pixels = changed(from, [&](int, int x, int y) {
        double sum = 0;
        for (int d = -kReach; d <= kReach; ++d)
          sum += from[static_cast<std::size_t>(y * width_ + std::clamp(x + d, 0, width_ - 1))];
        return sum / (2 * kReach + 1);
      });
    }
    const Outcome o = fly_and_judge(shown, fault + 10, fault);
    EXPECT_EQ(o.wrong, 0) << fault;
    EXPECT_EQ(o.map_after, o.map_before) << fault;
    ASSERT_GE(o.back_after, 0) << fault;
    at_once += o.back_after <= 1;
    // Where nothing is seen until the camera has gone on, it has to come to where a keyframe was. Of eight places that
    // was so at one (33 pictures).
    EXPECT_LE(o.back_after, 45) << fault;
  }
  EXPECT_GE(at_once, static_cast<int>(kFaults.size()) - 1);
}

TEST_F(BadPictures, BlackForHalfASecondAndWhiteForTwoAreNotTracked) {
  for (const auto& [grey, frames] : {std::pair(3, 15), std::pair(252, 60), std::pair(3, 60)}) {
    auto shown = plain();
    for (std::size_t i = kFault; i < kFault + static_cast<std::size_t>(frames); ++i) {
      shown[i].pixels = noisy(grey);
      shown[i].truth_index = -1;
    }
    const Outcome o = fly_and_judge(shown, kFault + static_cast<std::size_t>(frames));
    expect_back(o);
    EXPECT_EQ(o.tracked_in_fault, 0);
  }
}

TEST_F(BadPictures, AFrozenCameraGivesNoPose) {
  auto shown = plain();
  for (std::size_t i = kFault; i < kFault + 30; ++i) shown[i].pixels = shown[kFault - 1].pixels;
  const Outcome o = fly_and_judge(shown, kFault + 30);
  expect_back(o);
  EXPECT_EQ(o.tracked_in_fault, 0) << "a frozen pose is never sent";
}

TEST_F(BadPictures, RepeatedFramesCountOnce) {
  auto shown = plain();
  for (std::size_t i = kFault; i < kFault + 30; i += 3) shown[i].pixels = shown[i - 1].pixels;
  const Outcome o = fly_and_judge(shown, kFault + 30);
  expect_back(o);
  EXPECT_EQ(o.tracked_in_fault, 20);
}

TEST_F(BadPictures, DroppedAndUnreadableFramesAreBridged) {
  auto shown = plain();
  std::vector<Shown> kept;
  for (std::size_t i = 0; i < shown.size(); ++i) {
    if (i >= kFault && i < kFault + 30 && i % 2 == 0) continue;                        // never came
    if (i >= kFault + 30 && i < kFault + 45 && i % 3 == 0) shown[i].pixels = nullptr;  // came spoilt
    kept.push_back(shown[i]);
  }
  const Outcome o = fly_and_judge(kept, kFault + 15 + 15);
  expect_back(o);
  EXPECT_GE(o.tracked_in_fault, 22);
}

TEST_F(BadPictures, SwappedNeighboursAreTrackedAsWhatTheyShow) {
  auto shown = plain();
  for (std::size_t i = kFault; i + 1 < kFault + 30; i += 2) {
    std::swap(shown[i].pixels, shown[i + 1].pixels);
    std::swap(shown[i].truth_index, shown[i + 1].truth_index);
  }
  const Outcome o = fly_and_judge(shown, kFault + 30);
  expect_back(o);
  EXPECT_GE(o.tracked_in_fault, 25);
}

TEST_F(BadPictures, TimesThatStandStillJumpOrGoBackDoNoHarm) {
  auto shown = plain();
  for (std::size_t i = kFault; i < kFault + 30; ++i) {
    if (i % 5 == 0) shown[i].t_ns = shown[i - 1].t_ns;
    if (i % 7 == 0) shown[i].t_ns += 100 * rt::kNsPerMs;
    if (i % 11 == 0) shown[i].t_ns -= 200 * rt::kNsPerMs;
  }
  const Outcome o = fly_and_judge(shown, kFault + 30);
  expect_back(o);
  EXPECT_GE(o.tracked_in_fault, 5) << "gaps of a third of a second are not trusted at once";
}

TEST_F(BadPictures, AHandOverTheLensComesAndGoes) {
  auto shown = plain();
  for (std::size_t i = kFault; i < kFault + 60; ++i) {
    // A dark disc grows from the right edge over 15 frames, covers all for 30, and goes again.
    const double k = static_cast<double>(i - kFault);
    const double cover = std::min({k / 15.0, 1.0, (60.0 - k) / 15.0});
    const double radius = cover * 1.3 * width_;
    shown[i].pixels = changed(*shown[i].pixels, [&](int v, int x, int y) {
      const double d = std::hypot(x - width_, y - height_ / 2);
      return d < radius ? 12.0 + 0.02 * v + static_cast<double>(random_() % 3) : static_cast<double>(v);
    });
    if (cover >= 1.0) shown[i].truth_index = -1;
  }
  expect_back(fly_and_judge(shown, kFault + 60));
}

}  // namespace
}  // namespace godwit::test::bad_pictures_test
