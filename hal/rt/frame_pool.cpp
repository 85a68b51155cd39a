#include "hal/rt/frame_pool.h"

#include <cassert>
#include <cstdlib>
#include <cstring>
#include <string>
#include <sys/mman.h>

namespace godwit::rt {
namespace {
constexpr std::size_t kLargePage = std::size_t{1} << 21;

std::size_t round_up(std::size_t n) {
  constexpr std::size_t kAlign = kRowAlignment;
  return (n + kAlign - 1) / kAlign * kAlign;
}
}  // namespace

void FramePool::FreeDeleter::operator()(std::uint8_t* p) const {
  std::free(p);
}

void FrameReturn::give_back(int slot, int count) {
  assert(slot >= 0 && slot < pool_->slots() && count > 0);
  const bool pushed =
      pool_->returns_[reader_]->try_push({static_cast<std::int16_t>(slot), static_cast<std::int16_t>(count)});
  assert(pushed);  // see ReturnRing
  static_cast<void>(pushed);
}

Result<std::unique_ptr<FramePool>> FramePool::create(const Layout& layout) {
  if (layout.width < 1 || layout.width > kMaxImageWidth || layout.height < 1 || layout.height > kMaxImageHeight) {
    return Error{"frame pool: pictures of " + std::to_string(layout.width) + " x " + std::to_string(layout.height) +
                 " pixels; allowed are 1 x 1 to " + std::to_string(kMaxImageWidth) + " x " +
                 std::to_string(kMaxImageHeight)};
  }
  if (layout.slots < 1 || layout.slots > kMaxFrameSlots) {
    return Error{"frame pool: " + std::to_string(layout.slots) + " slots; allowed are 1 to " +
                 std::to_string(kMaxFrameSlots)};
  }
  const int most_readers = kMaxFrameReaders - (layout.onlooker ? 1 : 0);
  if (layout.readers < 1 || layout.readers > most_readers) {
    return Error{"frame pool: " + std::to_string(layout.readers) + " readers; allowed are 1 to " +
                 std::to_string(most_readers)};
  }
  std::unique_ptr<FramePool> pool(new FramePool(layout));
  if (pool->memory_ == nullptr) {
    return Error{"frame pool: no memory for " + std::to_string(layout.slots) + " slots of " +
                 std::to_string(pool->slot_bytes_) + " bytes"};
  }
  return pool;
}

FramePool::FramePool(const Layout& layout) : layout_(layout), slots_(layout.slots) {
  stride_ = static_cast<int>(round_up(layout.width));
  // SIMD may read one vector past the last pixel of each part: that gap belongs to the part.
  grey_bytes_ = std::size_t{1} * stride_ * layout.height + kRowAlignment;
  const std::size_t pixels = layout.width * layout.height;
  slot_bytes_ = round_up(grey_bytes_) + round_up(layout.pyramid_bytes) + kRowAlignment +
                (layout.colour ? round_up(pixels * 3) + kRowAlignment : 0);
  const std::size_t total = slot_bytes_ * layout.slots;
  // Keyframes' pictures are looked at here and there: with small pages nearly each look misses the table of them. A
  // kernel that has no large ones says so, and nothing hangs on that.
  void* memory = nullptr;
  if (posix_memalign(&memory, kLargePage, total) == 0) madvise(memory, total, MADV_HUGEPAGE);
  memory_.reset(static_cast<std::uint8_t*>(memory));
  if (memory_ != nullptr) std::memset(memory_.get(), 0, total);  // touched: no page fault once armed
  const int rings = layout.readers + (layout.onlooker ? 1 : 0);
  for (int i = 0; i < rings; ++i) returns_.push_back(std::make_unique<ReturnRing>());
  free_ = fewest_free_ = layout.slots;
}

void FramePool::collect() {
  for (const auto& ring : returns_) {
    Return r{};
    // Bounded: a ring holds no more than the references that are out.
    while (ring->try_pop(&r)) {
      Slot& slot = slots_[r.slot];
      assert(slot.references >= r.count);  // given back twice otherwise
      slot.references -= r.count;
      if (slot.references != 0) continue;
      slot.taken = false;
      --taken_;
    }
  }
}

int FramePool::acquire() {
  collect();
  const int free = layout_.slots - taken_;
  free_.store(free, std::memory_order_relaxed);
  if (free < fewest_free_.load(std::memory_order_relaxed)) fewest_free_.store(free, std::memory_order_relaxed);
  for (int i = 0; i < layout_.slots; ++i) {
    const int slot = (next_ + i) % layout_.slots;
    Slot& s = slots_[slot];
    if (s.taken) continue;
    s.taken = true;
    ++taken_;
    s.references = 0;
    next_ = (slot + 1) % layout_.slots;
    return slot;
  }
  return -1;
}

void FramePool::hand_out(int slot, int references) {
  Slot& s = slots_[slot];
  assert(s.taken && s.references == 0 && references > 0);
  s.references = references;
}

void FramePool::cancel(int slot) {
  Slot& s = slots_[slot];
  assert(s.taken && s.references == 0);
  s.taken = false;
  --taken_;
}

FrameReturn FramePool::reader(int index) {
  assert(index >= 0 && index < layout_.readers);
  return {this, index};
}

FrameReturn FramePool::onlooker() {
  assert(layout_.onlooker);
  return {this, layout_.readers};
}

MutableImageView FramePool::grey(int slot) const {
  assert(slot >= 0 && slot < layout_.slots);
  return {memory_.get() + slot_bytes_ * slot, layout_.width, layout_.height, stride_};
}

std::uint8_t* FramePool::pyramid_storage(int slot) const {
  return grey(slot).data + round_up(grey_bytes_);
}

std::uint8_t* FramePool::bgr(int slot) const {
  if (!layout_.colour) return nullptr;
  return pyramid_storage(slot) + round_up(layout_.pyramid_bytes) + kRowAlignment;
}

}  // namespace godwit::rt
