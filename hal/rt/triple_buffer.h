// The latest value from one thread to one other: older ones are overwritten, nobody waits.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <type_traits>

#include "hal/rt/spsc_ring.h"

namespace godwit::rt {

/// One writer, one reader. Three buffers: one is the writer's, one the reader's, one lies between them; publishing and
/// fetching swap one's own with the one between. Wait-free, no allocation.
template <typename T>
class TripleBuffer {
  static_assert(std::is_trivially_copyable_v<T>, "values are copied as bytes: nothing that owns may travel here");

 public:
  TripleBuffer() = default;
  TripleBuffer(const TripleBuffer&) = delete;
  TripleBuffer& operator=(const TripleBuffer&) = delete;

  /// Writer. Makes value the latest one.
  void write(const T& value) {
    buffers_[back_].value = value;
    // Partner: the exchange in read. Release: the value is whole before its index can be seen. Acquire: the buffer that
    // comes back was the reader's or an unread one; the reader's last reads of it end before our next write to it.
    back_ = between_.exchange(static_cast<std::uint8_t>(back_ | kFresh), std::memory_order_acq_rel) & kIndex;
  }

  /// Reader. True, and *value the latest one, if something was written since the last call.
  bool read(T* value) {
    // A look before the swap: an exchange without news would hand the writer's fresh buffer back and forth for nothing.
    // Relaxed, because the exchange below orders; only the reader clears kFresh, so it cannot vanish in between.
    if ((between_.load(std::memory_order_relaxed) & kFresh) == 0) return false;
    // Partner: the exchange in write. Acquire: the value is read after the writer finished it. Release: our reads of
    // the old front buffer end before the writer can get it.
    front_ = between_.exchange(front_, std::memory_order_acq_rel) & kIndex;
    *value = buffers_[front_].value;
    return true;
  }

 private:
  static constexpr std::uint8_t kIndex = 3;
  static constexpr std::uint8_t kFresh = 4;  ///< the buffer between has not been read yet

  struct alignas(kCacheLine) Buffer {
    T value{};
  };
  std::array<Buffer, 3> buffers_{};
  alignas(kCacheLine) std::uint8_t back_ = 0;                 ///< writer's own
  alignas(kCacheLine) std::atomic<std::uint8_t> between_{1};  ///< index and kFresh; both sides exchange it
  alignas(kCacheLine) std::uint8_t front_ = 2;                ///< reader's own
};

}  // namespace godwit::rt
