#include "firmware_app/flight/model_files.h"

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <unistd.h>

#include "detector/model_info.h"
#include "hal/machine/installed_data.h"

namespace godwit::app {
namespace {

rt::Result<detector::ModelInfo> look_at(const std::string& model) {
  std::error_code error;
  const auto status = std::filesystem::status(model, error);
  if (!std::filesystem::exists(status)) return rt::Error{model + ": " + error.message()};
  if (!std::filesystem::is_regular_file(status)) return rt::Error{model + ": no file"};
  if (access(model.c_str(), R_OK) != 0) return rt::Error{model + ": " + std::strerror(errno)};
  return detector::read_model_info(model);
}

std::string input_of(const detector::ModelInfo& info) {
  return std::to_string(info.input_width) + " x " + std::to_string(info.input_height);
}

}  // namespace

ModelFiles model_files(const Config::Detector& config) {
  ModelFiles out{config.model, config.small_model};
  if (out.large.empty()) {
    const std::string models = hal::installed_data("models");
    out.large = models + "/cbam_yolov5n_416.onnx";
    if (out.small.empty()) out.small = models + "/cbam_yolov5n_320.onnx";
  }
  return out;
}

detector::DetectorOptions detector_options(const Config::Detector& config) {
  detector::DetectorOptions out;
  out.backend = config.backend;
  out.threads = config.threads;
  out.decode.score_threshold = static_cast<float>(config.min_score);
  out.tiled = config.tiled;
  return out;
}

void check_model_files(const Config::Detector& config,
                       const std::function<void(const std::string&, const std::string&)>& wrong) {
  const ModelFiles files = model_files(config);
  const auto large = look_at(files.large);
  if (!large) {
    wrong("detector.model", large.error().message + "; without a network: detector.enabled = false");
    return;
  }
  if (files.small.empty()) return;
  const auto small = look_at(files.small);
  if (!small) {
    wrong("detector.small_model", small.error().message);
  } else if (small.value().classes != large.value().classes) {
    wrong("detector.small_model", files.small + ": its classes are not those of " + files.large);
  } else if (small.value().square_px() >= large.value().square_px()) {
    wrong("detector.small_model", files.small + ": its input of " + input_of(small.value()) +
                                      " pixels is not smaller than that of " + files.large + ", " +
                                      input_of(large.value()));
  }
}

}  // namespace godwit::app
