// References to frame slots on their way back to whoever counts them.
#pragma once

#include <array>
#include <cassert>

#include "hal/rt/frame_pool.h"
#include "vo_core/map/map.h"
#include "vo_core/map/map_exchange.h"

namespace godwit::vo {

/// Collects references until they are taken. One entry a slot, so that it cannot be full where a pool's slots are fewer
/// than kMaxFrameSlots: none is ever dropped, however long nobody takes any. No allocation.
class SlotReleases {
 public:
  /// `count` more references to slot `slot` are no longer needed. A slot below 0 stands for no slot.
  void add(int slot, int count) {
    if (slot < 0 || count <= 0) return;
    for (int i = 0; i < size_; ++i) {
      if (entries_[i].slot != slot) continue;
      entries_[i].count += count;
      return;
    }
    assert(size_ < rt::kMaxFrameSlots && "slots are numbered beyond what a pool has");
    if (size_ < rt::kMaxFrameSlots) entries_[size_++] = {slot, count};
  }
  /// One reference of each keyframe of a map that is about to be given up.
  void add_all(const Map& map) {
    for (int k = 0; k < kMaxKeyframes; ++k)
      if (map.keyframe(k).id != 0) add(map.keyframe(k).slot, 1);
  }
  /// False when there are none.
  bool take(SlotRelease* out) {
    if (size_ == 0) return false;
    *out = entries_[--size_];
    return true;
  }

 private:
  std::array<SlotRelease, rt::kMaxFrameSlots> entries_;
  int size_ = 0;
};

}  // namespace godwit::vo
