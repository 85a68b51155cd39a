#include "detector/box_carrier.h"

#include <algorithm>
#include <cmath>

namespace godwit::detector {
namespace {

/// Upper median; reorders the values. Precondition: count > 0.
float median(float* values, int count) {
  std::nth_element(values, values + count / 2, values + count);
  return values[count / 2];
}

bool finite(const FeatureMotion& f) {
  return std::isfinite(f.x_before) && std::isfinite(f.y_before) && std::isfinite(f.x) && std::isfinite(f.y);
}

}  // namespace

BoxCarrier::BoxCarrier(int width, int height, const CarrierLimits& limits)
    : width_(width), height_(height), limits_(limits), history_(kHistory) {}

bool BoxCarrier::advance(std::int64_t t_capture_ns, std::span<const FeatureMotion> features,
                         const CameraMotion& camera) {
  if (t_capture_ns <= now_ns_) return false;
  Step& step = history_[head_];
  head_ = (head_ + 1) % kHistory;
  held_ = std::min(held_ + 1, kHistory);
  step.t_ns = now_ns_ = t_capture_ns;
  step.camera = camera;
  step.count = 0;
  for (const FeatureMotion& f : features) {
    if (step.count == kMaxFeatures) break;
    if (finite(f)) step.features[step.count++] = f;
  }
  move_all(step);
  remember(&step);
  show();
  return true;
}

void BoxCarrier::remember(Step* step) const {
  step->boxes.count = carried_.count;
  for (int i = 0; i < carried_.count; ++i) step->boxes.box[i] = to_the_edge(i);
}

Box BoxCarrier::to_the_edge(int i) const {
  Box box = carried_.box[i];
  const Edges cut = cut_[i];
  if (cut.left) box.x0 = std::min(box.x0, 0.F);
  if (cut.top) box.y0 = std::min(box.y0, 0.F);
  if (cut.right) box.x1 = std::max(box.x1, static_cast<float>(width_));
  if (cut.bottom) box.y1 = std::max(box.y1, static_cast<float>(height_));
  return box;
}

bool BoxCarrier::boxes_at(std::int64_t t_capture_ns, std::span<const Box>* boxes) const {
  if (seen_ns_ == INT64_MIN || t_capture_ns < seen_ns_) return false;
  for (int i = 0; i < held_; ++i) {
    const Step& step = history_[(head_ - 1 - i + kHistory) % kHistory];
    if (step.t_ns != t_capture_ns) continue;
    *boxes = step.boxes.view();
    return true;
  }
  return false;
}

bool BoxCarrier::replace(std::int64_t t_capture_ns, std::span<const Box> boxes) {
  if (held_ == 0 || t_capture_ns < seen_ns_ || t_capture_ns > now_ns_) return false;
  // Without the step that came right after the detection's picture the way forward has a gap.
  const int oldest = (head_ - held_ + kHistory) % kHistory;
  if (t_capture_ns < history_[oldest].t_ns) return false;
  seen_ns_ = t_capture_ns;
  carried_.clear();
  for (const Box& b : boxes) {
    const bool sound = std::isfinite(b.x0) && std::isfinite(b.y0) && std::isfinite(b.x1) && std::isfinite(b.y1) &&
                       b.x0 < b.x1 && b.y0 < b.y1;
    if (!sound) continue;
    if (!carried_.push(b)) break;
    cut_[carried_.count - 1] = cut_off(b);
  }
  for (int i = 0; i < held_; ++i) {
    Step& step = history_[(oldest + i) % kHistory];
    if (step.t_ns < t_capture_ns) continue;
    if (step.t_ns > t_capture_ns) move_all(step);
    remember(&step);
  }
  show();
  return true;
}

void BoxCarrier::move_all(const Step& step) {
  int kept = 0;
  const bool stale = seen_ns_ == INT64_MIN || step.t_ns - seen_ns_ > limits_.max_age_ns;
  for (int i = 0; i < carried_.count && !stale; ++i) {
    Box box = carried_.box[i];
    if (!move_box(step, &box)) continue;
    cut_[kept] = cut_[i];
    carried_.box[kept++] = box;
  }
  carried_.count = kept;
}

BoxCarrier::Edges BoxCarrier::cut_off(const Box& box) const {
  const float w = static_cast<float>(width_), h = static_cast<float>(height_);
  const float near_x = limits_.cut_off_share * w, near_y = limits_.cut_off_share * h;
  return {box.x0<near_x, box.y0<near_y, box.x1> w - near_x, box.y1> h - near_y};
}

bool BoxCarrier::move_box(const Step& step, Box* box) {
  int n = 0;
  for (int i = 0; i < step.count; ++i) {
    const FeatureMotion& f = step.features[i];
    if (f.x_before < box->x0 || f.x_before >= box->x1 || f.y_before < box->y0 || f.y_before >= box->y1) continue;
    dx_[n] = f.x - f.x_before;
    dy_[n++] = f.y - f.y_before;
  }
  const float cx = 0.5F * (box->x0 + box->x1), cy = 0.5F * (box->y0 + box->y1);
  float nx, ny, grow = 1.F;
  if (n >= limits_.fewest_features && n > 0) {
    // Medians: part of the features in a box belong to what stands behind it.
    const float dx = median(dx_.data(), n), dy = median(dy_.data(), n);
    nx = cx + dx;
    ny = cy + dy;
    // What comes nearer spreads: distance from the centre after against before, where it is long enough to measure.
    int m = 0;
    const float shortest = 0.2F * std::min(box->width(), box->height());
    for (int i = 0; i < step.count; ++i) {
      const FeatureMotion& f = step.features[i];
      if (f.x_before < box->x0 || f.x_before >= box->x1 || f.y_before < box->y0 || f.y_before >= box->y1) continue;
      const float before = std::hypot(f.x_before - cx, f.y_before - cy);
      if (before > shortest && before > 4.F) ratio_[m++] = std::hypot(f.x - nx, f.y - ny) / before;
    }
    // Between two pictures nothing near enough to matter changes by more than a tenth.
    if (m >= 4) grow = std::clamp(median(ratio_.data(), m), 0.9F, 1.1F);
  } else {
    const auto& h = step.camera.far_homography;
    const float w = h[6] * cx + h[7] * cy + h[8];
    nx = (h[0] * cx + h[1] * cy + h[2]) / w;
    ny = (h[3] * cx + h[4] * cy + h[5]) / w;
    // A homography that sends the box behind the camera says nothing about it; it stays and ages.
    if (!(w > 0.F) || !std::isfinite(nx) || !std::isfinite(ny)) {
      nx = cx;
      ny = cy;
    }
  }
  const float half_w = 0.5F * grow * box->width(), half_h = 0.5F * grow * box->height();
  box->x0 = nx - half_w;
  box->x1 = nx + half_w;
  box->y0 = ny - half_h;
  box->y1 = ny + half_h;
  return box->x1 > 0.F && box->y1 > 0.F && box->x0 < static_cast<float>(width_) &&
         box->y0 < static_cast<float>(height_);
}

void BoxCarrier::show() {
  shown_.clear();
  if (carried_.count == 0) return;
  const float age_s = static_cast<float>(static_cast<double>(now_ns_ - seen_ns_) * 1e-9);
  const float share = 0.5F * std::min(limits_.growth_per_s * age_s, limits_.max_growth_share);
  for (int i = 0; i < carried_.count; ++i) {
    const Box b = to_the_edge(i);
    Box grown = b;
    const float gx = share * b.width(), gy = share * b.height();
    grown.x0 = std::max(b.x0 - gx, 0.F);
    grown.y0 = std::max(b.y0 - gy, 0.F);
    grown.x1 = std::min(b.x1 + gx, static_cast<float>(width_));
    grown.y1 = std::min(b.y1 + gy, static_cast<float>(height_));
    if (grown.x0 < grown.x1 && grown.y0 < grown.y1) shown_.push(grown);
  }
}

}  // namespace godwit::detector
