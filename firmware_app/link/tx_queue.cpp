#include "firmware_app/link/tx_queue.h"

#include <algorithm>

#include "firmware_app/link/frame_bits.h"

namespace godwit::link {
namespace {
constexpr std::uint8_t kStart = 0x80;
constexpr std::uint8_t kEnd = 0x40;
constexpr std::uint8_t kTransferIdMask = 0x1F;
// Slots that answers and telemetry may not take, so that a flood of questions cannot keep the status out.
constexpr std::size_t kReservedForFlight = 8;
}  // namespace

void TxQueue::release(Slot& slot) {
  slot.used = false;
  --waiting_;
}

bool TxQueue::begin(TxClass tx_class, rt::TimeNs now_ns) {
  building_ = nullptr;
  overfull_ = false;
  if (tx_class == TxClass::kPose) {
    for (Slot& s : *slots_) {
      if (s.used && s.tx_class == TxClass::kPose && &s != sending_) {
        ++counters_.poses_replaced;
        release(s);
      }
    }
  }
  const std::size_t most = tx_class == TxClass::kService ? kMessages - kReservedForFlight : kMessages;
  if (waiting_ < most) {
    for (Slot& s : *slots_) {
      if (s.used) continue;
      building_ = &s;
      break;
    }
  }
  if (building_ == nullptr) {
    ++counters_.refused;
    return false;
  }
  building_->tx_class = tx_class;
  building_->t_queued_ns = now_ns;
  building_->frames = 0;
  building_->sent = 0;
  building_->prepared = 0;
  building_->bits = 0;
  return true;
}

bool TxQueue::add(const dronecan::Transfer& transfer, std::uint64_t signature, std::uint8_t* counter) {
  const std::size_t count = dronecan::to_frames(transfer, signature, &scratch_);
  if (building_ == nullptr || count == 0 || building_->frames + count > kMessageFrames) {
    overfull_ = true;
    return false;
  }
  for (std::size_t i = 0; i < count; ++i) {
    building_->counter[building_->frames] = i == 0 ? counter : nullptr;
    building_->frame[building_->frames++] = scratch_[i];
  }
  return true;
}

bool TxQueue::add_raw(const hal::CanFrame& frame) {
  if (building_ == nullptr || building_->frames == kMessageFrames) {
    overfull_ = true;
    return false;
  }
  building_->counter[building_->frames] = nullptr;
  building_->frame[building_->frames++] = frame;
  return true;
}

std::uint64_t TxQueue::commit() {
  Slot* slot = building_;
  building_ = nullptr;
  if (slot == nullptr || overfull_ || slot->frames == 0) {
    if (slot != nullptr) ++counters_.refused;
    return 0;
  }
  slot->used = true;
  slot->number = next_number_++;
  ++waiting_;
  return slot->number;
}

TxQueue::Slot* TxQueue::next_to_send() {
  // Flight messages and poses in the order they came; services only when none of those waits.
  Slot* best = nullptr;
  for (Slot& s : *slots_) {
    if (!s.used) continue;
    const bool service = s.tx_class == TxClass::kService;
    const bool best_is_service = best != nullptr && best->tx_class == TxClass::kService;
    if (best == nullptr || (best_is_service && !service) || (best_is_service == service && s.number < best->number)) {
      best = &s;
    }
  }
  return best;
}

// Gives the next frame its transfer id, once: a frame that the bus refuses is offered again as it is.
void TxQueue::prepare(Slot* slot) {
  hal::CanFrame& frame = slot->frame[slot->sent];
  if (slot->prepared > slot->sent) return;
  ++slot->prepared;
  if (!frame.extended) return;
  std::uint8_t& tail = frame.data[frame.length - 1U];
  if ((tail & kStart) != 0) {
    std::uint8_t* counter = slot->counter[slot->sent];
    late_transfer_id_ = counter != nullptr;
    if (late_transfer_id_) {
      transfer_id_ = *counter;
      *counter = static_cast<std::uint8_t>((*counter + 1) & kTransferIdMask);
    }
  }
  if (late_transfer_id_) tail = static_cast<std::uint8_t>((tail & ~kTransferIdMask) | transfer_id_);
}

std::size_t TxQueue::drain(hal::CanBus& bus, rt::TimeNs now_ns, std::size_t max_frames) {
  // What could not leave in time is dropped whole: old poses help nobody, and a bus that comes back begins afresh.
  for (Slot& s : *slots_) {
    const bool pose = s.tx_class == TxClass::kPose;
    if (!s.used || &s == sending_ || now_ns - s.t_queued_ns <= (pose ? kMaxSendNs : kMaxWaitNs)) continue;
    ++(pose ? counters_.poses_replaced : counters_.refused);
    release(s);
  }
  if (sending_ != nullptr && now_ns - sending_->t_begun_ns > kMaxSendNs) {
    ++counters_.abandoned;
    release(*sending_);
    sending_ = nullptr;
  }
  std::size_t taken = 0;
  while (taken < max_frames) {
    if (sending_ == nullptr) {
      sending_ = next_to_send();
      if (sending_ == nullptr) break;
      sending_->t_begun_ns = now_ns;
    }
    Slot& s = *sending_;
    prepare(&s);
    const hal::CanFrame& frame = s.frame[s.sent];
    const hal::CanSend result = bus.send(frame);
    if (result == hal::CanSend::kFull || result == hal::CanSend::kDown) {
      // Nothing of it has left: it may still give way to a newer one, and its transfer id was not used.
      if (s.sent == 0) {
        if (s.counter[0] != nullptr) *s.counter[0] = transfer_id_;
        s.prepared = 0;
        sending_ = nullptr;
      }
      break;
    }
    if (result == hal::CanSend::kRefused) {
      ++counters_.abandoned;
      release(s);
      sending_ = nullptr;
      continue;
    }
    ++taken;
    ++counters_.frames;
    const double bits = frame_bits(frame, fd_factor_);
    counters_.bits += bits;
    s.bits += bits;
    if (frame.extended && (frame.data[frame.length - 1U] & kEnd) != 0) ++counters_.transfers;
    if (++s.sent == s.frames) {
      ++counters_.messages;
      if (s.tx_class == TxClass::kPose) {
        last_pose_sent_ = s.number;
        last_pose_bits_ = s.bits;
      }
      release(s);
      sending_ = nullptr;
    }
  }
  return taken;
}

}  // namespace godwit::link
