// The line of a picture becomes one with a JPEG; what is none becomes nothing.
#include "firmware_app/commands/live_watch.h"

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "firmware_app/output/base64.h"

namespace godwit::app {
namespace {

using Json = nlohmann::json;

Json picture(int width, int height, std::size_t bytes) {
  std::string code;
  append_base64(std::vector<std::uint8_t>(bytes, 100), &code);
  return {{"picture", {{"width", width}, {"height", height}, {"sequence", 4}, {"grey", code}}}};
}

TEST(LiveWatch, APictureBecomesAJpegAndTheRestStays) {
  const Json j = Json::parse(with_jpeg(picture(64, 48, 64 * 48).dump()))["picture"];
  EXPECT_EQ(j["sequence"], 4);
  EXPECT_FALSE(j.contains("grey"));
  const auto jpeg = from_base64(j["jpeg"].get<std::string>());
  ASSERT_TRUE(jpeg);
  ASSERT_GT(jpeg->size(), 100u);
  EXPECT_EQ((*jpeg)[0], 0xFF);
  EXPECT_EQ((*jpeg)[1], 0xD8);
}

TEST(LiveWatch, WhatIsNoPictureIsNone) {
  for (const Json& j : {picture(64, 48, 64 * 48 - 1), picture(64, 48, 0), picture(0, 0, 0), picture(-1, 48, 48),
                        picture(1 << 20, 1 << 20, 4), picture(64, 49, 64 * 48)}) {
    EXPECT_EQ(with_jpeg(j.dump()), "");
  }
  for (const char* line :
       {"", "{}", "[]", "{\"picture\":", "{\"picture\":{}}", "{\"picture\":7}",
        R"({"picture":{"width":"x","height":1,"grey":""}})", R"({"picture":{"width":1,"height":1,"grey":"!!!!"}})"}) {
    EXPECT_EQ(with_jpeg(line), "") << line;
  }
}

}  // namespace
}  // namespace godwit::app
