#include "detector/box_hold.h"

#include <algorithm>
#include <array>

#include "detector/decode.h"

namespace godwit::detector {
namespace {

/// Share of `a` that lies in `b`.
float part_in(const Box& a, const Box& b) {
  const float w = std::min(a.x1, b.x1) - std::max(a.x0, b.x0);
  const float h = std::min(a.y1, b.y1) - std::max(a.y0, b.y0);
  return w > 0.F && h > 0.F ? w * h / (a.width() * a.height()) : 0.F;
}

/// By BoxCarrier: a box that is cut off reaches the edge exactly, or beyond.
bool cut_off(const Box& b, const HoldLimits& limits) {
  return b.x0 <= 0.F || b.y0 <= 0.F || b.x1 >= static_cast<float>(limits.width);
}

bool accounts_for(const Box& box, const Box& before, const HoldLimits& limits) {
  return (box.class_id == before.class_id && overlap(box, before) >= limits.overlap) ||
         part_in(before, box) >= limits.covered;
}

}  // namespace

void hold(std::span<const Box> before, std::int64_t apart_ns, const HoldLimits& limits, BoxList* found) {
  before = before.first(std::min<std::size_t>(before.size(), kMaxBoxes));
  std::array<bool, kMaxBoxes> taken{};
  for (std::size_t k = 0; k < before.size(); ++k) taken[k] = !cut_off(before[k], limits);
  const auto account = [&](const Box& box) {
    for (std::size_t k = 0; k < before.size(); ++k) taken[k] = taken[k] || accounts_for(box, before[k], limits);
  };
  BoxList out;
  for (Box box : found->view()) {
    box.missed = 0;
    if (box.score < limits.sure_score) continue;
    out.push(box);
    account(box);
  }
  for (Box box : found->view()) {
    box.missed = 0;
    if (box.score >= limits.sure_score) continue;
    const Box* same = nullptr;
    float most = limits.overlap;
    for (std::size_t k = 0; k < before.size(); ++k) {
      if (taken[k] || before[k].class_id != box.class_id || overlap(before[k], box) < most) continue;
      same = &before[k];
      most = overlap(before[k], box);
    }
    if (same == nullptr) continue;
    out.push(box);
    account(box);
  }
  for (std::size_t k = 0; k < before.size(); ++k) {
    const std::int64_t unseen = before[k].missed + 1;
    if (taken[k] || unseen > limits.detections || apart_ns > limits.longest_ns / unseen) continue;
    Box held = before[k];
    ++held.missed;
    out.push(held);
  }
  *found = out;
}

}  // namespace godwit::detector
