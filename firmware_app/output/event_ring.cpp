#include "firmware_app/output/event_ring.h"

#include <algorithm>
#include <cassert>
#include <new>
#include <string>

namespace godwit::app {

std::size_t EventRing::picture_bytes() const {
  return static_cast<std::size_t>(size_.width) * static_cast<std::size_t>(size_.height);
}

std::size_t EventRing::Size::bytes() const {
  return static_cast<std::size_t>(width) * static_cast<std::size_t>(height) * pictures +
         samples * sizeof(hal::ImuSample);
}

rt::Result<std::unique_ptr<EventRing>> EventRing::create(const Size& size) {
  assert(size.pictures > 0 && size.width > 0 && size.height > 0);
  std::unique_ptr<EventRing> ring(new EventRing(size));
  try {
    ring->memory_.resize(ring->picture_bytes() * size.pictures);
    ring->meta_.resize(size.pictures);
    ring->samples_.resize(size.samples);
  } catch (const std::bad_alloc&) {
    return rt::Error{"no memory for " + std::to_string(size.pictures) + " pictures"};
  }
  return ring;
}

std::uint8_t* EventRing::place() {
  if (next_ - first_ == size_.pictures) {
    if (first_ >= keep_from_) return nullptr;
    ++first_;
  }
  return memory_.data() + picture_bytes() * index(next_);
}

void EventRing::added(const rt::FrameMeta& meta) {
  assert(next_ - first_ < size_.pictures);
  meta_[index(next_)] = meta;
  ++next_;
}

rt::ImageView EventRing::pixels(std::uint64_t number) const {
  return {memory_.data() + picture_bytes() * index(number), size_.width, size_.height, size_.width};
}

std::uint64_t EventRing::at(rt::TimeNs t_capture_ns, std::uint64_t first) const {
  std::uint64_t number = std::max(first, first_);
  while (number < next_ && meta(number).t_capture_ns < t_capture_ns) ++number;
  return number;
}

void EventRing::add(const hal::ImuSample& sample) {
  if (samples_.empty()) return;
  samples_[samples_seen_ % samples_.size()] = sample;
  ++samples_seen_;
}

void EventRing::copy_samples(rt::TimeNs from_ns, rt::TimeNs to_ns, std::vector<hal::ImuSample>* out) const {
  out->clear();
  const std::uint64_t held = std::min<std::uint64_t>(samples_seen_, samples_.size());
  for (std::uint64_t i = samples_seen_ - held; i < samples_seen_; ++i) {
    const hal::ImuSample& s = samples_[i % samples_.size()];
    if (s.t_ns >= from_ns && s.t_ns <= to_ns) out->push_back(s);
  }
}

}  // namespace godwit::app
