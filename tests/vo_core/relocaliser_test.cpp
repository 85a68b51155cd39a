// Tiny pictures and the guesses made of them.
#include "vo_core/tracking/relocaliser.h"

#include <gtest/gtest.h>
#include <memory>
#include <random>
#include <vector>

#include "tests/vo_core/synthetic_scene.h"
#include "vo_core/image/pyramid.h"

namespace godwit::vo {
namespace relocaliser_test {

CameraModel camera() {
  return CameraModel::pinhole_radtan(320, 240, 260, 260, 160, 120, {}).value();
}

/// A rendered picture with its pyramid.
struct View {
  explicit View(const SE3& T, double gain = 1.0, double offset = 0.0)
      : picture(test::SyntheticScene::general().render(camera(), T, gain, offset)),
        storage(pyramid_bytes(320, 240, rt::kPyramidLevels)),
        pyramid(build_pyramid(picture.view(), rt::kPyramidLevels, storage.data(), storage.size())) {}
  test::Picture picture;
  struct Aligned {
    explicit Aligned(std::size_t n) : memory(n + 64), bytes(n) {}
    std::vector<std::uint8_t> memory;
    std::size_t bytes;
    std::uint8_t* data() {
      const auto address = reinterpret_cast<std::uintptr_t>(memory.data());
      return memory.data() + (64 - address % 64) % 64;
    }
    std::size_t size() const { return bytes; }
  } storage;
  rt::PyramidView pyramid;
};

SE3 turned(double yaw, double roll) {
  return {so3_exp(Vec3(0, 0, roll)) * so3_exp(Vec3(0, yaw, 0)), Vec3::Zero()};
}

TEST(Thumbnail, LooksLikeItselfAndNotLikeFlatGrey) {
  const View v{SE3()};
  const Thumbnail t = make_thumbnail(v.pyramid, {}, 0.0);
  const ThumbnailMatch m = match_thumbnails(t, t);
  EXPECT_GT(m.correlation, 0.999f);
  EXPECT_EQ(m.dx, 0);
  EXPECT_EQ(m.dy, 0);
  Thumbnail flat = t;
  flat.value.fill(0);
  EXPECT_LT(match_thumbnails(t, flat).correlation, 0.0f);
}

TEST(Thumbnail, DarknessAndFlatGreyShowNothingButGravelDoes) {
  EXPECT_FALSE(shows_nothing(View{SE3()}.pyramid));
  View v{SE3(), 0.0, 3.0};
  const auto shown = [&] {
    return !shows_nothing(build_pyramid(v.picture.view(), rt::kPyramidLevels, v.storage.data(), v.storage.size()));
  };
  EXPECT_FALSE(shown());
  v.picture.add_noise(2.0, 1);
  EXPECT_FALSE(shown()) << "a sensor's noise in the dark";
  std::minstd_rand engine(5);
  for (int y = 0; y < 240; y += 3) {
    for (int x = 0; x < 320; x += 3)
      v.picture.fill_rectangle(x, y, x + 3, y + 3, static_cast<std::uint8_t>(80 + engine() % 40));
  }
  EXPECT_TRUE(shown()) << "gravel";
}

TEST(Thumbnail, WhatMovesIsLeftOut) {
  const View v{SE3()};
  // The left half is masked; there the other picture shows something else.
  std::vector<std::uint8_t> mask_pixels(20 * 15, 0);
  rt::MaskPyramidView mask;
  mask.levels = rt::kPyramidLevels;
  for (int y = 0; y < 15; ++y)
    for (int x = 0; x < 10; ++x) mask_pixels[static_cast<std::size_t>(y * 20 + x)] = 255;
  mask.level[rt::kPyramidLevels - 1] = {mask_pixels.data(), 20, 15, 20};
  test::Picture other = v.picture;
  for (int y = 0; y < 240; ++y)
    for (int x = 0; x < 160; ++x) other(x, y) = static_cast<std::uint8_t>(255 - v.picture.view().at(159 - x, y));
  View::Aligned storage(pyramid_bytes(320, 240, rt::kPyramidLevels));
  const rt::PyramidView pyramid = build_pyramid(other.view(), rt::kPyramidLevels, storage.data(), storage.size());
  const Thumbnail all = make_thumbnail(v.pyramid, {}, 0);
  EXPECT_GT(match_thumbnails(all, make_thumbnail(pyramid, mask, 0)).correlation, 0.95f);
  EXPECT_LT(match_thumbnails(all, make_thumbnail(pyramid, {}, 0)).correlation, 0.9f);
}

TEST(Thumbnail, BrightnessDoesNotMatter) {
  const View a{SE3()}, b{SE3(), 0.5, 60.0};
  EXPECT_GT(match_thumbnails(make_thumbnail(a.pyramid, {}, 0), make_thumbnail(b.pyramid, {}, 0)).correlation, 0.95f);
}

TEST(Thumbnail, ShiftFollowsTheTurnOfTheCamera) {
  const View a{SE3()};
  // A turn about the y axis moves the picture sideways by f * tan(angle) = 64 px, four cells.
  const View b{turned(std::atan(64.0 / 260.0), 0.0)};
  const ThumbnailMatch m = match_thumbnails(make_thumbnail(a.pyramid, {}, 0), make_thumbnail(b.pyramid, {}, 0));
  EXPECT_GT(m.correlation, 0.8f);
  EXPECT_EQ(m.dx, 4);
  EXPECT_EQ(m.dy, 0);
}

class RelocaliserTest : public testing::Test {
 protected:
  void add(int place, const View& v) {
    map_.insert_keyframe(place, static_cast<std::uint32_t>(place + 1));
    relocaliser_.add_keyframe(place, static_cast<std::uint32_t>(place + 1), v.pyramid, {});
  }
  const CameraModel camera_ = camera();
  Relocaliser relocaliser_{camera_, RelocaliserOptions{}};
  Map map_;
};

TEST_F(RelocaliserTest, AnEmptyMapAndAFlatPictureGiveNoGuess) {
  const View v{SE3()}, black{SE3(), 0.0, 3.0};
  EXPECT_EQ(relocaliser_.guess(map_, v.pyramid, {}, 0).place, -1);
  add(0, v);
  EXPECT_EQ(relocaliser_.guess(map_, v.pyramid, {}, 0).place, 0);
  EXPECT_EQ(relocaliser_.guess(map_, black.pyramid, {}, 0).place, -1);
}

TEST_F(RelocaliserTest, ANearKeyframeComesFirstAndTheTurnAgainstItIsGuessed) {
  const std::vector<double> yaw = {-0.5, -0.25, 0.0, 0.25, 0.5};
  for (std::size_t i = 0; i < yaw.size(); ++i) add(static_cast<int>(i), View{turned(yaw[i], 0)});
  const View now{turned(0.29, 0)};
  const RelocalisationGuess g = relocaliser_.guess(map_, now.pyramid, {}, 0);
  ASSERT_GE(g.place, 3) << "0.25 or 0.5 rad are the neighbours of 0.29";
  const Mat3 true_turn = turned(0.29, 0).R * turned(yaw[static_cast<std::size_t>(g.place)], 0).R.transpose();
  EXPECT_LT(so3_log(g.T_cur_kf.R.transpose() * true_turn).norm(), 0.1);
}

TEST_F(RelocaliserTest, ATurnAboutTheOpticalAxisIsFoundByTheTurnedAttempts) {
  add(0, View{SE3()});
  const View now{turned(0.0, 1.3)};
  double best = 1e9;
  for (int attempt = 0; attempt < 80; ++attempt) {
    const RelocalisationGuess g = relocaliser_.guess(map_, now.pyramid, {}, attempt);
    if (g.place == 0) best = std::min(best, so3_log(g.T_cur_kf.R.transpose() * turned(0.0, 1.3).R).norm());
  }
  EXPECT_LT(best, 0.2);
}

TEST_F(RelocaliserTest, AKeyframeThatWasReplacedIsNotTakenForTheNewOne) {
  add(0, View{SE3()});
  map_.remove_keyframe(0);
  map_.insert_keyframe(0, 99);  // its small picture has not been given
  const View now{SE3()};
  EXPECT_EQ(relocaliser_.guess(map_, now.pyramid, {}, 0).place, -1);
}

}  // namespace relocaliser_test
}  // namespace godwit::vo
