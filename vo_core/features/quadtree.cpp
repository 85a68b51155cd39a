#include "vo_core/features/quadtree.h"

#include <algorithm>
#include <array>
#include <cassert>

#include "hal/rt/count.h"

namespace godwit::vo {

Quadtree::Quadtree(int width, int height, int capacity)
    : width_(static_cast<float>(width)), height_(static_cast<float>(height)), capacity_(capacity) {
  const std::size_t size = capacity;
  entries_.reserve(size);
  scratch_.resize(size);
  // Every node holds at least one entry of its own, and the nodes of all three lists together are disjoint.
  current_.reserve(size);
  next_.reserve(size);
  leaves_.reserve(size);
  best_.reserve(size);
}

void Quadtree::clear() {
  entries_.clear();
}

bool Quadtree::add(const Entry& entry) {
  const bool inside = entry.x >= 0.0f && entry.y >= 0.0f && entry.x < width_ && entry.y < height_;
  if (!inside || rt::count_of(entries_) == capacity_) return false;
  entries_.push_back(entry);
  return true;
}

bool Quadtree::add_candidate(float x, float y, float score, std::int32_t id) {
  assert(id >= 0);
  return add({x, y, score, id});
}

bool Quadtree::add_occupied(float x, float y) {
  return add({x, y, 0.0f, -1});
}

bool Quadtree::splittable(const Node& node) const {
  return node.candidates > 0 && node.end - node.begin >= 2 &&
         std::min(node.x1 - node.x0, node.y1 - node.y0) >= 2.0f * kMinLeafPx;
}

int Quadtree::split(const Node& node) {
  const float mx = 0.5f * (node.x0 + node.x1), my = 0.5f * (node.y0 + node.y1);
  const auto quarter = [&](const Entry& e) { return (e.x >= mx ? 1 : 0) + (e.y >= my ? 2 : 0); };
  const auto at = [](std::vector<Entry>& v, std::int32_t i) -> Entry& { return v[i]; };

  std::array<std::int32_t, 4> count{}, candidates{};
  for (std::int32_t i = node.begin; i < node.end; ++i) {
    const Entry& e = at(entries_, i);
    at(scratch_, i) = e;
    ++count[quarter(e)];
    if (e.id >= 0) ++candidates[quarter(e)];
  }
  std::array<std::int32_t, 4> begin{}, end{};
  std::int32_t position = node.begin;
  for (std::size_t q = 0; q < 4; ++q) {
    begin[q] = end[q] = position;
    position += count[q];
  }
  for (std::int32_t i = node.begin; i < node.end; ++i) {
    const Entry& e = at(scratch_, i);
    at(entries_, end[quarter(e)]++) = e;
  }

  int growth = node.counts() ? -1 : 0;
  for (std::size_t q = 0; q < 4; ++q) {
    if (candidates[q] == 0) continue;
    const bool right = (q & 1) != 0, low = (q & 2) != 0;
    const Node child{right ? mx : node.x0, low ? my : node.y0, right ? node.x1 : mx,
                     low ? node.y1 : my,   begin[q],           end[q],
                     candidates[q]};
    if (child.counts()) ++growth;
    next_.push_back(child);
  }
  return growth;
}

int Quadtree::select(int wanted, std::span<std::int32_t> ids) {
  assert(wanted >= 0 && std::ssize(ids) >= wanted);
  current_.clear();
  leaves_.clear();
  best_.clear();
  const int total = rt::count_of(entries_);
  const auto candidates = static_cast<std::int32_t>(
      std::count_if(entries_.begin(), entries_.end(), [](const Entry& e) { return e.id >= 0; }));
  if (wanted == 0 || candidates == 0) return 0;
  current_.push_back({0.0f, 0.0f, width_, height_, 0, total, candidates});
  int counting = current_.front().counts() ? 1 : 0;

  // One pass a generation; the side length halves each time, so the passes are few.
  while (!current_.empty()) {
    std::sort(current_.begin(), current_.end(), [](const Node& a, const Node& b) {
      return a.candidates != b.candidates ? a.candidates > b.candidates : a.begin < b.begin;
    });
    next_.clear();
    for (const Node& node : current_) {
      if (counting < wanted && splittable(node)) {
        counting += split(node);
      } else {
        leaves_.push_back(node);
      }
    }
    std::swap(current_, next_);
  }

  for (const Node& leaf : leaves_) {
    if (!leaf.counts()) continue;
    const auto first = entries_.begin() + leaf.begin, last = entries_.begin() + leaf.end;
    const Entry& best = *std::max_element(first, last, [](const Entry& a, const Entry& b) {
      return a.score != b.score ? a.score < b.score : a.id > b.id;
    });
    best_.push_back({leaf.x1 - leaf.x0, best.score, best.id});
  }
  const int taken = std::min(rt::count_of(best_), wanted);
  std::sort(best_.begin(), best_.end(), [](const Choice& a, const Choice& b) {
    if (a.leaf_px != b.leaf_px) return a.leaf_px > b.leaf_px;
    return a.score != b.score ? a.score > b.score : a.id < b.id;
  });
  for (int i = 0; i < taken; ++i) ids[i] = best_[i].id;
  return taken;
}

}  // namespace godwit::vo
