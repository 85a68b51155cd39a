// Flies a known trajectory through the link on a real bus, for the Python peers to look at:
//   godwit_link_peer --can multicast:0 [--mavlink udp:...] --seconds S [--state DIR] [--poses FILE] [--rate HZ]
//     [--set NAME=VALUE]... [--lost FROM:TO] [--new-map] [--stall FROM:TO] [--reset AT] [--scale-at AT] [--no-gravity]
//     [--origin]
// Writes each pose it published to FILE ("t_us state px py pz qw qx qy qz vx vy vz scale", camera in world), and at the
// end one line of JSON with what the link says of itself and how long a step with a pose took. Exit code 75:
// RestartNode came.
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <memory>
#include <string>
#include <vector>

#include "firmware_app/link/link_node.h"
#include "hal/rt/wake_up.h"

namespace {
using namespace godwit;
using namespace godwit::link;

struct Window {
  double from = 1e9, to = 1e9;
  bool holds(double t) const { return t >= from && t < to; }
};

struct Options {
  std::string can, mavlink, state, poses;
  double seconds = 10, camera_hz = 30, reset_at = 1e9, scale_at = 0;
  Window lost, stall;
  bool gravity = true;
  bool new_map = false;  ///< after it was lost: one that begins where it was found
  LinkConfig link;
};

Window window(const char* text) {
  Window w;
  std::sscanf(text, "%lf:%lf", &w.from, &w.to);
  return w;
}

bool parse(int argc, char** argv, Options* o) {
  for (int i = 1; i < argc; ++i) {
    const std::string a = argv[i];
    const bool has_value = i + 1 < argc;
    const auto value = [&] { return argv[++i]; };
    if (a == "--no-gravity")
      o->gravity = false;
    else if (a == "--new-map")
      o->new_map = true;
    else if (a == "--origin")
      o->link.mavlink.origin = mavlink::GlobalOrigin{47.3977, 8.5456, 488.0};
    else if (!has_value)
      return false;
    else if (a == "--can")
      o->can = value();
    else if (a == "--mavlink")
      o->mavlink = value();
    else if (a == "--state")
      o->state = value();
    else if (a == "--poses")
      o->poses = value();
    else if (a == "--seconds")
      o->seconds = std::atof(value());
    else if (a == "--rate")
      o->camera_hz = std::atof(value());
    else if (a == "--scale-at")
      o->scale_at = std::atof(value());
    else if (a == "--reset")
      o->reset_at = std::atof(value());
    else if (a == "--lost")
      o->lost = window(value());
    else if (a == "--stall")
      o->stall = window(value());
    else if (a == "--set") {
      const std::string pair = value();
      const auto equals = pair.find('=');
      const Parameter p = ParameterSet::find(pair.substr(0, equals));
      if (p == Parameter::kCount || equals == std::string::npos) return false;
      o->link.parameters[static_cast<std::size_t>(p)] = std::atoll(pair.c_str() + equals + 1);
    } else {
      return false;
    }
  }
  return !o->can.empty() || !o->mavlink.empty();
}

// The mounting: looking ahead and 0.35 rad down, off the body's centre. link_test.py knows it too.
Eigen::Matrix3d body_cam() {
  const double c = std::cos(0.35), d = std::sin(0.35);
  return Eigen::Matrix3d{{0, -d, c}, {1, 0, 0}, {0, c, d}};
}
const Eigen::Vector3d kArm(0.2, 0.05, -0.1);

// A figure of eight with climbs and turns.
PoseSample pose_at(double t) {
  const double yaw = 0.4 * std::sin(0.3 * t), pitch = 0.1 * std::sin(0.7 * t), roll = 0.1 * std::cos(0.5 * t);
  const Eigen::Matrix3d world_flu =
      (Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(pitch, Eigen::Vector3d::UnitY()) *
       Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitX()))
          .toRotationMatrix();
  const Eigen::Matrix3d world_body = world_flu * Eigen::Vector3d(1, -1, -1).asDiagonal();
  const Eigen::Quaterniond q(world_body * body_cam());
  PoseSample s;
  s.state = PoseState::kTracking;
  s.has_gravity = true;
  s.measurements = 120;
  s.map_id = 1;
  s.position = {5 * std::sin(0.4 * t), 3 * std::sin(0.8 * t), 1.5 + 0.5 * std::cos(0.3 * t)};
  s.velocity = {2 * std::cos(0.4 * t), 2.4 * std::cos(0.8 * t), -0.15 * std::sin(0.3 * t)};
  s.orientation = {q.w(), q.x(), q.y(), q.z()};
  s.angular_velocity = {0.1, -0.05, 0.2};
  for (std::size_t i = 0; i < 6; ++i) s.covariance[7 * i] = i < 3 ? 0.0025 : 0.0001;
  for (std::size_t i = 0; i < 3; ++i) s.velocity_covariance[4 * i] = 0.01;
  return s;
}

}  // namespace

