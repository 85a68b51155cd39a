#include "firmware_app/commands/doctor_autopilot.h"

#include <limits>

#include "firmware_app/autopilot/aid_watch.h"
#include "firmware_app/config/link_settings.h"
#include "firmware_app/link/axis_words.h"
#include "firmware_app/link/doctor.h"

namespace godwit::app {
namespace {

constexpr rt::TimeNs kWaitForAutopilotNs = 5 * rt::kNsPerSecond;
/// Rangefinder, barometer and satellites are asked for one after another, and come some five times a second.
constexpr rt::TimeNs kAidListenNs = 4 * rt::kNsPerSecond;

const char* severity_text(link::Severity severity) {
  return severity == link::Severity::kWarning ? "works, but: " : "";
}

/// Which of rangefinder, barometer, satellites and attitude come, and whether godwitd would use them.
void listen_for_aids(const Config& config, link::LinkService* service, DoctorReport* report,
                     const std::atomic<bool>& stop) {
  if (!config.aids.any()) return;
  BusAids aids(bus_aids_options(config), service->inputs());
  const rt::TimeNs end = rt::monotonic_now_ns() + kAidListenNs;
  while (rt::monotonic_now_ns() < end && !stop.load(std::memory_order_relaxed)) {
    step_link(service);
    hal::AidSample sample;
    while (aids.next_until(std::numeric_limits<rt::TimeNs>::max(), &sample)) {
    }
  }
  bool lengths = false;
  for (int i = 0; i < hal::kLengthKinds; ++i)
    lengths = lengths || aids.heard(static_cast<hal::AidKind>(i)).t_heard_ns != 0;
  if (!lengths) report->note("aids: neither rangefinder nor barometer nor satellites are heard on the bus");
  for (const std::string& line : aid_report(aids)) report->note(line);
}

/// Where another node than the one that is configured speaks through a tunnel: that it is likely the autopilot.
std::string other_node(const Config& config, const BusHeard& heard) {
  if (heard.tunnels.empty() || heard.tunnels.count(config.can.autopilot_node) > 0) return {};
  return fmt::format("Is the autopilot node {0}? Then set can.autopilot_node {0}. Else: ", *heard.tunnels.begin());
}

}  // namespace

void step_link(link::LinkService* service) {
  service->wait(5 * rt::kNsPerMs);
  service->step(rt::monotonic_now_ns());
  service->serve_storage();
}

std::unique_ptr<link::LinkService> examine_autopilot(const Config& config, const hal::CameraCalibration& calibration,
                                                     const BusHeard& heard, std::optional<int> viso_delay_ms,
                                                     DoctorReport* report, const std::atomic<bool>& stop) {
  link::LinkSettings settings = link_settings(config, calibration.T_body_cam);
  settings.link.patience.first_ns = 3600 * rt::kNsPerSecond;  // no pose is to come
  // The tilt test reads the attitude, the search for aids what they are made of, nobody the rest.
  ask_for_aids(config, &settings);
  settings.link.mavlink.attitude_hz = 20;
  auto opened = link::LinkService::open(settings);
  if (!opened) {
    report->wrong(opened.error().message);
    return nullptr;
  }
  std::unique_ptr<link::LinkService> service = std::move(opened).value();
  report->note("mounting: " + link::mounting_words(settings.link.odometry.R_body_cam));
  link::LinkNode& node = service->node();
  const auto running = [&](rt::TimeNs end) {
    return rt::monotonic_now_ns() < end && !stop.load(std::memory_order_relaxed);
  };
  const rt::TimeNs give_up = rt::monotonic_now_ns() + kWaitForAutopilotNs;
  while (running(give_up) && !node.endpoint().autopilot_alive(rt::monotonic_now_ns())) step_link(service.get());
  const bool through_bus = config.link.mavlink.empty();
  if (!node.endpoint().autopilot_alive(rt::monotonic_now_ns())) {
    report->wrong(
        through_bus ? fmt::format("autopilot: no HEARTBEAT through the tunnel in 5 s from node {} (can.autopilot_node, "
                                  "CAN_D1_UC_NODE); nodes on the bus: {}. {}Set CAN_P1_DRIVER 1, CAN_D1_PROTOCOL 1, "
                                  "CAN_D1_UC_SER_EN 1, "
                                  "restart it, then CAN_D1_UC_S1_NOD {}, CAN_D1_UC_S1_IDX {}, CAN_D1_UC_S1_PRO 2, "
                                  "and restart it again: serial ports over CAN are made at its start",
                                  config.can.autopilot_node, node_words(heard), other_node(config, heard),
                                  config.can.node_id, config.can.serial_index)
                    : "autopilot: no HEARTBEAT on " + config.link.mavlink + " in 5 s: wiring, baud rate, port");
    return service;
  }
  report->fits("autopilot: its HEARTBEAT comes");
  report->note("while this runs there is no pose: the autopilot may say that our node is unhealthy");
  listen_for_aids(config, service.get(), report, stop);
  if (config.link.profile == Config::Link::Profile::kPx4) {
    report->note("autopilot: parameters of PX4 are not looked at; docs/px4.md lists them");
    return service;
  }
  link::ParameterReader reader(link::doctor_parameters());
  const rt::TimeNs give_up_reading = rt::monotonic_now_ns() + 90 * rt::kNsPerSecond;
  while (running(give_up_reading) && !reader.step(&node.endpoint(), rt::monotonic_now_ns())) step_link(service.get());
  link::DoctorConfig looked_for;
  looked_for.node_id = config.can.node_id;
  looked_for.serial_index = config.can.serial_index;
  looked_for.through_tunnel = through_bus;
  looked_for.t_body_cam = settings.link.odometry.t_body_cam;
  looked_for.viso_delay_ms = viso_delay_ms;
  looked_for.submarine = node.endpoint().vehicle_type() == link::mavlink::Heartbeat::kTypeSubmarine;
  const std::vector<link::Finding> findings = link::diagnose(reader.values(), looked_for);
  bool all_fit = true;
  for (const link::Finding& finding : findings) {
    const std::string words = "autopilot: " + std::string(severity_text(finding.severity)) + finding.words;
    if (finding.severity == link::Severity::kNote) {
      report->note(words);
    } else {
      report->wrong(words);
      all_fit = false;
    }
  }
  if (all_fit) report->fits(fmt::format("autopilot: its {} parameters fit", reader.values().size()));
  if (!viso_delay_ms) {
    report->note("VISO_DELAY_MS was not compared: fly or replay once, then give what it told by --delay-ms");
  }
  return service;
}

}  // namespace godwit::app
