#include "firmware_app/link/dronecan/allocation_client.h"

#include <algorithm>

namespace godwit::link::dronecan {
namespace {
constexpr std::size_t kMaxPart = 6;  // what fits an anonymous classic frame
constexpr std::int64_t kMinRequestMs = 600;
constexpr std::int64_t kMaxRequestMs = 1000;
constexpr std::int64_t kMaxFollowUpMs = 400;
}  // namespace

AllocationClient::AllocationClient(const UniqueId& unique_id, std::uint8_t preferred)
    : unique_id_(unique_id), preferred_(preferred), random_state_(0x9E3779B97F4A7C15ULL) {
  // Nodes must draw different delays, and one node the same ones in every run: the unique id is the seed.
  for (const std::uint8_t byte : unique_id) random_state_ = (random_state_ ^ byte) * 0x100000001B3ULL;
}

rt::TimeNs AllocationClient::random_ns(std::int64_t low_ms, std::int64_t high_ms) {
  random_state_ ^= random_state_ << 13;
  random_state_ ^= random_state_ >> 7;
  random_state_ ^= random_state_ << 17;
  const auto span = static_cast<std::uint64_t>((high_ms - low_ms) * rt::kNsPerMs);
  return low_ms * rt::kNsPerMs + static_cast<rt::TimeNs>(random_state_ % span);
}

bool AllocationClient::step(rt::TimeNs now_ns, Allocation* request) {
  if (node_id_ != 0) return false;
  if (t_next_ns_ == 0) t_next_ns_ = now_ns + random_ns(kMinRequestMs, kMaxRequestMs);
  if (now_ns < t_next_ns_) return false;
  request->node_id = preferred_;
  request->first_part = offset_ == 0;
  request->unique_id.size = std::min(kMaxPart, unique_id_.size() - offset_);
  std::copy_n(unique_id_.begin() + static_cast<std::ptrdiff_t>(offset_), request->unique_id.size,
              request->unique_id.item.begin());
  // Unless the allocator answers, begin again with the first part.
  offset_ = 0;
  t_next_ns_ = now_ns + random_ns(kMinRequestMs, kMaxRequestMs);
  return true;
}

void AllocationClient::take(const Allocation& message, std::uint8_t source, rt::TimeNs now_ns) {
  if (node_id_ != 0) return;
  offset_ = 0;
  t_next_ns_ = now_ns + random_ns(kMinRequestMs, kMaxRequestMs);
  const std::size_t size = message.unique_id.size;
  if (source == 0 || size == 0 ||
      !std::equal(unique_id_.begin(), unique_id_.begin() + static_cast<std::ptrdiff_t>(size),
                  message.unique_id.item.begin())) {
    return;
  }
  if (size < unique_id_.size()) {
    offset_ = size;
    t_next_ns_ = now_ns + random_ns(0, kMaxFollowUpMs);
  } else if (message.node_id > 0 && message.node_id <= 125) {
    node_id_ = message.node_id;
  }
}

}  // namespace godwit::link::dronecan