int main(int argc, char** argv) {
  Options o;
  if (!parse(argc, argv, &o)) {
    std::fprintf(stderr, "godwit_link_peer: bad arguments; see the head of its source\n");
    return 2;
  }
  std::unique_ptr<hal::CanBus> bus;
  std::unique_ptr<BytePort> bytes;
  if (!o.can.empty()) {
    auto opened = hal::open_can(o.can);
    if (!opened.ok()) return std::fprintf(stderr, "%s\n", opened.error().message.c_str()), 1;
    bus = std::move(opened).value();
  }
  if (!o.mavlink.empty()) {
    auto opened = open_byte_port(o.mavlink);
    if (!opened.ok()) return std::fprintf(stderr, "%s\n", opened.error().message.c_str()), 1;
    bytes = std::move(opened).value();
  }
  Storage storage(o.state);
  const auto stored = storage.load(o.link.parameters);
  if (!stored.ok()) return std::fprintf(stderr, "%s\n", stored.error().message.c_str()), 1;
  auto poses = std::make_unique<rt::TripleBuffer<PoseSample>>();
  auto health = std::make_unique<rt::TripleBuffer<SystemHealth>>();
  auto inputs = std::make_unique<InputRing>();
  o.link.identity.unique_id = {1, 2, 3, 4, 5, 6, 7, 8};
  o.link.odometry.R_body_cam = body_cam();
  o.link.odometry.t_body_cam = kArm;
  LinkPorts ports{bus.get(), bytes.get(), &storage, poses.get(), health.get(), inputs.get(), nullptr};
  auto created = LinkNode::create(o.link, ports, stored.value());
  if (!created.ok()) return std::fprintf(stderr, "%s\n", created.error().message.c_str()), 1;
  const std::unique_ptr<LinkNode> link = std::move(created).value();
  SystemHealth well;
  well.temperature_c = 41.5F;
  health->write(well);

  std::FILE* log = o.poses.empty() ? nullptr : std::fopen(o.poses.c_str(), "w");
  const rt::TimeNs start = rt::monotonic_now_ns();
  const auto period = static_cast<rt::TimeNs>(1e9 / o.camera_hz);
  rt::TimeNs next_frame = start + period;
  std::vector<double> own_ms, wall_ms;
  std::array<std::uint64_t, static_cast<std::size_t>(InputKind::kBusTime) + 1> input_counts{};
  std::uint8_t resets = 0;
  std::array<double, 3> map_start{};
  while (!link->restart_due()) {
    rt::TimeNs now = rt::monotonic_now_ns();
    const double t = rt::to_seconds(now - start);
    if (t >= o.seconds) break;
    bool pose = false;
    if (now >= next_frame + 5 * rt::kNsPerMs) {  // five milliseconds of odometry
      PoseSample s = pose_at(rt::to_seconds(next_frame - start));
      s.t_capture_ns = next_frame;
      s.has_scale = t >= o.scale_at;
      s.has_gravity = o.gravity;
      if (t >= o.reset_at && resets == 0) resets = 1;
      s.reset_counter = resets;
      if (o.lost.holds(t)) {
        s.state = PoseState::kLost;
        if (o.new_map) s.map_id = 0;
      } else if (o.new_map && t >= o.lost.to) {
        if (map_start == std::array<double, 3>{}) map_start = s.position;
        for (std::size_t i = 0; i < 3; ++i) s.position[i] -= map_start[i];
        s.map_id = 2;
      }
      pose = !o.stall.holds(t);
      if (pose) {
        poses->write(s);
        if (log != nullptr) {
          std::fprintf(log, "%lld %d %.9f %.9f %.9f %.9f %.9f %.9f %.9f %.9f %.9f %.9f %d\n",
                       static_cast<long long>(s.t_capture_ns / 1000), static_cast<int>(s.state), s.position[0],
                       s.position[1], s.position[2], s.orientation[0], s.orientation[1], s.orientation[2],
                       s.orientation[3], s.velocity[0], s.velocity[1], s.velocity[2], s.has_scale ? 1 : 0);
          std::fflush(log);
        }
      }
      next_frame += period;
    }
    now = rt::monotonic_now_ns();
    const rt::TimeNs cpu = rt::thread_cpu_now_ns();
    link->step(now);
    if (pose) {
      own_ms.push_back(rt::to_ms(rt::thread_cpu_now_ns() - cpu));
      wall_ms.push_back(rt::to_ms(rt::monotonic_now_ns() - now));
    }
    AutopilotInput input;
    while (inputs->try_pop(&input)) ++input_counts[static_cast<std::size_t>(input.kind)];
    storage.serve();
    rt::sleep_until_ns(std::min(next_frame + 5 * rt::kNsPerMs, now + rt::kNsPerMs));
  }
  if (log != nullptr) std::fclose(log);
  const auto at = [](std::vector<double>& values, double share) {
    std::sort(values.begin(), values.end());
    return values.empty() ? 0.0 : values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
  };
  const LinkStatus& s = link->status();
  const auto count = [&](InputKind kind) {
    return static_cast<unsigned long long>(input_counts.at(static_cast<std::size_t>(kind)));
  };
  std::printf(
      "{\"own_p50_ms\": %.4f, \"own_p99_ms\": %.4f, \"wall_p99_ms\": %.4f, \"latency_min_ms\": %.3f, "
      "\"latency_p50_ms\": %.3f, "
      "\"latency_p99_ms\": %.3f, \"viso_delay_ms\": %d, \"round_trip_ms\": %.3f, \"bus_load\": %.3f, "
      "\"odometry\": %llu, \"paced\": %llu, \"replaced\": %llu, \"errors\": %llu, \"reset_counter\": %d, "
      "\"node_id\": %d, \"attitude\": %llu, \"range\": %llu, \"local\": %llu, \"global\": %llu, \"imu\": %llu, "
      "\"pressure\": %llu, \"time\": %llu}\n",
      at(own_ms, 0.5), at(own_ms, 0.99), at(wall_ms, 0.99), s.latency.min_ms, s.latency.p50_ms, s.latency.p99_ms,
      s.latency.viso_delay_ms, s.round_trip_ms, s.bus_load_percent, static_cast<unsigned long long>(s.odometry_sent),
      static_cast<unsigned long long>(s.poses_paced), static_cast<unsigned long long>(s.tx.poses_replaced),
      static_cast<unsigned long long>(s.reception.errors()), s.reset_counter, s.node_id, count(InputKind::kAttitude),
      count(InputKind::kRange), count(InputKind::kLocalPosition), count(InputKind::kGlobalPosition),
      count(InputKind::kImu), count(InputKind::kPressure), count(InputKind::kBusTime));
  return link->restart_due() ? 75 : 0;
}
