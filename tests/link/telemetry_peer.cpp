// Prints telemetry snapshots and the frames made of them, for cantools to decode. Each line: what went in as
// "name=value ...", " | ", frames as ID:HEX.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <random>

#include "firmware_app/link/telemetry.h"
#include "tests/link/hex.h"

int main() {
  using namespace godwit::link;
  std::mt19937 random(3);
  const auto number = [&](double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
  };
  for (int i = 0; i < 2000; ++i) {
    const bool extreme = i % 20 == 0;
    TelemetrySnapshot s;
    s.state = static_cast<PoseState>(random() % 5);
    s.has_scale = random() % 2 != 0;
    s.has_gravity = random() % 2 != 0;
    s.reset_counter = static_cast<std::uint8_t>(random());
    s.map_id = static_cast<std::uint16_t>(random());
    s.t_capture_ns = static_cast<std::int64_t>(random()) * 100000;
    s.age_ns = static_cast<std::int64_t>(number(0, extreme ? 9e9 : 1e8));
    s.temperature_c = static_cast<float>(number(-40, extreme ? 500 : 110));
    s.throttled = random() % 2 != 0;
    s.pose = body_pose(PoseSample{}, {});
    s.pose.quality = static_cast<std::int8_t>(static_cast<int>(random() % 102) - 1);
    for (int k = 0; k < 3; ++k) {
      s.pose.position(k) = number(-1, 1) * (extreme ? 3e5 : 2000);
      s.pose.velocity(k) = number(-1, 1) * (extreme ? 290 : 40);
    }
    s.pose.q = Eigen::Vector4d(number(-1, 1), number(-1, 1), number(-1, 1), number(-1, 1)).normalized();
    for (int k = 0; k < 6; ++k) s.pose.covariance(k, k) = k < 3 ? number(0, 1e4) : number(0, 9);
    for (int k = 0; k < 3; ++k) s.pose.velocity_covariance(k, k) = number(0, 1e4);
    const auto& p = s.pose;
    std::printf(
        "Sequence=%d State=%d HasScale=%d HasGravity=%d Valid=%d Throttled=%d Quality=%d ResetCounter=%d MapId=%d "
        "Age=%.9f "
        "CaptureTime=%lld PositionX=%.9f PositionY=%.9f PositionZ=%.9f VelocityX=%.9f VelocityY=%.9f "
        "VelocityZ=%.9f QuaternionW=%.9f QuaternionX=%.9f QuaternionY=%.9f QuaternionZ=%.9f "
        "SigmaHorizontal=%.9f SigmaVertical=%.9f SigmaTilt=%.9f SigmaHeading=%.9f SigmaVelocity=%.9f "
        "Temperature=%.9f |",
        i % 256, static_cast<int>(s.state), s.has_scale, s.has_gravity, p.quality > 0, s.throttled, p.quality,
        s.reset_counter, s.map_id, static_cast<double>(s.age_ns) * 1e-6, static_cast<long long>(s.t_capture_ns / 1000),
        p.position.x(), p.position.y(), p.position.z(), p.velocity.x(), p.velocity.y(), p.velocity.z(), p.q(0), p.q(1),
        p.q(2), p.q(3), std::sqrt(std::max(p.covariance(0, 0), p.covariance(1, 1))), std::sqrt(p.covariance(2, 2)),
        std::sqrt(std::max(p.covariance(3, 3), p.covariance(4, 4))), std::sqrt(p.covariance(5, 5)),
        std::sqrt(p.velocity_covariance.diagonal().maxCoeff()), static_cast<double>(s.temperature_c));
    for (const auto& f : telemetry_frames(s, static_cast<std::uint8_t>(i), 0x300)) {
      std::printf(" %x:%s", f.id, to_hex({f.data.data(), f.length}).c_str());
    }
    const auto fd = telemetry_fd_frame(s, static_cast<std::uint8_t>(i), 0x300);
    std::printf(" %x:%s\n", fd.id, to_hex({fd.data.data(), fd.length}).c_str());
  }
  return 0;
}
