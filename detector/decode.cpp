#include "detector/decode.h"

#include <algorithm>
#include <cmath>

namespace godwit::detector {

LetterboxFit fit_letterbox(const ModelInfo& info, int picture_width, int picture_height) {
  LetterboxFit fit;
  fit.picture_width = picture_width;
  fit.picture_height = picture_height;
  fit.scale = std::min(static_cast<float>(info.input_width) / static_cast<float>(picture_width),
                       static_cast<float>(info.input_height) / static_cast<float>(picture_height));
  // A very long picture still keeps one row.
  const auto scaled = [&](int side, int limit) {
    return std::clamp(static_cast<int>(std::lround(static_cast<float>(side) * fit.scale)), 1, limit);
  };
  fit.width = scaled(picture_width, info.input_width);
  fit.height = scaled(picture_height, info.input_height);
  if (info.placement == Placement::kCentre) {
    fit.left = (info.input_width - fit.width) / 2;
    fit.top = (info.input_height - fit.height) / 2;
  }
  return fit;
}

float overlap(const Box& a, const Box& b) {
  const float w = std::min(a.x1, b.x1) - std::max(a.x0, b.x0);
  const float h = std::min(a.y1, b.y1) - std::max(a.y0, b.y0);
  if (!(w > 0.F && h > 0.F)) return 0.F;
  const float both = w * h;
  return both / (a.width() * a.height() + b.width() * b.height() - both);
}

bool suppressed(const Box& box, const BoxList& kept, float nms_iou) {
  const auto hides = [&](const Box& b) { return b.class_id == box.class_id && overlap(b, box) > nms_iou; };
  return std::any_of(kept.view().begin(), kept.view().end(), hides);
}

Decoder::Decoder(const ModelInfo& info, const DecodeOptions& options) : info_(info), options_(options) {
  candidates_.reserve(info.output_rows());
  if (info.layout != Layout::kYolox) return;
  cells_.reserve(info.output_rows());
  for (const int stride : {8, 16, 32}) {
    for (int y = 0; y < info.input_height / stride; ++y) {
      for (int x = 0; x < info.input_width / stride; ++x) {
        cells_.push_back({static_cast<float>(x), static_cast<float>(y), static_cast<float>(stride)});
      }
    }
  }
}

bool Decoder::read_row(const float* v, int row, const LetterboxFit& fit, Candidate* out) const {
  const float objectness = v[4];
  // Written so that NaN fails; scores above one would let a broken network outrank itself.
  if (!(objectness >= options_.score_threshold && objectness <= 1.001F)) return false;
  const int classes = static_cast<int>(info_.classes.size());
  int best = -1;
  float best_score = -1.F;
  for (int c = 0; c < classes; ++c) {
    if (!std::isfinite(v[5 + c])) return false;
    if (v[5 + c] > best_score) {
      best_score = v[5 + c];
      best = c;
    }
  }
  const float score = objectness * best_score;
  if (!(score >= options_.score_threshold && best_score <= 1.001F)) return false;
  float cx = v[0], cy = v[1], w = v[2], h = v[3];
  if (info_.layout == Layout::kYolox) {
    const Cell& cell = cells_[row];
    cx = (cx + cell.x) * cell.stride;
    cy = (cy + cell.y) * cell.stride;
    w = std::exp(w) * cell.stride;
    h = std::exp(h) * cell.stride;
  }
  const auto left = static_cast<float>(fit.left), top = static_cast<float>(fit.top);
  Box& b = out->box;
  b.x0 = (cx - 0.5F * w - left) / fit.scale;
  b.x1 = (cx + 0.5F * w - left) / fit.scale;
  b.y0 = (cy - 0.5F * h - top) / fit.scale;
  b.y1 = (cy + 0.5F * h - top) / fit.scale;
  if (!(std::isfinite(b.x0) && std::isfinite(b.x1) && std::isfinite(b.y0) && std::isfinite(b.y1))) return false;
  b.x0 = std::max(b.x0, 0.F);
  b.y0 = std::max(b.y0, 0.F);
  b.x1 = std::min(b.x1, static_cast<float>(fit.picture_width));
  b.y1 = std::min(b.y1, static_cast<float>(fit.picture_height));
  // Less than half a pixel is nothing that could be masked.
  if (!(b.x1 - b.x0 >= 0.5F && b.y1 - b.y0 >= 0.5F)) return false;
  b.score = std::min(score, 1.F);
  b.class_id = best;
  out->row = row;
  return true;
}

void Decoder::decode(std::span<const float> output, const LetterboxFit& fit, BoxList* boxes, const Box& inside) {
  boxes->clear();
  const int rows = info_.output_rows();
  const std::size_t values = 5 + info_.classes.size();
  if (output.size() != static_cast<std::size_t>(rows) * values) return;
  candidates_.clear();
  Candidate candidate;
  for (int row = 0; row < rows; ++row) {
    if (!read_row(output.data() + row * values, row, fit, &candidate)) continue;
    const Box& b = candidate.box;
    if (b.x0 >= inside.x0 && b.y0 >= inside.y0 && b.x1 <= inside.x1 && b.y1 <= inside.y1)
      candidates_.push_back(candidate);
  }
  const auto surer = [](const Candidate& a, const Candidate& b) {
    return a.box.score != b.box.score ? a.box.score > b.box.score : a.row < b.row;
  };
  const std::size_t kept = std::min(candidates_.size(), std::size_t{kMaxCandidates});
  std::partial_sort(candidates_.begin(), candidates_.begin() + static_cast<std::ptrdiff_t>(kept), candidates_.end(),
                    surer);
  candidates_.resize(kept);
  // The list holds what has survived so far, so each candidate meets at most kMaxBoxes others.
  for (const Candidate& c : candidates_) {
    if (!suppressed(c.box, *boxes, options_.nms_iou) && !boxes->push(c.box)) return;
  }
}

}  // namespace godwit::detector
