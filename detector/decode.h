// From the network's numbers to boxes in the picture. Pure computation; whatever the numbers are, the result is sound.
#pragma once

#include <limits>
#include <span>
#include <vector>

#include "detector/box.h"
#include "detector/model_info.h"

namespace godwit::detector {

/// Where the picture lies in the network's input: input = picture x scale + (left, top).
struct LetterboxFit {
  float scale = 1.F;
  int left = 0, top = 0;
  int width = 0, height = 0;                  ///< of the scaled picture
  int picture_width = 0, picture_height = 0;  ///< pixels
};

/// Fits a picture into the model's input with its aspect kept. Preconditions: sizes are positive.
LetterboxFit fit_letterbox(const ModelInfo& info, int picture_width, int picture_height);

struct DecodeOptions {
  float score_threshold = 0.25F;  ///< objectness x class score
  float nms_iou = 0.45F;          ///< two boxes of one class that overlap more are one object
};

/// Decodes the outputs of one model. Buffers are sized at construction; decode() does not allocate.
class Decoder {
 public:
  /// At most this many candidates, the surest, enter non-maximum suppression: its time is bounded whatever the network
  /// says.
  static constexpr int kMaxCandidates = 1024;
  static constexpr float kFar = std::numeric_limits<float>::infinity();
  static constexpr Box kAnywhere{-kFar, -kFar, kFar, kFar};

  Decoder(const ModelInfo& info, const DecodeOptions& options);

  /// `output`: output_rows() x (5 + classes) values, row by row; a span of another size yields no boxes.
  /// Each row gives at most one box, of its best class. Rows with a value that is not finite, and boxes without area in
  /// the picture, are dropped; boxes are clipped to the picture. Class-wise greedy non-maximum suppression; ties in
  /// score are settled by row, so that equal input gives equal output. Surest first.
  /// `inside`: boxes that reach out of it are dropped before they can suppress others.
  void decode(std::span<const float> output, const LetterboxFit& fit, BoxList* boxes, const Box& inside = kAnywhere);

 private:
  struct Candidate {
    Box box;
    int row;
  };
  bool read_row(const float* v, int row, const LetterboxFit& fit, Candidate* out) const;

  ModelInfo info_;
  DecodeOptions options_;
  std::vector<Candidate> candidates_;
  /// Cell and stride of each row, for layouts that are relative to the cell.
  struct Cell {
    float x, y, stride;
  };
  std::vector<Cell> cells_;
};

/// Intersection over union of two boxes, 0..1.
float overlap(const Box& a, const Box& b);
/// A box of its class is among the kept ones and overlaps it by more than that.
bool suppressed(const Box& box, const BoxList& kept, float nms_iou);

}  // namespace godwit::detector
