// The picture that is told: only what is asked for, whole, and as it was.
#include "firmware_app/output/live_picture.h"

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#include <thread>

#include "firmware_app/output/base64.h"

namespace godwit::app {
namespace {

using Json = nlohmann::json;

/// A frame of one shade, which is its number.
struct Frame {
  Frame(int w, int h) : width(w), height(h), pixels(static_cast<std::size_t>(w * h)), cells(pixels.size() / 64) {
    mask.levels = 4;
    mask.level[3] = {cells.data(), w / 8, h / 8, w / 8};
    features.resize(2);
    features[0].px = {3.25F, 4.5F};
    features[0].level = 1;
    features[1].type = vo::FeatureType::kEdgelet;
    features[1].shaded = true;
  }
  void show(LivePicture* to, std::uint32_t number, rt::TimeNs now_ns = 0) {
    for (std::uint8_t& p : pixels) p = static_cast<std::uint8_t>(number);
    rt::FrameMeta meta;
    meta.sequence = number;
    meta.t_delivered_ns = now_ns;
    to->look(meta, {pixels.data(), width, height, width}, mask, features);
  }
  int width, height;
  std::vector<std::uint8_t> pixels, cells;
  rt::MaskPyramidView mask;
  std::vector<vo::FrameFeature> features;
};

Json told(LivePicture* picture, rt::TimeNs now_ns = 0) {
  std::string line;
  if (!picture->add_line(now_ns, &line)) {
    EXPECT_EQ(line, "");
    return nullptr;
  }
  EXPECT_EQ(line.find('\n'), line.size() - 1) << "one line";
  return Json::parse(line)["picture"];
}

TEST(LivePicture, TellsWhatItWasAskedForAndAsItWas) {
  Frame frame(64, 48);
  frame.cells[2] = frame.cells[3] = 255;
  LivePicture picture(64, 48);
  frame.show(&picture, 1);
  EXPECT_TRUE(told(&picture).is_null()) << "nobody had asked";
  EXPECT_TRUE(told(&picture).is_null()) << "and none has come since";
  frame.show(&picture, 2);
  frame.show(&picture, 3);
  const Json j = told(&picture);
  EXPECT_EQ(j["sequence"], 2) << "asked for one, and the next was not copied";
  EXPECT_EQ(j["width"], 64);
  EXPECT_EQ(j["height"], 48);
  EXPECT_EQ(j["step"], 1);
  EXPECT_EQ(j["features"], Json::parse(R"([[3.2,4.5,1,"c"],[0,0,0,"s"]])"));
  EXPECT_EQ(j["mask"]["columns"], 8);
  EXPECT_EQ(j["mask"]["rows"], 6);
  EXPECT_EQ(j["mask"]["runs"], Json({2, 2, 44}));
  EXPECT_EQ(from_base64(j["grey"].get<std::string>()), std::vector<std::uint8_t>(64 * 48, 2));
}

TEST(LivePicture, WithoutAMaskAndWithoutFeatures) {
  Frame frame(64, 48);
  frame.mask.levels = 0;
  frame.features.clear();
  LivePicture picture(64, 48);
  told(&picture);
  frame.show(&picture, 2);
  const Json j = told(&picture);
  EXPECT_EQ(j["features"], Json::array());
  EXPECT_EQ(j["mask"]["columns"], 0);
  EXPECT_EQ(j["mask"]["runs"], Json::array({0}));
}

TEST(LivePicture, LargeOnesAreThinned) {
  Frame frame(1280, 720);
  for (int y = 0; y < 720; ++y) frame.pixels[static_cast<std::size_t>(y * 1280)] = 9;
  LivePicture picture(1280, 720);
  told(&picture);
  frame.show(&picture, 7);
  const Json j = told(&picture);
  EXPECT_EQ(j["step"], 2);
  EXPECT_EQ(j["width"], 640);
  EXPECT_EQ(j["height"], 360);
  EXPECT_EQ(from_base64(j["grey"].get<std::string>())->size(), 640u * 360u);
}

TEST(LivePicture, WhatWasCopiedForSomebodyWhoHasGoneIsNotTold) {
  Frame frame(64, 48);
  LivePicture picture(64, 48);
  told(&picture, 0);
  frame.show(&picture, 1, 0);
  EXPECT_TRUE(told(&picture, 60 * rt::kNsPerSecond).is_null());
  frame.show(&picture, 2, 60 * rt::kNsPerSecond);
  EXPECT_EQ(told(&picture, 60 * rt::kNsPerSecond)["sequence"], 2);
}

TEST(LivePicture, IsNeverHalfOfOneAndHalfOfAnother) {
  LivePicture picture(64, 48);
  std::atomic<bool> stop{false};
  std::thread tracker([&] {
    Frame frame(64, 48);
    for (std::uint32_t i = 0; !stop.load(); ++i) frame.show(&picture, i % 256);
  });
  for (int n = 0; n < 300;) {
    const Json j = told(&picture);
    if (j.is_null()) {
      std::this_thread::yield();
      continue;
    }
    ++n;
    ASSERT_EQ(from_base64(j["grey"].get<std::string>()),
              std::vector<std::uint8_t>(64 * 48, j["sequence"].get<std::uint8_t>()));
  }
  stop.store(true);
  tracker.join();
}

}  // namespace
}  // namespace godwit::app
