// What a network file does not say about itself: a small TOML file beside it.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "hal/rt/result.h"

namespace godwit::detector {

/// How the output is laid out.
enum class Layout {
  kYolov5,  ///< 1 x N x (5 + classes): centre and size in input pixels, objectness, class scores; all after the sigmoid
  kYolox,   ///< the same shape, but centre and size still relative to the cell and stride (Ge et al., YOLOX, 2021)
};
enum class ChannelOrder { kRgb, kBgr };
enum class Placement { kCentre, kTopLeft };

constexpr int kMaxClasses = 256;
constexpr int kMaxInputSize = 2048;

struct ModelInfo {
  Layout layout = Layout::kYolov5;
  int input_width = 0, input_height = 0;  ///< pixels, multiples of 32
  ChannelOrder channel_order = ChannelOrder::kRgb;
  float scale = 1.F / 255.F;  ///< network value = pixel value x scale
  Placement placement = Placement::kCentre;
  int fill = 114;                    ///< pixel value around the letterboxed picture
  std::vector<std::string> classes;  ///< by class number
  std::vector<bool> movable;         ///< by class number: may move, so its pixels are not trusted
  std::string sha256;                ///< of the network's file: 64 hexadecimal digits

  /// Side of the square of as many pixels, rounded: what a look costs goes with the input's pixels, not with its width.
  int square_px() const;
  /// Rows that the output must have: cells of strides 8, 16 and 32, times three anchors for YOLOv5.
  int output_rows() const;
};

/// Reads metadata from TOML text; `name` is the file's name for messages. Unknown keys, missing keys and values out of
/// range are errors that name file, key and what is allowed. Allocates; not for the frame path.
rt::Result<ModelInfo> parse_model_info(std::string_view text, std::string_view name);

/// Reads the metadata file beside a model: the model's path with .toml in place of its extension. Error also where the
/// model is not the file that the metadata describes, by its SHA-256.
rt::Result<ModelInfo> read_model_info(const std::string& model_path);

}  // namespace godwit::detector
