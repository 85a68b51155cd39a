// Frames of a value, and a receiver of frames.
#pragma once

#include <array>
#include <gtest/gtest.h>
#include <vector>

#include "firmware_app/link/dronecan/transfer.h"
#include "firmware_app/link/dronecan/types.h"

namespace godwit::link::dronecan {

inline std::vector<TypeInfo> all_types() {
  std::vector<TypeInfo> types;
  for_each_type([&]<typename T>() { types.push_back(T::kType); });
  return types;
}

inline std::vector<CanFrame> frames_of(const Transfer& transfer, const TypeInfo& type) {
  FrameBuffer buffer;
  const std::size_t count = to_frames(transfer, type.signature, &buffer);
  return {buffer.begin(), buffer.begin() + static_cast<std::ptrdiff_t>(count)};
}

template <typename T>
std::vector<CanFrame> frames_of(const T& value, Transfer transfer) {
  std::array<std::uint8_t, kMaxPayload> payload;
  transfer.kind = T::kType.kind;
  transfer.type_id = T::kType.id;
  transfer.payload = {payload.data(), encode(value, payload, transfer.fd)};
  return frames_of(transfer, T::kType);
}

class Receiver {
 public:
  Receiver() : reassembler(all_types()) { reassembler.set_node_id(42); }
  bool accept(const CanFrame& frame) { return reassembler.accept(frame, now, &transfer); }
  bool accept_all(const std::vector<CanFrame>& frames) {
    bool done = false;
    for (const CanFrame& frame : frames) done = accept(frame);
    return done;
  }
  template <typename T>
  T decoded() {
    T value;
    EXPECT_TRUE(decode(transfer.payload, transfer.fd, &value));
    return value;
  }
  const ReassemblyCounters& counters() const { return reassembler.counters(); }
  Reassembler reassembler;
  Transfer transfer;
  rt::TimeNs now = rt::kNsPerSecond;
};

inline TunnelTargetted golden_tunnel() {
  TunnelTargetted t;
  t.protocol = 1;
  t.target_node = 10;
  t.options = 1;
  t.baudrate = 115200;
  t.buffer.size = 16;
  for (std::uint8_t i = 0; i < 16; ++i) t.buffer.item[i] = i;
  return t;
}

inline RangeMeasurement golden_range() {
  RangeMeasurement r;
  r.timestamp_us = 0x01020304050607;
  r.sensor_id = 3;
  r.roll_pitch_yaw = {0, -6, 0};
  r.orientation_defined = true;
  r.field_of_view_rad = 0.1F;
  r.sensor_type = 2;
  r.reading_type = 1;
  r.range_m = 12.5F;
  return r;
}

}  // namespace godwit::link::dronecan
