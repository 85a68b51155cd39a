#include "firmware_app/link/telemetry.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace godwit::link {
namespace {

// Fills a frame from its first bit on, least significant bits first, as DBC's byte order 1 counts them. A number that
// does not fit its field is set to the nearest one that does.
class Packer {
 public:
  Packer(std::uint32_t id, bool fd) {
    frame_.id = id;
    frame_.extended = false;
    frame_.fd = fd;
    frame_.length = fd ? 64 : 8;
  }
  void raw(std::uint64_t value, unsigned bits) {
    for (unsigned i = 0; i < bits; ++i, ++position_) {
      if ((value >> i & 1U) == 0) continue;
      std::uint8_t& byte = frame_.data[position_ / 8];
      byte = static_cast<std::uint8_t>(byte | 1U << (position_ % 8));
    }
  }
  void unsigned_number(double value, double resolution, unsigned bits) {
    const double most = std::ldexp(1.0, static_cast<int>(bits)) - 1;
    raw(static_cast<std::uint64_t>(std::clamp(std::round(value / resolution), 0.0, most)), bits);
  }
  void signed_number(double value, double resolution, unsigned bits) {
    const double most = std::ldexp(1.0, static_cast<int>(bits) - 1) - 1;
    const auto number = static_cast<std::int64_t>(std::clamp(std::round(value / resolution), -most, most));
    raw(static_cast<std::uint64_t>(number) & (~std::uint64_t{0} >> (64 - bits)), bits);
  }
  void single(double value) { raw(std::bit_cast<std::uint32_t>(static_cast<float>(value)), 32); }
  const hal::CanFrame& frame() const { return frame_; }

 private:
  hal::CanFrame frame_;
  unsigned position_ = 0;
};

double sigma(double variance) {
  return std::sqrt(std::max(0.0, variance));
}

void put_status(Packer* p, const TelemetrySnapshot& s) {
  p->raw(static_cast<unsigned>(s.state), 3);
  p->raw(s.has_scale ? 1 : 0, 1);
  p->raw(s.has_gravity ? 1 : 0, 1);
  p->raw(s.pose.quality > 0 ? 1 : 0, 1);
  p->raw(s.throttled ? 1 : 0, 1);
  p->raw(0, 1);
  p->signed_number(s.pose.quality, 1, 8);
  p->raw(s.reset_counter, 8);
  p->raw(s.map_id, 16);
  p->unsigned_number(rt::to_ms(s.age_ns), 0.1, 16);
}

}  // namespace

std::array<hal::CanFrame, kTelemetryFrames> telemetry_frames(const TelemetrySnapshot& s, std::uint8_t sequence,
                                                             std::uint32_t base_id) {
  const auto& C = s.pose.covariance;
  const auto begin = [&](std::uint32_t offset) {
    Packer p(base_id + offset, false);
    p.raw(sequence, 8);
    return p;
  };
  Packer status = begin(0), time = begin(1), xy = begin(2), z = begin(3), velocity = begin(4), attitude = begin(5),
         sigmas = begin(6);
  put_status(&status, s);
  time.raw(static_cast<std::uint64_t>(s.t_capture_ns / 1000) & 0xFFFFFFFFFFFFFFULL, 56);
  xy.signed_number(s.pose.position.x(), 1e-3, 28);
  xy.signed_number(s.pose.position.y(), 1e-3, 28);
  z.signed_number(s.pose.position.z(), 1e-3, 28);
  z.unsigned_number(sigma(std::max(C(0, 0), C(1, 1))), 0.01, 14);
  z.unsigned_number(sigma(C(2, 2)), 0.01, 14);
  for (int i = 0; i < 3; ++i) velocity.signed_number(s.pose.velocity(i), 1e-3, 18);
  for (int i = 0; i < 4; ++i) attitude.signed_number(s.pose.q(i), 1.0 / 8191, 14);
  sigmas.unsigned_number(sigma(std::max(C(3, 3), C(4, 4))), 2e-4, 14);
  sigmas.unsigned_number(sigma(C(5, 5)), 2e-4, 14);
  sigmas.unsigned_number(sigma(s.pose.velocity_covariance.diagonal().maxCoeff()), 0.01, 14);
  sigmas.signed_number(static_cast<double>(s.temperature_c), 0.5, 9);
  return {status.frame(), time.frame(), xy.frame(), z.frame(), velocity.frame(), attitude.frame(), sigmas.frame()};
}

hal::CanFrame telemetry_fd_frame(const TelemetrySnapshot& s, std::uint8_t sequence, std::uint32_t base_id) {
  const auto& C = s.pose.covariance;
  Packer p(base_id + kTelemetryFdOffset, true);
  p.raw(sequence, 8);
  put_status(&p, s);
  p.raw(static_cast<std::uint64_t>(s.t_capture_ns / 1000) & 0xFFFFFFFFFFFFFFULL, 56);
  p.signed_number(static_cast<double>(s.temperature_c), 0.5, 16);
  for (int i = 0; i < 3; ++i) p.single(s.pose.position(i));
  for (int i = 0; i < 3; ++i) p.single(s.pose.velocity(i));
  for (int i = 0; i < 4; ++i) p.signed_number(s.pose.q(i), 1.0 / 32767, 16);
  for (const double variance :
       {std::max(C(0, 0), C(1, 1)), C(2, 2), s.pose.velocity_covariance.diagonal().maxCoeff()}) {
    p.unsigned_number(sigma(variance), 0.01, 16);
  }
  for (const double variance : {std::max(C(3, 3), C(4, 4)), C(5, 5)}) p.unsigned_number(sigma(variance), 1e-4, 16);
  return p.frame();
}

bool TelemetrySender::due(const ParameterSet& parameters, rt::TimeNs now_ns) {
  const std::int64_t rate = parameters.get(Parameter::kTelemetryRate);
  if (rate == 0 || now_ns < t_next_ns_) return false;
  t_next_ns_ = now_ns + rt::kNsPerSecond / rate;
  return true;
}

void TelemetrySender::send(const TelemetrySnapshot& snapshot, const ParameterSet& parameters, TxQueue* queue,
                           rt::TimeNs now_ns) {
  if (!queue->begin(TxClass::kService, now_ns)) return;
  const auto base = static_cast<std::uint32_t>(parameters.get(Parameter::kTelemetryBase));
  ++sequence_;
  if (parameters.get(Parameter::kTelemetryFd) != 0) {
    queue->add_raw(telemetry_fd_frame(snapshot, sequence_, base));
  } else {
    for (const hal::CanFrame& frame : telemetry_frames(snapshot, sequence_, base)) queue->add_raw(frame);
  }
  queue->commit();
}

}  // namespace godwit::link
