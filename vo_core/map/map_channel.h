// The two one-way streets between tracker and mapper: messages there, deltas back. Items are written and read in place.
#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <memory>

#include "hal/rt/spsc_ring.h"
#include "vo_core/map/map_exchange.h"

namespace godwit::vo {

/// A ring of N large items that are filled and read where they lie. One producer, one consumer, no lock, no allocation
/// after construction. Two rings of indices carry the items to and fro, so the items need not be copyable as bytes.
template <typename T, std::size_t N>
class ExchangeRing {
 public:
  /// Not filled with zeros: pages that no message ever reaches are not touched (armed, all are locked and so touched).
  ExchangeRing() : items_(std::make_unique_for_overwrite<std::array<T, N>>()) {
    for (std::size_t i = 0; i < N; ++i) free_.try_push(static_cast<std::uint8_t>(i));
  }

  /// Producer: an item to fill, or null when all are on their way. The same item is returned until commit().
  T* claim() {
    if (claimed_ < 0) {
      std::uint8_t i;
      if (!free_.try_pop(&i)) return nullptr;
      claimed_ = i;
    }
    return &(*items_)[claimed_];
  }
  /// Producer: sends the claimed item.
  void commit() {
    filled_.try_push(static_cast<std::uint8_t>(claimed_));
    claimed_ = -1;
  }
  /// Producer: items that could be claimed now.
  std::size_t free_items() const { return free_.size() + (claimed_ >= 0 ? 1 : 0); }

  /// Consumer: the oldest item, or null.
  T* front() {
    const std::uint8_t* i = filled_.front();
    return i ? &(*items_)[*i] : nullptr;
  }
  /// Consumer: gives the front item back.
  void pop() {
    std::uint8_t i;
    if (filled_.try_pop(&i)) free_.try_push(i);
  }

 private:
  std::unique_ptr<std::array<T, N>> items_;
  rt::SpscRing<std::uint8_t, std::bit_ceil(N)> filled_;
  rt::SpscRing<std::uint8_t, std::bit_ceil(N)> free_;
  int claimed_ = -1;
};

/// Tracker -> mapper and back.
struct MapChannel {
  ExchangeRing<MapperMessage, 12> messages;  ///< the tracker produces; each may hold a frame slot
  ExchangeRing<MapDelta, 8> deltas;          ///< the mapper produces
};

}  // namespace godwit::vo
