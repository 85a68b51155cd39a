#include "detector/model_info.h"

#include <fstream>
#include <gtest/gtest.h>
#include <string>

#include "tests/support/temp_folder.h"

namespace godwit::detector::model_info_test {
namespace {

const std::string kGood = R"(layout = "yolov5"
input_width = 416
input_height = 320
channel_order = "rgb"
scale = 0.00392156862745098
letterbox = "centre"
fill = 114
classes = ["person", "chair", "car"]
movable = ["car", "person"]
sha256 = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
)";

std::string with(const std::string& from, const std::string& to) {
  std::string text = kGood;
  text.replace(text.find(from), from.size(), to);
  return text;
}

std::string why(const std::string& text) {
  const auto info = parse_model_info(text, "m.toml");
  return info.ok() ? "accepted" : info.error().message;
}

TEST(ModelInfo, ReadsEveryKey) {
  const auto parsed = parse_model_info(kGood, "m.toml");
  ASSERT_TRUE(parsed.ok()) << parsed.error().message;
  const ModelInfo& info = parsed.value();
  EXPECT_EQ(info.layout, Layout::kYolov5);
  EXPECT_EQ(info.input_width, 416);
  EXPECT_EQ(info.input_height, 320);
  EXPECT_EQ(info.channel_order, ChannelOrder::kRgb);
  EXPECT_FLOAT_EQ(info.scale, 1.F / 255.F);
  EXPECT_EQ(info.placement, Placement::kCentre);
  EXPECT_EQ(info.fill, 114);
  ASSERT_EQ(info.classes.size(), 3U);
  EXPECT_EQ(info.classes[1], "chair");
  EXPECT_EQ(info.movable, (std::vector<bool>{true, false, true}));
  EXPECT_EQ(info.output_rows(), 3 * (52 * 40 + 26 * 20 + 13 * 10));
  EXPECT_EQ(info.sha256.substr(0, 8), "ba7816bf");
}

TEST(ModelInfo, WhatALookCostsIsItsPixelsNotItsWidth) {
  ModelInfo info;
  info.input_width = info.input_height = 416;
  EXPECT_EQ(info.square_px(), 416);
  info.input_width = 480;
  info.input_height = 352;
  EXPECT_EQ(info.square_px(), 411) << "less than the square that is narrower";
}

TEST(ModelInfo, YoloxHasOneRowACell) {
  const auto parsed = parse_model_info(with("\"yolov5\"", "\"yolox\""), "m.toml");
  ASSERT_TRUE(parsed.ok());
  EXPECT_EQ(parsed.value().output_rows(), 52 * 40 + 26 * 20 + 13 * 10);
}

TEST(ModelInfo, NamesFileKeyAndWhatIsAllowed) {
  EXPECT_EQ(why(with("416", "417")), "m.toml: input_width: must be a whole number from 32 to 2048, a multiple of 32");
  EXPECT_EQ(why(with("320", "1e9")), "m.toml: input_height: must be a whole number from 32 to 2048, a multiple of 32");
  EXPECT_EQ(why(with("\"yolov5\"", "\"ssd\"")), "m.toml: layout: must be \"yolov5\" or \"yolox\"");
  EXPECT_EQ(why(with("fill = 114\n", "")), "m.toml: fill is missing; must be a whole number from 0 to 255");
  EXPECT_EQ(why(with("0.00392156862745098", "nan")), "m.toml: scale: must be a number from 1e-6 to 1e6");
  EXPECT_EQ(why(with("\"chair\"", "\"car\"")), "m.toml: classes: must be a list of 1 to 256 different names");
  EXPECT_EQ(why(with("[\"car\", \"person\"]", "[\"cat\"]")),
            "m.toml: movable: must be names out of classes, \"cat\" is none");
  EXPECT_EQ(why(with("fill", "filling")), "m.toml:7: unknown key filling");
  EXPECT_EQ(why("layout = ").substr(0, 9), "m.toml:1:");
  EXPECT_EQ(why(std::string(70'000, '#')), "m.toml: larger than 64 KiB, not a metadata file");
}

// Found by fuzzing: a key with a letter outside ASCII led toml++ into undefined behaviour.
TEST(ModelInfo, BytesOutsideAsciiAreRefusedBeforeTheParser) {
  EXPECT_EQ(why(with("input_height", "input_h\xD1\x9F")), "m.toml: holds bytes outside ASCII, not a metadata file");
}

TEST(ModelInfo, NestedBracketsWithoutEndAreAnError) {
  EXPECT_EQ(why(std::string(25, '[') + "s").substr(0, 9), "m.toml:1:");
}

TEST(ModelInfo, AFileWithAnotherChecksumIsNotTheNetwork) {
  EXPECT_EQ(why(with("ba7816bf", "BA7816BF")),
            "m.toml: sha256: must be the SHA-256 of the network's file, as sha256sum prints it");
  EXPECT_EQ(why(with("sha256 = ", "# ")),
            "m.toml: sha256 is missing; must be the SHA-256 of the network's file, as sha256sum prints it");
  const test::TempFolder folder;
  std::ofstream(folder / "net.toml") << kGood;
  std::ofstream(folder / "net.onnx") << "abc";
  EXPECT_TRUE(read_model_info(folder / "net.onnx").ok());
  std::ofstream(folder / "net.onnx") << "abd";
  const auto other = read_model_info(folder / "net.onnx");
  ASSERT_FALSE(other.ok());
  EXPECT_EQ(other.error().message.find((folder / "net.onnx") + ": not the network that " + (folder / "net.toml") +
                                       " describes: its SHA-256 is a52d159f262b2c6d"),
            0u)
      << other.error().message;
}

TEST(ModelInfo, MissingFileIsNamed) {
  const auto info = read_model_info("/nowhere/net.onnx");
  ASSERT_FALSE(info.ok());
  EXPECT_EQ(info.error().message, "/nowhere/net.toml: cannot be opened; a model needs its metadata file beside it");
}

}  // namespace
}  // namespace godwit::detector::model_info_test
