#include "detector/detector.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <gtest/gtest.h>
#include <opencv2/core.hpp>
#include <opencv2/dnn.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "detector/sha256.h"
#include "detector/tiles.h"
#include "tests/support/temp_folder.h"

namespace godwit::detector {
namespace {

namespace fs = std::filesystem;

const std::string kModels = GODWIT_MODEL_DIR;
const std::string kData = GODWIT_TEST_DATA_DIR;

std::string read(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

/// With a folder of the test's own.
class DetectorTest : public ::testing::Test {
 protected:
  std::string write(const std::string& name, const std::string& text) {
    std::ofstream(dir_ / name, std::ios::binary) << text;
    return (dir_ / name).string();
  }
  test::TempFolder folder_;
  const fs::path dir_ = folder_.path();
};

std::string why(const rt::Result<Detector>& detector) {
  return detector.ok() ? "opened" : detector.error().message;
}

/// The picture of the committed reference: every pixel follows from its place, so no file is needed.
cv::Mat reference_input(int width, int height) {
  const int sizes[] = {1, 3, height, width};
  cv::Mat blob(4, sizes, CV_32F);
  float* out = blob.ptr<float>();
  for (int c = 0; c < 3; ++c) {
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x)
        *out++ = static_cast<float>((x * 7 + y * 13 + c * 29 + (x * y) / 16) & 255) / 255.F;
    }
  }
  return blob;
}

struct Input {
  const char* model;
  int width, height;
};
std::ostream& operator<<(std::ostream& out, const Input& input) {
  return out << input.model;
}
class DeliveredModel : public ::testing::TestWithParam<Input> {};

// The reference comes from PyTorch (detector/training/export.py), before the export to ONNX.
TEST_P(DeliveredModel, AgreesWithPyTorch) {
  const Input& input = GetParam();
  const std::string name = input.model;
  const std::string reference = read(kData + "/" + name + ".reference");
  ASSERT_GE(reference.size(), 12U) << "reference is missing";
  std::int32_t header[3];  // rows in all, values a row, every how many rows is kept
  std::memcpy(header, reference.data(), sizeof header);
  const int kept = (header[0] + header[2] - 1) / header[2];
  ASSERT_EQ(reference.size(), sizeof header + sizeof(float) * static_cast<std::size_t>(kept * header[1]));
  std::vector<float> expected(static_cast<std::size_t>(kept * header[1]));
  std::memcpy(expected.data(), reference.data() + sizeof header, expected.size() * sizeof(float));

  cv::setNumThreads(1);
  cv::dnn::Net net = cv::dnn::readNetFromONNX(kModels + "/" + name + ".onnx");
  net.setInput(reference_input(input.width, input.height));
  const cv::Mat y = net.forward();
  ASSERT_EQ(y.size[1], header[0]);
  ASSERT_EQ(y.size[2], header[1]);
  double worst = 0.0;
  for (int k = 0; k < kept; ++k) {
    for (int v = 0; v < header[1]; ++v) {
      const double a = expected[static_cast<std::size_t>(k * header[1] + v)];
      const double b = y.ptr<float>()[static_cast<std::ptrdiff_t>(k) * header[2] * header[1] + v];
      // Scores against 1, boxes (pixels of the input) against their own size.
      worst = std::max(worst, std::abs(a - b) / std::max(1.0, std::abs(a)));
    }
  }
  EXPECT_LE(worst, 1e-3);
}

TEST_P(DeliveredModel, OpensWithItsMetadata) {
  const std::string path = kModels + "/" + GetParam().model + ".onnx";
  EXPECT_LT(fs::file_size(path), 8'000'000U);
  auto opened = Detector::open(path, {});
  ASSERT_TRUE(opened.ok()) << opened.error().message;
  Detector detector = std::move(opened.value());
  EXPECT_EQ(detector.info().input_width, GetParam().width);
  EXPECT_EQ(detector.info().input_height, GetParam().height);
  ASSERT_EQ(detector.info().classes.size(), 6U);
  for (int c = 0; c < 6; ++c) EXPECT_TRUE(detector.movable(c));
  EXPECT_FALSE(detector.movable(6));
  EXPECT_FALSE(detector.movable(-1));
  EXPECT_TRUE(detector.warning().empty());
  EXPECT_EQ(detector.backend(), Backend::kCpu);

  // Grey is the same as that grey in three channels, whatever came before.
  cv::Mat grey(480, 640, CV_8UC1), colour;
  cv::randu(grey, 0, 255);
  cv::GaussianBlur(grey, grey, {31, 31}, 8);
  cv::cvtColor(grey, colour, cv::COLOR_GRAY2BGR);
  BoxList a, b, c;
  ASSERT_TRUE(detector.detect({grey.data, 640, 480, 640, 1}, &a).ok());
  ASSERT_TRUE(detector.detect({colour.data, 640, 480, 640 * 3, 3}, &b).ok());
  const cv::Mat small(100, 900, CV_8UC3, cv::Scalar(1, 2, 3));
  ASSERT_TRUE(detector.detect({small.data, 900, 100, 2700, 3}, &c).ok());
  EXPECT_EQ(c.count, 0);
  ASSERT_TRUE(detector.detect({grey.data, 640, 480, 640, 1}, &c).ok());
  ASSERT_EQ(a.count, b.count);
  ASSERT_EQ(a.count, c.count);
  for (int i = 0; i < a.count; ++i)
    EXPECT_EQ(a.box[static_cast<std::size_t>(i)].x0, c.box[static_cast<std::size_t>(i)].x0);
}

INSTANTIATE_TEST_SUITE_P(Sizes, DeliveredModel,
                         ::testing::Values(Input{"cbam_yolov5n_416", 416, 416}, Input{"cbam_yolov5n_320", 320, 320},
                                           Input{"cbam_yolov5n_480x352", 480, 352}, Input{"yolox_nano_416", 416, 416},
                                           Input{"yolox_nano_320", 320, 320}, Input{"cbam_yolox_nano_416", 416, 416}),
                         [](const auto& input) { return std::string(input.param.model); });

/// How many boxes that the one is sure of, in pictures of COCO, and how many of them the other finds as well.
struct Shared {
  int sure = 0, same = 0;
};
Shared boxes_in_common(Detector* one, Detector* other, const std::vector<fs::path>& pictures,
                       const std::function<bool(const cv::Mat&)>& looked_at,
                       const std::function<bool(const Box&)>& is_sure) {
  Shared out;
  for (const fs::path& path : pictures) {
    const cv::Mat image = cv::imread(path.string());
    if (out.sure >= 25) break;
    if (!looked_at(image)) continue;
    const PictureView view{image.data, image.cols, image.rows, static_cast<int>(image.step[0]), 3};
    BoxList a, b;
    EXPECT_TRUE(one->detect(view, &a).ok());
    EXPECT_TRUE(other->detect(view, &b).ok());
    for (const Box& box : a.view()) {
      if (!is_sure(box)) continue;
      ++out.sure;
      out.same += std::any_of(b.view().begin(), b.view().end(), [&](const Box& found) {
        return found.class_id == box.class_id && overlap(found, box) > 0.7F;
      });
    }
  }
  return out;
}

/// In the order of their names; none where the shared data has none.
std::vector<fs::path> coco_pictures() {
  const char* shared = std::getenv("GODWIT_SHARED_DIR");
  const std::string root = std::string(shared != nullptr ? shared : "") + "/data/detection/coco256/images/val2017";
  std::vector<fs::path> out;
  if (shared == nullptr || !fs::exists(root)) return out;
  for (const auto& entry : fs::directory_iterator(root)) out.push_back(entry.path());
  std::sort(out.begin(), out.end());
  return out;
}

class CocoPictures : public DetectorTest {
 protected:
  void SetUp() override {
    DetectorTest::SetUp();
    if (!pictures_.empty()) return;
    ASSERT_STRNE(std::getenv("CI") != nullptr ? std::getenv("CI") : "", "true") << "shared data is missing";
    GTEST_SKIP() << "GODWIT_SHARED_DIR has no detection pictures";
  }
  const std::vector<fs::path> pictures_ = coco_pictures();
};

// One set of weights in two inputs: what a picture of a camera shows is in the same places.
TEST_F(CocoPictures, ARectangularInputFindsTheSameAsASquareOne) {
  auto square = Detector::open(kModels + "/cbam_yolov5n_416.onnx", {});
  auto wide = Detector::open(kModels + "/cbam_yolov5n_480x352.onnx", {});
  ASSERT_TRUE(square.ok() && wide.ok());
  const Shared found = boxes_in_common(
      &square.value(), &wide.value(), pictures_, [](const cv::Mat& image) { return image.cols >= image.rows; },
      [](const Box& box) { return box.score >= 0.7F; });
  ASSERT_GE(found.sure, 20);
  EXPECT_GE(found.same * 10, found.sure * 9) << found.same << " of " << found.sure;
}

// Two networks that have nothing in common but the pictures: were boxes of one read wrongly, they would not meet.
TEST_F(CocoPictures, TheNetworkWithoutAnchorsFindsThePeopleOfTheOther) {
  auto with_anchors = Detector::open(kModels + "/cbam_yolov5n_416.onnx", {});
  auto without = Detector::open(kModels + "/yolox_nano_416.onnx", {});
  ASSERT_TRUE(with_anchors.ok() && without.ok());
  EXPECT_EQ(with_anchors.value().info().layout, Layout::kYolov5);
  EXPECT_EQ(without.value().info().layout, Layout::kYolox);
  EXPECT_EQ(with_anchors.value().info().classes, without.value().info().classes);
  const Shared found = boxes_in_common(
      &with_anchors.value(), &without.value(), pictures_, [](const cv::Mat&) { return true; },
      [](const Box& box) { return box.score >= 0.8F && box.class_id == 0; });
  ASSERT_GE(found.sure, 20);
  EXPECT_GE(found.same * 10, found.sure * 9) << found.same << " of " << found.sure;
}

// The metadata of one network beside the file of another, its checksum made to fit: told apart by the output's rows.
TEST_F(DetectorTest, ACardOfAnotherKindOfNetworkIsRefused) {
  const auto beside = [&](const std::string& model, const std::string& card) {
    const std::string path = write("own.onnx", read(kModels + "/" + model + ".onnx"));
    std::string text = read(kModels + "/" + card + ".toml");
    write("own.toml",
          text.replace(text.find("sha256"), std::string::npos, "sha256 = \"" + sha256_of_file(path).value() + "\"\n"));
    return why(Detector::open(path, {}));
  };
  const std::string own = (dir_ / "own.onnx").string() + ": output is ";
  EXPECT_EQ(beside("yolox_nano_320", "cbam_yolov5n_320"),
            own + "1x2100x11, but the metadata's input size, layout and 6 classes make it 1x6300x11");
  EXPECT_EQ(beside("cbam_yolov5n_320", "yolox_nano_320"),
            own + "1x6300x11, but the metadata's input size, layout and 6 classes make it 1x2100x11");
  EXPECT_EQ(beside("yolox_nano_320", "yolox_nano_320"), "opened");
}

TEST_F(DetectorTest, BadModelsAreNamedWithTheReason) {
  const std::string model = read(kModels + "/cbam_yolov5n_320.onnx"), meta = read(kModels + "/cbam_yolov5n_320.toml");
  ASSERT_FALSE(model.empty());
  ASSERT_FALSE(meta.empty());
  EXPECT_EQ(why(Detector::open((dir_ / "none.onnx").string(), {})), (dir_ / "none.onnx").string() + ": no such file");

  const std::string lonely = write("lonely.onnx", model);
  EXPECT_NE(why(Detector::open(lonely, {})).find("lonely.toml: cannot be opened"), std::string::npos);

  // The metadata of a file: its own checksum in place of the delivered one's.
  const auto meta_of = [&](const std::string& file) {
    std::string out = meta;
    return out.replace(out.find("sha256"), std::string::npos, "sha256 = \"" + sha256_of_file(file).value() + "\"\n");
  };
  const std::string half = write("cut.onnx", model.substr(0, model.size() / 2));
  write("cut.toml", meta);
  const std::string changed = why(Detector::open(half, {}));
  EXPECT_NE(changed.find("cut.onnx: not the network that"), std::string::npos) << changed;
  write("cut.toml", meta_of(half));
  const std::string cut = why(Detector::open(half, {}));
  EXPECT_NE(cut.find("cut.onnx: not a network"), std::string::npos) << cut;

  const std::string nothing = write("empty.onnx", "");
  write("empty.toml", meta_of(nothing));
  const std::string empty = why(Detector::open(nothing, {}));
  EXPECT_NE(empty.find("empty.onnx: "), std::string::npos) << empty;

  std::string five = meta;
  five.replace(five.find("\"bicycle\", "), 11, "");
  five.replace(five.find("\"bicycle\", "), 11, "");
  write("five.toml", five);
  const std::string classes = why(Detector::open(write("five.onnx", model), {}));
  EXPECT_NE(classes.find("but the metadata's input size, layout and 5 classes make it 1x6300x10"), std::string::npos)
      << classes;

  std::string large = meta;
  large.replace(large.find("input_width = 320"), 17, "input_width = 352");
  write("large.toml", large);
  const std::string shape = why(Detector::open(write("large.onnx", model), {}));
  EXPECT_NE(shape.find("large.onnx: "), std::string::npos) << shape;
}

TEST_F(DetectorTest, EmptyPicturesAreErrorsAndTheNextOneWorks) {
  auto opened = Detector::open(kModels + "/cbam_yolov5n_320.onnx", {});
  ASSERT_TRUE(opened.ok()) << opened.error().message;
  BoxList boxes;
  boxes.push({0, 0, 1, 1, 1, 0});
  EXPECT_FALSE(opened.value().detect({}, &boxes).ok());
  EXPECT_EQ(boxes.count, 0);
  const cv::Mat grey = cv::Mat::zeros(48, 64, CV_8UC1);
  EXPECT_FALSE(opened.value().detect({grey.data, 64, 48, 64, 2}, &boxes).ok());
  EXPECT_FALSE(opened.value().detect({grey.data, 64, 48, 63, 1}, &boxes).ok());
  EXPECT_TRUE(opened.value().detect({grey.data, 64, 48, 64, 1}, &boxes).ok());
}

TEST_F(DetectorTest, TiledItSeesWhatItsSquaresShow) {
  DetectorOptions options;
  options.decode.score_threshold = 0.001F;  // boxes of anything
  auto plain = Detector::open(kModels + "/cbam_yolov5n_320.onnx", options);
  options.tiled = true;
  auto tiled = Detector::open(kModels + "/cbam_yolov5n_320.onnx", options);
  ASSERT_TRUE(plain.ok() && tiled.ok());
  for (const auto& [width, height] : {std::pair(480, 240), std::pair(240, 480)}) {
    cv::Mat wider(height, width + 16, CV_8UC3);  // rows with something behind them
    for (int y = 0; y < wider.rows; ++y) {
      for (int x = 0; x < wider.cols; ++x) {
        const auto grey = static_cast<std::uint8_t>(110 + 60 * std::sin(0.11 * x + 0.03 * y) * std::cos(0.08 * y));
        wider.at<cv::Vec3b>(y, x) = {grey, static_cast<std::uint8_t>(255 - grey), static_cast<std::uint8_t>(x / 2)};
      }
    }
    const int stride = static_cast<int>(wider.step[0]);
    BoxList whole, with_tiles;
    const PictureView all{wider.data, width, height, stride, 3};
    ASSERT_TRUE(plain.value().detect(all, &whole).ok());
    ASSERT_TRUE(tiled.value().detect(all, &with_tiles).ok());
    ASSERT_LT(with_tiles.count, kMaxBoxes) << "or some are missing for want of room";
    int new_ones = 0;
    for (const Box& b : with_tiles.view()) {
      const auto same = [&](const Box& a) { return a.x0 == b.x0 && a.y0 == b.y0 && a.x1 == b.x1 && a.y1 == b.y1; };
      new_ones += std::none_of(whole.view().begin(), whole.view().end(), same);
    }
    EXPECT_GT(new_ones, 0) << "the squares must show something of their own";
    // All that a square shows away from its ends is there, or something surer in its place.
    const TileList tiles = square_tiles(width, height);
    for (const Tile& t : tiles.view()) {
      const Box inside = inner_part(t, width, height);
      BoxList found;
      ASSERT_TRUE(plain.value().detect({wider.ptr(t.top, t.left), t.width, t.height, stride, 3}, &found).ok());
      for (Box b : found.view()) {
        if (b.x0 < inside.x0 || b.y0 < inside.y0 || b.x1 > inside.x1 || b.y1 > inside.y1) continue;
        b.x0 += static_cast<float>(t.left);
        b.x1 += static_cast<float>(t.left);
        b.y0 += static_cast<float>(t.top);
        b.y1 += static_cast<float>(t.top);
        EXPECT_TRUE(suppressed(b, with_tiles, options.decode.nms_iou)) << b.x0 << " " << b.y0 << " " << b.score;
      }
    }
  }
}

TEST_F(DetectorTest, WithoutCudaTheProcessorComputesAndSaysSo) {
  DetectorOptions options;
  options.backend = Backend::kCuda;
  auto opened = Detector::open(kModels + "/cbam_yolov5n_320.onnx", options);
  ASSERT_TRUE(opened.ok()) << opened.error().message;
  const bool cuda = !cv::dnn::getAvailableTargets(cv::dnn::DNN_BACKEND_CUDA).empty();
  EXPECT_EQ(opened.value().backend(), cuda ? Backend::kCuda : Backend::kCpu);
  EXPECT_EQ(opened.value().warning().empty(), cuda);
}

// Real pictures: a person and a vehicle where the annotators drew them.
TEST_F(DetectorTest, FindsPeopleAndVehiclesInPictures) {
  const char* shared = std::getenv("GODWIT_SHARED_DIR");
  const std::string root = std::string(shared != nullptr ? shared : "") + "/data/detection/coco256/";
  if (shared == nullptr || !fs::exists(root)) {
    ASSERT_STRNE(std::getenv("CI") != nullptr ? std::getenv("CI") : "", "true") << "shared data is missing";
    GTEST_SKIP() << "GODWIT_SHARED_DIR has no detection pictures";
  }
  auto opened = Detector::open(kModels + "/cbam_yolov5n_416.onnx", {});
  ASSERT_TRUE(opened.ok()) << opened.error().message;
  int large = 0, found = 0;
  std::vector<fs::path> pictures;
  for (const auto& entry : fs::directory_iterator(root + "images/val2017")) pictures.push_back(entry.path());
  std::sort(pictures.begin(), pictures.end());
  pictures.resize(std::min<std::size_t>(pictures.size(), 40));
  for (const fs::path& path : pictures) {
    const cv::Mat image = cv::imread(path.string());
    ASSERT_FALSE(image.empty()) << path;
    BoxList boxes;
    ASSERT_TRUE(
        opened.value().detect({image.data, image.cols, image.rows, static_cast<int>(image.step[0]), 3}, &boxes).ok());
    std::ifstream labels(root + "labels/val2017/" + path.stem().string() + ".txt");
    double c, cx, cy, w, h;
    while (labels >> c >> cx >> cy >> w >> h) {
      if (c != 0 || w * h < 0.1) continue;  // people that fill a tenth of the picture
      ++large;
      const auto fw = static_cast<float>(image.cols), fh = static_cast<float>(image.rows);
      const Box truth{static_cast<float>(cx - w / 2) * fw,
                      static_cast<float>(cy - h / 2) * fh,
                      static_cast<float>(cx + w / 2) * fw,
                      static_cast<float>(cy + h / 2) * fh,
                      1.F,
                      0};
      for (const Box& b : boxes.view()) {
        if (b.class_id == 0 && overlap(b, truth) > 0.5F) {
          ++found;
          break;
        }
      }
    }
  }
  ASSERT_GE(large, 5);
  EXPECT_GE(found * 10, large * 7) << found << " of " << large;
}

}  // namespace
}  // namespace godwit::detector
