#include "detector/detector.h"

#include <filesystem>
#include <opencv2/core.hpp>
#include <opencv2/dnn.hpp>
#include <opencv2/imgproc.hpp>
#include <vector>

#include "detector/tiles.h"

namespace godwit::detector {

struct Detector::State {
  State(const ModelInfo& model_info, const DetectorOptions& detector_options)
      : info(model_info), options(detector_options), decoder(model_info, detector_options.decode) {}

  ModelInfo info;
  DetectorOptions options;
  Decoder decoder;
  cv::dnn::Net net;
  std::string warning;
  std::string path;
  // Reused from picture to picture.
  cv::Mat canvas, blob;
  LetterboxFit fit;
  std::vector<cv::Mat> outputs;
  std::vector<cv::String> output_names;
  BoxList found;
  std::vector<Box> candidates;

  void letterbox(const PictureView& picture);
  void fill_blob();
  rt::Result<void> run();
  rt::Result<void> look(const PictureView& picture, const Box& inside, BoxList* boxes);
  rt::Result<void> look_at_tiles(const PictureView& picture, BoxList* boxes);
};

namespace {

bool has_target(cv::dnn::Target wanted) {
  for (const cv::dnn::Target target : cv::dnn::getAvailableTargets(cv::dnn::DNN_BACKEND_CUDA)) {
    if (target == wanted) return true;
  }
  return false;
}

void use_cpu(cv::dnn::Net* net, DetectorOptions* options) {
  options->backend = Backend::kCpu;
  net->setPreferableBackend(cv::dnn::DNN_BACKEND_OPENCV);
  net->setPreferableTarget(cv::dnn::DNN_TARGET_CPU);
}

void choose_backend(cv::dnn::Net* net, DetectorOptions* options, std::string* warning) {
  if (options->backend != Backend::kCpu) {
    const bool half = options->backend == Backend::kCudaFp16;
    const auto target = half ? cv::dnn::DNN_TARGET_CUDA_FP16 : cv::dnn::DNN_TARGET_CUDA;
    if (has_target(target)) {
      net->setPreferableBackend(cv::dnn::DNN_BACKEND_CUDA);
      net->setPreferableTarget(target);
      return;
    }
    *warning = std::string("detector: backend ") + (half ? "cuda_fp16" : "cuda") +
               " is not available (this OpenCV or this machine has no CUDA); using the CPU";
  }
  use_cpu(net, options);
}

std::string shape_of(const cv::Mat& m) {
  std::string text;
  for (int i = 0; i < m.dims; ++i) {
    if (i > 0) text += 'x';
    text += std::to_string(m.size[i]);
  }
  return text;
}

}  // namespace

void Detector::State::letterbox(const PictureView& picture) {
  const bool moved = fit.picture_width != picture.width || fit.picture_height != picture.height;
  if (canvas.empty() || moved || canvas.channels() != picture.channels) {
    fit = fit_letterbox(info, picture.width, picture.height);
    canvas.create(info.input_height, info.input_width, CV_8UC(picture.channels));
    canvas.setTo(cv::Scalar::all(info.fill));
  }
  // The borders stay as they are; only the picture's part is written again.
  const cv::Mat source(picture.height, picture.width, CV_8UC(picture.channels), const_cast<std::uint8_t*>(picture.data),
                       picture.stride);
  cv::Mat part = canvas(cv::Rect(fit.left, fit.top, fit.width, fit.height));
  cv::resize(source, part, part.size(), 0, 0, cv::INTER_LINEAR);
}

void Detector::State::fill_blob() {
  const int pixels = info.input_height * info.input_width;
  float* plane[3];
  for (int c = 0; c < 3; ++c) plane[c] = blob.ptr<float>() + static_cast<std::ptrdiff_t>(c) * pixels;
  const std::uint8_t* in = canvas.data;  // made by create(): rows follow each other without gaps
  if (canvas.channels() == 1) {
    for (int i = 0; i < pixels; ++i) plane[0][i] = static_cast<float>(in[i]) * info.scale;
    std::copy_n(plane[0], pixels, plane[1]);
    std::copy_n(plane[0], pixels, plane[2]);
    return;
  }
  const bool rgb = info.channel_order == ChannelOrder::kRgb;
  float* blue = plane[rgb ? 2 : 0];
  float* red = plane[rgb ? 0 : 2];
  for (int i = 0; i < pixels; ++i) {
    blue[i] = static_cast<float>(in[3 * i]) * info.scale;
    plane[1][i] = static_cast<float>(in[3 * i + 1]) * info.scale;
    red[i] = static_cast<float>(in[3 * i + 2]) * info.scale;
  }
}

rt::Result<void> Detector::State::run() {
  try {
    net.setInput(blob);
    net.forward(outputs, output_names);
  } catch (const cv::Exception& e) {
    return rt::Error{path + ": OpenCV cannot run this network: " + e.err};
  }
  if (outputs.size() != 1) return rt::Error{path + ": has " + std::to_string(outputs.size()) + " outputs, must be one"};
  const cv::Mat& y = outputs[0];
  const int rows = info.output_rows(), values = 5 + static_cast<int>(info.classes.size());
  if (y.type() != CV_32F || !y.isContinuous() || y.dims != 3 || y.size[0] != 1 || y.size[1] != rows ||
      y.size[2] != values) {
    return rt::Error{path + ": output is " + shape_of(y) + ", but the metadata's input size, layout and " +
                     std::to_string(info.classes.size()) + " classes make it 1x" + std::to_string(rows) + "x" +
                     std::to_string(values)};
  }
  return {};
}

rt::Result<void> Detector::State::look(const PictureView& picture, const Box& inside, BoxList* boxes) {
  try {
    letterbox(picture);
  } catch (const cv::Exception& e) {
    return rt::Error{"detector: the picture cannot be scaled: " + e.err};
  }
  fill_blob();
  const auto ran = run();
  if (!ran.ok()) return ran;
  const cv::Mat& y = outputs[0];
  decoder.decode({y.ptr<float>(), y.total()}, fit, boxes, inside);
  return {};
}

rt::Result<void> Detector::State::look_at_tiles(const PictureView& picture, BoxList* boxes) {
  const TileList tiles = square_tiles(picture.width, picture.height);
  candidates.assign(boxes->view().begin(), boxes->view().end());
  for (const Tile& tile : tiles.view()) {
    const std::ptrdiff_t first = static_cast<std::ptrdiff_t>(tile.top) * picture.stride +
                                 static_cast<std::ptrdiff_t>(tile.left) * picture.channels;
    const auto looked = look({picture.data + first, tile.width, tile.height, picture.stride, picture.channels},
                             inner_part(tile, picture.width, picture.height), &found);
    if (!looked.ok()) return looked;
    for (Box box : found.view()) {
      box.x0 += static_cast<float>(tile.left);
      box.x1 += static_cast<float>(tile.left);
      box.y0 += static_cast<float>(tile.top);
      box.y1 += static_cast<float>(tile.top);
      candidates.push_back(box);
    }
  }
  merge(candidates, options.decode.nms_iou, boxes);
  return {};
}

rt::Result<Detector> Detector::open(const std::string& model_path, const DetectorOptions& options) {
  std::error_code ignored;
  if (!std::filesystem::is_regular_file(model_path, ignored)) return rt::Error{model_path + ": no such file"};
  auto info = read_model_info(model_path);
  if (!info.ok()) return info.error();
  return open(model_path, info.value(), options);
}

rt::Result<Detector> Detector::open(const std::string& model_path, const ModelInfo& info,
                                    const DetectorOptions& options) {
  std::error_code ignored;
  if (!std::filesystem::is_regular_file(model_path, ignored)) return rt::Error{model_path + ": no such file"};
  auto state = std::make_unique<State>(info, options);
  state->path = model_path;
  cv::setNumThreads(options.threads);
  try {
    state->net = cv::dnn::readNetFromONNX(model_path);
    if (state->net.empty()) return rt::Error{model_path + ": holds no network"};
    choose_backend(&state->net, &state->options, &state->warning);
    state->output_names = state->net.getUnconnectedOutLayersNames();
    const int sizes[] = {1, 3, info.input_height, info.input_width};
    state->blob.create(4, sizes, CV_32F);
    state->blob.setTo(cv::Scalar::all(static_cast<float>(info.fill) * info.scale));
  } catch (const cv::Exception& e) {
    return rt::Error{model_path + ": not a network that OpenCV can read (truncated, or not ONNX): " + e.err};
  }
  auto warm = state->run();
  if (!warm.ok() && state->options.backend != Backend::kCpu) {
    // Compiled in and present, and yet it cannot: a driver too old, a layer that it lacks, no memory left.
    state->warning =
        "detector: CUDA was found but does not run this network (" + warm.error().message + "); using the CPU";
    use_cpu(&state->net, &state->options);
    warm = state->run();
  }
  if (!warm.ok()) return warm.error();
  return Detector(std::move(state));
}

Detector::Detector(std::unique_ptr<State> state) : state_(std::move(state)) {}
Detector::Detector(Detector&&) noexcept = default;
Detector& Detector::operator=(Detector&&) noexcept = default;
Detector::~Detector() = default;

rt::Result<void> Detector::detect(const PictureView& picture, BoxList* boxes) {
  boxes->clear();
  if (picture.data == nullptr || picture.width < 1 || picture.height < 1 ||
      (picture.channels != 1 && picture.channels != 3) || picture.stride < picture.width * picture.channels) {
    return rt::Error{"detector: the picture is empty or neither grey nor of three channels"};
  }
  auto looked = state_->look(picture, Decoder::kAnywhere, boxes);
  if (looked.ok() && state_->options.tiled) looked = state_->look_at_tiles(picture, boxes);
  if (!looked.ok()) boxes->clear();
  return looked;
}

const ModelInfo& Detector::info() const {
  return state_->info;
}
bool Detector::movable(int class_id) const {
  return class_id >= 0 && class_id < std::ssize(state_->info.movable) && state_->info.movable[class_id];
}
Backend Detector::backend() const {
  return state_->options.backend;
}
const std::string& Detector::warning() const {
  return state_->warning;
}

}  // namespace godwit::detector
