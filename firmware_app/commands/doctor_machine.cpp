#include "firmware_app/commands/doctor_machine.h"

#include <cmath>
#include <poll.h>

#include "firmware_app/flight/devices.h"
#include "firmware_app/flight/scenario_folder.h"
#include "firmware_app/link/dronecan/types.h"
#include "firmware_app/pipeline/odometry_stage.h"
#include "firmware_app/sim/flight_calibration.h"
#include "hal/camera/replay/replay_camera.h"
#include "hal/can/can_bus.h"
#include "hal/can/can_link.h"
#include "hal/rt/frame_pool.h"

namespace godwit::app {
namespace {

constexpr int kPictures = 30;
constexpr rt::TimeNs kPatienceNs = 2 * rt::kNsPerSecond;
constexpr double kRateTolerance = 0.1;

/// Pictures that came in time, and their rate by capture times; 0 with fewer than two.
struct Taken {
  int pictures = 0;
  int bad = 0;
  double rate_hz = 0;
  std::string why;
};

Taken take_pictures(hal::Camera* camera) {
  Taken taken;
  rt::FramePool::Layout layout;
  layout.width = camera->width();
  layout.height = camera->height();
  layout.slots = 1;
  layout.readers = 1;
  auto pool = rt::FramePool::create(layout);
  if (!pool) {
    taken.why = pool.error().message;
    return taken;
  }
  const int slot = pool.value()->acquire();
  const rt::TimeNs give_up = rt::monotonic_now_ns() + kPatienceNs;
  rt::TimeNs first = 0, last = 0;
  while (taken.pictures < kPictures && rt::monotonic_now_ns() < give_up) {
    hal::CapturedFrame frame;
    const auto status = camera->next(pool.value()->grey(slot), nullptr, 100 * rt::kNsPerMs, &frame, &taken.why);
    if (status == hal::CameraStatus::kEnd) break;
    if (status == hal::CameraStatus::kBadFrame) ++taken.bad;
    if (status != hal::CameraStatus::kFrame) continue;
    if (taken.pictures++ == 0) first = frame.t_capture_ns;
    last = frame.t_capture_ns;
  }
  if (taken.pictures > 1) taken.rate_hz = (taken.pictures - 1) / rt::to_seconds(last - first);
  return taken;
}

void judge(const std::string& name, hal::Camera* camera, const hal::CameraCalibration& calibration,
           DoctorReport* report) {
  const Taken taken = take_pictures(camera);
  if (taken.pictures == 0) {
    report->wrong(name + ": no picture came within 2 s" + (taken.why.empty() ? "" : ": " + taken.why));
    return;
  }
  report->fits(fmt::format("{}: opens, {} x {} pixels, {:.1f} pictures a second", name, camera->width(),
                           camera->height(), taken.rate_hz));
  if (taken.bad > 0) report->wrong(fmt::format("{}: {} bad pictures: {}", name, taken.bad, taken.why));
  if (calibration.width != camera->width() || calibration.height != camera->height()) {
    report->wrong(fmt::format("{}: its calibration is for {} x {} pixels: calibrate at the size that is flown", name,
                              calibration.width, calibration.height));
  } else if (const auto model = make_camera_model(calibration); !model) {
    report->wrong(name + ": calibration: " + model.error().message);
  } else {
    report->fits(name + ": the calibration fits its size");
  }
  if (calibration.fps > 0 && taken.rate_hz > 0 && std::abs(taken.rate_hz / calibration.fps - 1) > kRateTolerance) {
    report->wrong(
        fmt::format("{}: {:.1f} pictures a second, its calibration says {:.1f}", name, taken.rate_hz, calibration.fps));
  }
  if (taken.rate_hz > 0 && taken.rate_hz < 20) {
    report->wrong(fmt::format("{}: {:.1f} pictures a second; an autopilot wants 20 to 40", name, taken.rate_hz));
  }
}

}  // namespace

DoctorCamera examine_camera(const Config& config, const std::string& sequence, DoctorReport* report) {
  using Source = Config::Camera::Source;
  DoctorCamera out;
  if (!sequence.empty() || config.camera.source == Source::kReplay) {
    const std::string& folder = sequence.empty() ? config.camera.sequence : sequence;
    hal::ReplayOptions options;
    options.pace = hal::ReplayOptions::Pace::kReal;
    auto camera = hal::ReplayCamera::open(folder, options);
    if (!camera) {
      report->wrong("camera: " + camera.error().message);
      return out;
    }
    out.calibration = camera.value()->calibration();
    judge("camera (sequence " + folder + ")", camera.value().get(), out.calibration, report);
    out.camera = std::move(camera).value();
    return out;
  }
  if (config.camera.source == Source::kNone) {
    report->wrong("camera: none is configured (camera.source is \"none\"): godwitd would not start");
    return out;
  }
  if (config.camera.live()) {
    auto device = open_camera(config.camera, [](const std::string& words) { fmt::print("note   {}\n", words); });
    if (!device) {
      report->wrong(device.error().message);
      return out;
    }
    out.calibration = device.value().calibration;
    judge("camera " + config.camera.device, device.value().camera.get(), out.calibration, report);
    out.camera = std::move(device.value().camera);
    return out;
  }
  const auto scenario = sim::find_scenario(config.camera.scenario, scenario_folder(config.camera.scenarios));
  if (!scenario) {
    report->wrong("camera: " + scenario.error().message);
    return out;
  }
  out.flight = std::make_unique<sim::Flight>(scenario.value(), config.camera.seed);
  out.calibration = calibration_of(*out.flight);
  out.camera = out.flight->camera(0);
  judge("camera (simulated, " + config.camera.scenario + ")", out.camera.get(), out.calibration, report);
  return out;
}

BusHeard examine_bus(const Config& config, DoctorReport* report) {
  BusHeard heard;
  const std::string name = "bus " + config.can.bus;
  auto bus = hal::open_can(config.can.bus);
  if (!bus) {
    report->wrong(bus.error().message);
    return heard;
  }
  hal::CanBus& can = *bus.value();
  for (const std::string& advice : can.advice()) report->wrong(advice);
  if (can.bit_rate() != 0 && can.bit_rate() != 1'000'000) {
    report->wrong(
        fmt::format("{}: {} bit/s; ArduPilot's default is 1000000 (CAN_P1_BITRATE), and slower ones cannot carry "
                    "30 poses a second",
                    name, can.bit_rate()));
  }
  if (config.can.fd && !can.supports_fd()) {
    report->wrong(name + ": can.fd is true, but the interface is not set to CAN FD (ip link set ... fd on)");
  }
  bool twice = false;
  const rt::TimeNs end = rt::monotonic_now_ns() + 1200 * rt::kNsPerMs;
  for (rt::TimeNs now = 0; (now = rt::monotonic_now_ns()) < end && heard.frames < 100'000;) {
    can.maintain(now);
    hal::CanFrame frame;
    while (can.receive(&frame) && ++heard.frames < 100'000) {
      const auto node = static_cast<int>(frame.id & 0x7FU);
      const bool message = frame.extended && node != 0 && (frame.id & 0x80U) == 0;
      const std::uint32_t type = frame.id >> 8 & 0xFFFFU;
      twice = twice || (frame.extended && node == config.can.node_id);
      if (message && type == link::dronecan::NodeStatus::kType.id) heard.nodes.insert(node);
      if (message && type == link::dronecan::TunnelTargetted::kType.id) heard.tunnels.insert(node);
    }
    pollfd event{can.descriptor(), POLLIN, 0};
    poll(&event, 1, 20);
  }
  if (twice && config.can.node_id != 0) {
    report->wrong(
        fmt::format("{}: somebody is there as node {} already: stop godwitd first (systemctl stop godwitd), or "
                    "change can.node_id",
                    name, config.can.node_id));
  } else if (can.state() != hal::CanState::kActive && can.state() != hal::CanState::kWarning) {
    report->wrong(name + ": no contact (down, off or error-passive): wiring, termination, bit rate");
  } else if (heard.frames == 0) {
    report->wrong(name +
                  ": open, but not a frame of anybody came in 1.2 s: wiring, termination, bit rate, or nobody "
                  "else is on it");
  } else {
    report->fits(
        fmt::format("{}: open, {} frames of others in 1.2 s; nodes: {}", name, heard.frames, node_words(heard)));
  }
  return heard;
}

std::string node_words(const BusHeard& heard) {
  std::set<int> all = heard.nodes;
  all.insert(heard.tunnels.begin(), heard.tunnels.end());
  std::string out;
  for (const int node : all) {
    out += (out.empty() ? "" : ", ") + std::to_string(node);
    if (heard.tunnels.count(node) > 0) out += " (speaks through a tunnel)";
  }
  return out.empty() ? "none" : out;
}

}  // namespace godwit::app
