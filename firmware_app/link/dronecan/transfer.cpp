#include "firmware_app/link/dronecan/transfer.h"

#include <algorithm>

#include "hal/can/crc16.h"

namespace godwit::link::dronecan {
namespace {

constexpr std::uint8_t kStart = 0x80;
constexpr std::uint8_t kEnd = 0x40;
constexpr std::uint8_t kToggle = 0x20;
constexpr std::uint8_t kTransferIdMask = 0x1F;
constexpr std::uint32_t kServiceBit = 1U << 7;
constexpr std::uint32_t kRequestBit = 1U << 15;
constexpr std::uint32_t kPriorityMask = 0x1FU << 24;

// How far ahead of `from` the transfer id `to` is, modulo 32.
unsigned distance(unsigned from, unsigned to) {
  return (to - from) & kTransferIdMask;
}

// What an identifier says; transfer_id and payload are filled by the caller.
Transfer parse_id(std::uint32_t id) {
  Transfer t;
  t.priority = static_cast<std::uint8_t>(id >> 24 & 0x1F);
  t.source = static_cast<std::uint8_t>(id & 0x7F);
  if ((id & kServiceBit) != 0) {
    t.kind = (id & kRequestBit) != 0 ? TransferKind::kRequest : TransferKind::kResponse;
    t.type_id = static_cast<std::uint16_t>(id >> 16 & 0xFF);
    t.destination = static_cast<std::uint8_t>(id >> 8 & 0x7F);
  } else {
    t.type_id = static_cast<std::uint16_t>(t.source == 0 ? id >> 8 & 3 : id >> 8 & 0xFFFF);
  }
  return t;
}

}  // namespace

std::uint32_t can_id(const Transfer& t) {
  const std::uint32_t common = static_cast<std::uint32_t>(t.priority & 0x1F) << 24 | (t.source & 0x7FU);
  if (t.kind != TransferKind::kMessage) {
    return common | kServiceBit | (t.type_id & 0xFFU) << 16 | (t.kind == TransferKind::kRequest ? kRequestBit : 0) |
           (t.destination & 0x7FU) << 8;
  }
  if (t.source != 0) return common | static_cast<std::uint32_t>(t.type_id) << 8;
  // Two anonymous nodes must not send different data under one identifier: the payload's CRC tells them apart.
  return common | (hal::crc16(t.payload) & 0x3FFFU) << 10 | (t.type_id & 3U) << 8;
}

std::uint16_t signature_crc(std::uint64_t signature) {
  std::uint16_t crc = hal::kCrc16Initial;
  for (int i = 0; i < 8; ++i) crc = hal::crc16_add(crc, static_cast<std::uint8_t>(signature >> (8 * i)));
  return crc;
}

std::size_t to_frames(const Transfer& t, std::uint64_t signature, FrameBuffer* out) {
  const std::size_t room = t.fd ? hal::kFdCanBytes - 1 : hal::kClassicCanBytes - 1;
  const std::size_t size = t.payload.size();
  const bool single = size <= room;
  const bool anonymous = t.source == 0;
  if (size > kMaxPayload || (anonymous && (!single || t.kind != TransferKind::kMessage))) return 0;

  const std::size_t content = size + (single ? 0 : 2);
  const std::size_t in_last = single ? content : (content - 1) % room + 1;
  const std::size_t padding = t.fd ? hal::fd_frame_length(in_last + 1) - in_last - 1 : 0;
  std::uint16_t crc = hal::crc16(t.payload, signature_crc(signature));
  for (std::size_t i = 0; i < padding; ++i) crc = hal::crc16_add(crc, 0);

  const std::uint32_t id = can_id(t);
  const std::size_t total = content + padding;
  const auto byte_at = [&](std::size_t i) -> std::uint8_t {
    if (!single && i < 2) return static_cast<std::uint8_t>(crc >> (8 * i));
    const std::size_t at = single ? i : i - 2;
    return at < size ? t.payload[at] : 0;
  };
  std::size_t frames = 0;
  for (std::size_t done = 0; done < total || frames == 0; ++frames) {
    CanFrame& frame = (*out)[frames];
    const std::size_t take = std::min(room, total - done);
    frame.id = id;
    frame.extended = true;
    frame.fd = t.fd;
    for (std::size_t i = 0; i < take; ++i) frame.data[i] = byte_at(done + i);
    done += take;
    frame.data[take] = static_cast<std::uint8_t>((frames == 0 ? kStart : 0) | (done == total ? kEnd : 0) |
                                                 (frames % 2 == 1 ? kToggle : 0) | (t.transfer_id & kTransferIdMask));
    frame.length = static_cast<std::uint8_t>(take + 1);
  }
  return frames;
}

Reassembler::Reassembler(std::vector<TypeInfo> accepted) : accepted_(std::move(accepted)), sessions_(kSessions) {}

const TypeInfo* Reassembler::find_type(TransferKind kind, std::uint16_t id) const {
  const auto found =
      std::find_if(accepted_.begin(), accepted_.end(), [&](const TypeInfo& t) { return t.kind == kind && t.id == id; });
  return found == accepted_.end() ? nullptr : &*found;
}

Reassembler::Session* Reassembler::find_session(std::uint32_t key, std::uint8_t source) {
  Session* oldest = nullptr;
  for (Session& s : sessions_) {
    if (s.used && s.key == key) return &s;
    if (s.used && (s.key & 0x7F) == protected_source_ && source != protected_source_) continue;
    const bool better =
        oldest == nullptr || (oldest->used && !s.used) || (oldest->used == s.used && s.t_last_ns < oldest->t_last_ns);
    if (better) oldest = &s;
  }
  if (oldest == nullptr) return nullptr;
  if (oldest->used && oldest->open) ++counters_.evicted;
  oldest->used = false;
  oldest->open = false;
  oldest->key = key;
  return oldest;
}

void Reassembler::give_up(Session& session, std::uint64_t* counter) {
  session.open = false;
  ++*counter;
}

// First frame of a transfer. False: passed over.
bool Reassembler::start(Session& s, const CanFrame& frame, rt::TimeNs now_ns) {
  const std::uint8_t tail = frame.data[frame.length - 1U];
  const auto id = static_cast<std::uint8_t>(tail & kTransferIdMask);
  const bool stale = !s.used || now_ns - s.t_last_ns > kTransferTimeoutNs;
  if (!stale) {
    // One behind the id awaited: the transfer we had last, once more.
    if (distance(id, s.transfer_id) == 1) {
      ++counters_.repeated;
      return false;
    }
    if (s.open && id == s.transfer_id && frame.length == s.last_length &&
        std::equal(s.last.begin(), s.last.begin() + s.last_length, frame.data.begin())) {
      ++counters_.repeated;
      return false;
    }
  }
  if (s.used && s.open) give_up(s, stale ? &counters_.timed_out : &counters_.aborted);
  if ((tail & kToggle) != 0) {
    ++counters_.wrong_toggle;
    return false;
  }
  s.used = true;
  s.open = true;
  s.fd = frame.fd;
  s.toggle = false;
  s.transfer_id = id;
  s.size = 0;
  return true;
}

// A frame of the open transfer, its flags already checked. False: the transfer was given up.
bool Reassembler::append(Session& s, const CanFrame& frame, const TypeInfo& type) {
  const std::size_t bytes = frame.length - 1U;
  // Two bytes of CRC, and on CAN FD the padding of the last frame, come on top of the longest payload.
  const std::size_t most = type.max_bytes + 2 + (frame.fd ? hal::kFdCanBytes : 0);
  if (s.size + bytes > std::min(most, kBuffer)) {
    give_up(s, &counters_.too_long);
    return false;
  }
  std::copy_n(frame.data.begin(), bytes, s.buffer.begin() + static_cast<std::ptrdiff_t>(s.size));
  s.size += bytes;
  s.toggle = !s.toggle;
  s.last = frame.data;
  s.last_length = frame.length;
  return true;
}

bool Reassembler::accept(const CanFrame& frame, rt::TimeNs now_ns, Transfer* out) {
  ++counters_.frames;
  if (!frame.extended) {
    ++counters_.foreign;
    return false;
  }
  if (frame.length == 0 || frame.length > (frame.fd ? hal::kFdCanBytes : hal::kClassicCanBytes)) {
    ++counters_.malformed;
    return false;
  }
  *out = parse_id(frame.id);
  const bool service = out->kind != TransferKind::kMessage;
  const TypeInfo* type = find_type(out->kind, out->type_id);
  if (type == nullptr || (service && (out->destination != node_id_ || node_id_ == 0))) {
    ++counters_.foreign;
    return false;
  }
  const std::uint8_t tail = frame.data[frame.length - 1U];
  const bool first = (tail & kStart) != 0, last = (tail & kEnd) != 0;
  out->transfer_id = tail & kTransferIdMask;
  out->fd = frame.fd;

  if (out->source == 0) {
    if (service || !first || !last || (tail & kToggle) != 0) {
      ++counters_.malformed;
      return false;
    }
    out->payload = {frame.data.data(), frame.length - 1U};
    ++counters_.transfers;
    return true;
  }
  const std::size_t full = frame.fd ? hal::kFdCanBytes : hal::kClassicCanBytes;
  if (!last && frame.length != full) {
    ++counters_.malformed;
    return false;
  }
  Session* found = find_session(frame.id & ~kPriorityMask, out->source);
  if (found == nullptr) {
    ++counters_.evicted;
    return false;
  }
  Session& s = *found;
  if (first) {
    if (!start(s, frame, now_ns)) return false;
  } else {
    if (!s.used || !s.open) {
      // The echo of a last frame whose transfer is done is no error, nor is any frame of that transfer sent again.
      const bool same = s.last_length == frame.length &&
                        std::equal(s.last.begin(), s.last.begin() + s.last_length, frame.data.begin());
      const bool echo = s.used && (same || distance(out->transfer_id, s.transfer_id) == 1);
      ++(echo ? counters_.repeated : counters_.missed_start);
      return false;
    }
    if (now_ns - s.t_last_ns > kTransferTimeoutNs) {
      give_up(s, &counters_.timed_out);
      return false;
    }
    if (out->transfer_id != s.transfer_id || frame.fd != s.fd) {
      give_up(s, frame.fd == s.fd ? &counters_.wrong_transfer_id : &counters_.malformed);
      return false;
    }
    if (((tail & kToggle) != 0) != s.toggle) {
      if (frame.length == s.last_length &&
          std::equal(s.last.begin(), s.last.begin() + s.last_length, frame.data.begin())) {
        ++counters_.repeated;  // the same frame again, as a controller sends when only the acknowledgement was lost
      } else {
        give_up(s, &counters_.wrong_toggle);
      }
      return false;
    }
  }
  s.t_last_ns = now_ns;
  if (!append(s, frame, *type) || !last) return false;

  s.open = false;  // and the same transfer id stays awaited, so that a repetition of a damaged transfer is taken
  std::span<const std::uint8_t> payload(s.buffer.data(), s.size);
  if (!first) {
    if (payload.size() < 2) {
      ++counters_.malformed;
      return false;
    }
    const unsigned sent = payload[0] | static_cast<unsigned>(payload[1]) << 8;
    payload = payload.subspan(2);
    if (hal::crc16(payload, signature_crc(type->signature)) != sent) {
      ++counters_.bad_crc;
      return false;
    }
  }
  s.transfer_id = static_cast<std::uint8_t>((s.transfer_id + 1) & kTransferIdMask);
  out->payload = payload;
  ++counters_.transfers;
  return true;
}

}  // namespace godwit::link::dronecan
