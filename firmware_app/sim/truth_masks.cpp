#include "firmware_app/sim/truth_masks.h"

#include <cassert>

namespace godwit::app {

TruthMasks::TruthMasks(int width, int height)
    : ring_(std::make_unique<rt::SpscRing<Entry, kEntries>>()), mask_(width, height, rt::kPyramidLevels) {}

void TruthMasks::put(std::uint32_t sequence, std::span<const sim::TrueBox> boxes) {
  filling_.sequence = sequence;
  filling_.boxes.clear();
  for (const sim::TrueBox& b : boxes) {
    const detector::Box box{
        static_cast<float>(b.x0), static_cast<float>(b.y0), static_cast<float>(b.x1), static_cast<float>(b.y1), 1.F,
        static_cast<int>(b.kind)};
    if (!filling_.boxes.push(box)) break;
  }
  const bool pushed = ring_->try_push(filling_);
  assert(pushed);  // see kEntries
  static_cast<void>(pushed);
}

rt::MaskPyramidView TruthMasks::mask_for(const rt::FrameMeta& frame, const rt::ImageView& /*grey*/) {
  // Older ones belong to pictures that were dropped on the way. Bounded by the ring.
  for (std::size_t i = 0; i < kEntries; ++i) {
    const Entry* entry = ring_->front();
    if (entry == nullptr || entry->sequence > frame.sequence) break;
    const bool wanted = entry->sequence == frame.sequence;
    if (wanted) mask_.update(entry->boxes.view(), {});
    ring_->drop_front();
    if (wanted) return mask_.view();
  }
  return {};
}

}  // namespace godwit::app
