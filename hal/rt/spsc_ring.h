// A queue from one thread to one other: fixed capacity, no lock, no wait, nothing ever allocated after construction.
#pragma once

#include <array>
#include <atomic>
#include <bit>
#include <cstddef>
#include <type_traits>

namespace godwit::rt {

/// Bytes that keep two values out of one another's cache line on the processors we fly (64; ARM big cores prefetch
/// 128).
constexpr std::size_t kCacheLine = 128;

/// Single producer, single consumer. try_push belongs to one thread, try_pop, front and drop_front to one other; size
/// may be asked by both. A full ring refuses, it never overwrites: the caller counts what it could not pass on. All
/// calls are wait-free and do not allocate. The ring object holds its items: create large ones on the heap, before
/// arming.
template <typename T, std::size_t kCapacity>
class SpscRing {
  static_assert(std::has_single_bit(kCapacity), "the capacity is a power of two, so that an index wraps by a mask");
  static_assert(std::is_trivially_copyable_v<T>, "items are copied as bytes: nothing that owns may travel here");

 public:
  SpscRing() = default;
  SpscRing(const SpscRing&) = delete;
  SpscRing& operator=(const SpscRing&) = delete;

  static constexpr std::size_t capacity() { return kCapacity; }

  /// Producer. False if full: the item was not taken.
  bool try_push(const T& item) {
    const std::size_t tail = tail_.load(std::memory_order_relaxed);  // only this thread writes tail_
    if (tail - cached_head_ == kCapacity) {
      // Partner: the release store of head_ in drop_front. Without acquire the write below could overtake the
      // consumer's read of the old item in this place, and the consumer would copy half of the new one.
      cached_head_ = head_.load(std::memory_order_acquire);
      if (tail - cached_head_ == kCapacity) return false;
    }
    items_[tail & kMask] = item;
    // Partner: the acquire load of tail_ in front. Without release the consumer could see the new index before the
    // item.
    tail_.store(tail + 1, std::memory_order_release);
    return true;
  }

  /// Consumer. The oldest item, or null if the ring is empty; valid until drop_front.
  const T* front() {
    const std::size_t head = head_.load(std::memory_order_relaxed);  // only this thread writes head_
    if (head == cached_tail_) {
      // Partner: the release store of tail_ in try_push. Without acquire the item could be read before it is written.
      cached_tail_ = tail_.load(std::memory_order_acquire);
      if (head == cached_tail_) return nullptr;
    }
    return &items_[head & kMask];
  }

  /// Consumer. Gives the place of the oldest item back. Precondition: front() returned it.
  void drop_front() {
    // Partner: the acquire load of head_ in try_push. Without release the producer could reuse the place while the
    // consumer's reads of it are still under way.
    head_.store(head_.load(std::memory_order_relaxed) + 1, std::memory_order_release);
  }

  /// Consumer. False if empty, and *item untouched.
  bool try_pop(T* item) {
    const T* oldest = front();
    if (oldest == nullptr) return false;
    *item = *oldest;
    drop_front();
    return true;
  }

  /// Items waiting. Either thread; exact for neither while the other works. For the producer never less than the truth,
  /// for the consumer never more.
  std::size_t size() const {
    // Partners: the two release stores above. Head first: read the other way round, a pop and a push in between could
    // make head exceed the tail read before, and the difference would wrap.
    const std::size_t head = head_.load(std::memory_order_acquire);
    return tail_.load(std::memory_order_acquire) - head;
  }

 private:
  static constexpr std::size_t kMask = kCapacity - 1;

  // Each side's index lies with its own copy of the other's: while there is work, neither touches the other's line.
  alignas(kCacheLine) std::atomic<std::size_t> tail_{0};  ///< next place to write; producer writes, consumer reads
  std::size_t cached_head_ = 0;                           ///< producer's last look at head_
  alignas(kCacheLine) std::atomic<std::size_t> head_{0};  ///< next place to read; consumer writes, producer reads
  std::size_t cached_tail_ = 0;                           ///< consumer's last look at tail_
  alignas(kCacheLine) std::array<T, kCapacity> items_{};
};

}  // namespace godwit::rt
