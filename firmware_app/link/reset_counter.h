// The reset counter that ODOMETRY carries, kept over a restart.
#pragma once

#include <cstdint>

#include "firmware_app/link/storage.h"

namespace godwit::link {

/// Counters are written to disk ahead of use, so that a crash cannot bring one back: a restart is a reset. One thread.
class ResetCounter {
 public:
  explicit ResetCounter(std::uint8_t first) : value_(first), reserved_(first) {}
  std::uint8_t value() const { return value_; }
  void add(std::uint8_t resets) { value_ = static_cast<std::uint8_t>(value_ + resets); }
  /// Asks for more where few are left. Call it at each step. No allocation.
  void reserve(Storage* storage) {
    const auto left = static_cast<std::uint8_t>(reserved_ - value_);
    if (left >= kReserve / 2 && left <= kReserve) return;
    StorageRequest request;
    request.kind = StorageRequest::Kind::kReserveResets;
    request.reset_counter = static_cast<std::uint8_t>(value_ + kReserve);
    if (storage->request(request)) reserved_ = request.reset_counter;
  }

 private:
  static constexpr std::uint8_t kReserve = 8;
  std::uint8_t value_;
  std::uint8_t reserved_;
};

}  // namespace godwit::link
