#include "firmware_app/autopilot/link_runner.h"

#include <cmath>
#include <pthread.h>

#include "firmware_app/config/link_settings.h"
#include "firmware_app/link/axis_words.h"
#include "hal/rt/process_end.h"
#include "hal/rt/rt_scope.h"
#include "hal/rt/wake_up.h"

namespace godwit::app {
namespace {

constexpr rt::TimeNs kStepNs = 5 * rt::kNsPerMs;
constexpr rt::TimeNs kKeeperPeriodNs = 50 * rt::kNsPerMs;
/// The tracker tells of each frame, and of a silent camera every 100 ms: without either for so long it hangs.
constexpr rt::TimeNs kTrackerHangsNs = 500 * rt::kNsPerMs;
/// The link thread steps every 5 ms; the keeper may wait for a disc or for the log.
constexpr rt::TimeNs kLinkSilentNs = 500 * rt::kNsPerMs;
constexpr rt::TimeNs kKeeperSilentNs = 3 * rt::kNsPerSecond;

const char* bus_state_text(hal::CanState state) {
  switch (state) {
    case hal::CanState::kActive:
      return "on";
    case hal::CanState::kWarning:
      return "counting errors";
    case hal::CanState::kPassive:
      return "error-passive: nobody acknowledges, or the wiring is bad";
    case hal::CanState::kBusOff:
      return "off after too many errors";
    case hal::CanState::kGone:
      return "gone";
  }
  return "unknown";
}

}  // namespace

rt::Result<std::unique_ptr<LinkRunner>> LinkRunner::start(const LinkRunnerOptions& options,
                                                          const std::atomic<bool>& user_stop) {
  auto service = link::LinkService::open(options.settings);
  if (!service.ok()) return service.error();
  std::unique_ptr<LinkRunner> self(new LinkRunner(options, std::move(service).value(), user_stop));
  for (const std::string& advice : self->service_->advice()) self->tell(LinkLogLevel::kWarning, advice);
  if (auto started = self->start_threads(); !started.ok()) return started.error();
  return self;
}

rt::Result<void> LinkRunner::start_threads() {
  if (options_.heartbeats != nullptr) link_pulse_ = options_.heartbeats->watch("gw-link", kLinkSilentNs);
  if (auto started = link_thread_.start("gw-link", options_.thread, [this] { run_link(); }); !started.ok()) {
    link_pulse_.end();
    return started.error();
  }
  if (!link_thread_.warning().empty()) tell(LinkLogLevel::kWarning, link_thread_.warning());
  if (options_.heartbeats != nullptr) keeper_pulse_ = options_.heartbeats->watch("gw-link-keep", kKeeperSilentNs);
  keeper_thread_ = std::thread([this] { run_keeper(); });
  return {};
}

LinkRunner::LinkRunner(const LinkRunnerOptions& options, std::unique_ptr<link::LinkService> service,
                       const std::atomic<bool>& user_stop)
    : options_(options),
      service_(std::move(service)),
      sampler_(world_of_level_start(options.settings.link.odometry.R_body_cam), options.settings.link.odometry.north),
      user_stop_(user_stop) {
  t_next_report_ns_ = rt::monotonic_now_ns() + options.report_ns;
  told_.bus_state = hal::CanState::kActive;
  if (options.aids) aids_.emplace(*options.aids, service_->inputs());
}

LinkRunner::~LinkRunner() {
  finish();
}

const link::LinkStatus& LinkRunner::finish() {
  ending_.store(true, std::memory_order_relaxed);
  const rt::TimeNs give_up_ns = rt::monotonic_now_ns() + kEndPatienceNs;
  rt::join_in_time(&link_thread_, give_up_ns - rt::monotonic_now_ns(), options_.abandon);
  if (keeper_thread_.joinable()) {
    const auto ended = [this] { return keeper_ended_.load(std::memory_order_acquire); };
    rt::await_end(ended, "gw-link-keep", give_up_ns - rt::monotonic_now_ns(), options_.abandon);
    keeper_thread_.join();
  }
  service_->take_status(&status_);
  return status_;
}

void LinkRunner::frame_done(const FrameRecord& record) {
  if (PoseSampler::nothing_new(record)) {
    service_->picture_repeated();
  } else {
    service_->publish(sampler_.sample(record));
  }
  camera_silent_.store(false, std::memory_order_relaxed);
  t_tracker_alive_ns_.store(rt::monotonic_now_ns(), std::memory_order_relaxed);
}

void LinkRunner::no_picture(rt::TimeNs now_ns, rt::TimeNs /*t_last_capture_ns*/) {
  camera_silent_.store(true, std::memory_order_relaxed);
  t_tracker_alive_ns_.store(now_ns, std::memory_order_relaxed);
}

// Silence itself is an error at once, by the link node's own watch; here it gets its reason.
void LinkRunner::look_at_machine(rt::TimeNs now_ns) {
  link::SystemHealth health = health_;
  const rt::TimeNs t_alive_ns = t_tracker_alive_ns_.load(std::memory_order_relaxed);
  health.camera_ok = !camera_silent_.load(std::memory_order_relaxed);
  health.process_ok = t_alive_ns == 0 || now_ns - t_alive_ns < kTrackerHangsNs;
  health.imu_ok = imu_ok_.load(std::memory_order_relaxed);
  health.detector_ok = detector_ok_.load(std::memory_order_relaxed);
  if (health == health_ && now_ns < t_next_health_ns_) return;
  if (now_ns >= t_next_health_ns_) {
    t_next_health_ns_ = now_ns + rt::kNsPerSecond;
    const hal::MachineState machine = machine_.read();
    if (std::isfinite(machine.temperature_c)) health.temperature_c = static_cast<float>(machine.temperature_c);
    health.throttled = machine.throttled;
  }
  health_ = health;
  service_->publish(health);
}

void LinkRunner::run_link() {
  const rt::PageFaults before = rt::thread_page_faults();
  // After RestartNode it goes on, so that the answer is sent and the node is seen until the process ends.
  while (!ending_.load(std::memory_order_relaxed)) {
    service_->wait(kStepNs);
    const rt::RtScope real_time;
    link_pulse_.beat();
    service_->step(rt::monotonic_now_ns());
    if (service_->node().restart_due()) restart_due_.store(true, std::memory_order_relaxed);
    // Not the keeper's: a disc or a log that hangs must not keep the end away.
    if (user_stop_.load(std::memory_order_relaxed) || restart_due()) stop_.store(true, std::memory_order_relaxed);
  }
  link_pulse_.end();
  faults_ = rt::thread_page_faults() - before;
}

void LinkRunner::run_keeper() {
  pthread_setname_np(pthread_self(), "gw-link-keep");
  while (!ending_.load(std::memory_order_relaxed)) {
    service_->serve_storage();
    const std::string& error = service_->storage_error();
    if (error != told_storage_error_ && !options_.settings.state_folder.empty()) {
      told_storage_error_ = error;
      tell(LinkLogLevel::kWarning, error);
    }
    look_at_machine(rt::monotonic_now_ns());
    if (service_->take_status(&status_)) {
      watch(status_);
      const std::lock_guard<std::mutex> lock(shown_mutex_);
      shown_ = status_;
    }
    watch_aids(rt::monotonic_now_ns());
    quality_.store(status_.quality, std::memory_order_relaxed);
    keeper_pulse_.beat();
    rt::sleep_until_ns(rt::monotonic_now_ns() + kKeeperPeriodNs);
  }
  service_->serve_storage();
  keeper_pulse_.end();
  keeper_ended_.store(true, std::memory_order_release);
}

void LinkRunner::watch(const link::LinkStatus& s) {
  if (s.autopilot_alive != told_.autopilot_alive) {
    tell(s.autopilot_alive ? LinkLogLevel::kInfo : LinkLogLevel::kWarning,
         s.autopilot_alive ? "an autopilot is there" : "the autopilot fell silent (no HEARTBEAT for 3 s)");
  }
  if (s.bus_state != told_.bus_state && s.bus.sent + s.bus.received + s.bus.send_failed > 0) {
    tell(s.bus_state == hal::CanState::kActive ? LinkLogLevel::kInfo : LinkLogLevel::kWarning,
         std::string("the bus is ") + bus_state_text(s.bus_state));
  }
  if (s.mavlink.foreign_heartbeats != 0 && told_.mavlink.foreign_heartbeats == 0) {
    tell(LinkLogLevel::kWarning, "the HEARTBEAT of another autopilot is ignored: system " +
                                     std::to_string(s.mavlink.foreign_system) + ", component " +
                                     std::to_string(s.mavlink.foreign_component));
  }
  if (s.port_gone != told_.port_gone) {
    tell(s.port_gone ? LinkLogLevel::kWarning : LinkLogLevel::kInfo,
         s.port_gone ? "the MAVLink port is not there; it is looked for once a second" : "the MAVLink port is there");
  }
  if (s.own_id_heard != told_.own_id_heard) {
    tell(s.own_id_heard ? LinkLogLevel::kWarning : LinkLogLevel::kInfo,
         (s.own_id_heard ? "another node speaks under our node id " : "no other node speaks any more under our id ") +
             std::to_string(s.node_id));
  }
  if (s.latency.grew && !told_.latency.grew) {
    tell(LinkLogLevel::kWarning, "the latency grew: set VISO_DELAY_MS anew, or find what slows this computer down");
  }
  const rt::TimeNs now = rt::monotonic_now_ns();
  if (now >= t_next_report_ns_ || (s.latency.grew && !told_.latency.grew)) {
    t_next_report_ns_ = now + options_.report_ns;
    for (const std::string& line : link_report(s)) tell(LinkLogLevel::kInfo, line);
    for (const std::string& line : aid_words()) tell(LinkLogLevel::kInfo, line);
  }
  told_ = s;
}

void LinkRunner::watch_aids(rt::TimeNs now_ns) {
  if (!aids_) return;
  for (const AidNews& news : aid_watch_.look(*aids_, now_ns))
    tell(news.warning ? LinkLogLevel::kWarning : LinkLogLevel::kInfo, news.words);
}

rt::Result<std::unique_ptr<LinkRunner>> start_link(const Config& config,
                                                   const std::optional<std::array<double, 16>>& T_body_cam,
                                                   const LinkLog& log, const std::atomic<bool>& user_stop,
                                                   link::DepartureRing* departures, rt::Heartbeats* heartbeats,
                                                   std::function<void(const char*)> abandon, bool wait_for_bus,
                                                   bool hears_aids) {
  if (!wants_link(config)) return std::unique_ptr<LinkRunner>();
  LinkRunnerOptions options;
  options.settings = link_settings(config, T_body_cam);
  options.settings.departures = departures;
  options.thread = config.threads.link;
  options.log = log;
  options.heartbeats = heartbeats;
  options.settings.link.heartbeats = heartbeats;
  options.settings.wait_for_bus = wait_for_bus;
  if (hears_aids && config.aids.any()) {
    options.aids = bus_aids_options(config);
    ask_for_aids(config, &options.settings);
  }
  options.abandon = std::move(abandon);
  auto link = LinkRunner::start(options, user_stop);
  if (link.ok()) log(LinkLogLevel::kInfo, "link: " + link::mounting_words(options.settings.link.odometry.R_body_cam));
  return link;
}

void LinkRunner::tell(LinkLogLevel level, const std::string& text) const {
  if (options_.log) options_.log(level, "link: " + text);
}

}  // namespace godwit::app
