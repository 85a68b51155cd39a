// DroneCAN frames from a stranger: the input is a list of frames (flags, length, identifier, data), given to
// reassembly; each whole transfer goes through the decoder of its type and back through the encoder.
#include <algorithm>
#include <cstdint>
#include <cstdlib>

#include "firmware_app/link/dronecan/transfer.h"
#include "firmware_app/link/dronecan/types.h"

namespace {
using namespace godwit::link::dronecan;

template <typename T>
void round_trip(const Transfer& transfer) {
  T value;
  if (!decode(transfer.payload, transfer.fd, &value)) return;
  std::array<std::uint8_t, kMaxPayload> payload;
  const std::size_t size = encode(value, payload, transfer.fd);
  // What was understood can be said again; only a type without fields has no bytes.
  if (size == 0 && T::kType.max_bytes != 0) std::abort();
  if (size > T::kType.max_bytes) std::abort();
  T again;
  if (!decode({payload.data(), size}, transfer.fd, &again)) std::abort();
}
}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::vector<TypeInfo> types;
  for_each_type([&]<typename T>() { types.push_back(T::kType); });
  Reassembler reassembler(types);
  reassembler.set_node_id(42);
  reassembler.protect_source(10);
  godwit::rt::TimeNs now = 0;
  while (size >= 6) {
    CanFrame frame;
    frame.fd = (data[0] & 1U) != 0;
    frame.extended = (data[0] & 2U) == 0;
    now += static_cast<godwit::rt::TimeNs>(data[0] >> 2) * 50 * godwit::rt::kNsPerMs;
    frame.length = static_cast<std::uint8_t>(data[1] % 72);  // longer than a frame, too: the bus may be anything
    frame.id = (data[2] | data[3] << 8 | data[4] << 16 | static_cast<std::uint32_t>(data[5]) << 24) & 0x1FFFFFFFU;
    data += 6;
    size -= 6;
    const std::size_t take = std::min({size, static_cast<std::size_t>(frame.length), frame.data.size()});
    std::copy_n(data, take, frame.data.begin());
    data += take;
    size -= take;
    Transfer transfer;
    if (!reassembler.accept(frame, now, &transfer)) continue;
    if (transfer.payload.size() > kMaxPayload + 64) std::abort();
    for_each_type([&]<typename T>() {
      if (T::kType.kind == transfer.kind && T::kType.id == transfer.type_id) round_trip<T>(transfer);
    });
  }
  return 0;
}
