// The autopilot link beside a running pipeline: its threads, what it tells the log, and what it did in the end.
#pragma once

#include <array>
#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "firmware_app/autopilot/aid_watch.h"
#include "firmware_app/autopilot/bus_aids.h"
#include "firmware_app/autopilot/pose_sampler.h"
#include "firmware_app/config/config.h"
#include "firmware_app/link/link_service.h"
#include "firmware_app/pipeline/pipeline.h"
#include "hal/machine/machine_state.h"
#include "hal/rt/heartbeat.h"
#include "hal/rt/thread.h"

namespace godwit::app {

/// What the link says while it runs. One line, for people.
enum class LinkLogLevel : std::uint8_t { kInfo, kWarning };

/// Called on a thread that may block.
using LinkLog = std::function<void(LinkLogLevel, const std::string&)>;

struct LinkRunnerOptions {
  link::LinkSettings settings;
  LinkLog log;                                   ///< null: nobody listens
  rt::ThreadPlan thread;                         ///< of gw-link
  rt::TimeNs report_ns = 60 * rt::kNsPerSecond;  ///< so often the log gets its report
  std::optional<BusAidsOptions> aids;            ///< somebody reads aids(); settings.collect_inputs is then set
  /// Both threads beat in it, and the node's health says when any thread in it is silent. May be null; outlives the
  /// runner.
  rt::Heartbeats* heartbeats = nullptr;
  /// Called by finish() where a thread does not end in kEndPatienceNs, or by the process's end where that comes
  /// before; must not return. Null: it is waited for.
  std::function<void(const char* thread)> abandon;
};

/// Two threads: gw-link, under real-time rules, moves frames between bus and pipeline; gw-link-keep may block: it keeps
/// parameters and reset counter on disk, reads the temperature, watches the status and tells the log.
class LinkRunner final : public FrameTap {
 public:
  /// Opens bus or port and starts the threads. Everything that is wrong is told here. user_stop outlives the runner.
  static rt::Result<std::unique_ptr<LinkRunner>> start(const LinkRunnerOptions& options,
                                                       const std::atomic<bool>& user_stop);
  ~LinkRunner() override;
  LinkRunner(const LinkRunner&) = delete;
  LinkRunner& operator=(const LinkRunner&) = delete;

  /// The pipeline is to end: the user wants it, or a RestartNode came over the bus and was granted.
  const std::atomic<bool>& stop() const { return stop_; }
  bool restart_due() const { return restart_due_.load(std::memory_order_relaxed); }

  /// Tracker thread.
  void frame_begun() override { service_->frame_begun(); }
  /// Tracker thread: sends the frame's pose. No allocation, no lock, no wait.
  void frame_done(const FrameRecord& record) override;
  /// Tracker thread.
  void imu_silent(bool silent) override { imu_ok_.store(!silent, std::memory_order_relaxed); }
  /// Tracker thread.
  void detector_failed(bool failed) override { detector_ok_.store(!failed, std::memory_order_relaxed); }
  /// Tracker thread: it lives, and the camera is silent.
  void no_picture(rt::TimeNs now_ns, rt::TimeNs t_last_capture_ns) override;
  /// The inertial sensor's thread: for the poses between two pictures. No allocation, no lock, no wait.
  void reading(const hal::ImuSample& sample) override { service_->reading(sample); }
  /// For the tracker: what knows metres on the bus; null where nobody is to read it. As long as this lives.
  hal::AidSource* aids() { return aids_ ? &*aids_ : nullptr; }
  /// What became of it, a line a kind; any thread.
  std::vector<std::string> aid_words() const { return aids_ ? aid_report(*aids_) : std::vector<std::string>(); }

  /// As the autopilot was told last; -1: there was none. Any thread.
  int quality() const { return quality_.load(std::memory_order_relaxed); }

  /// Of the keeper's last look. Any thread that may lock.
  link::LinkStatus status() const {
    const std::lock_guard<std::mutex> lock(shown_mutex_);
    return shown_;
  }

  /// Ends the threads and returns the last status. Afterwards nothing is sent any more.
  const link::LinkStatus& finish();
  /// How gw-link fared; valid after finish().
  ThreadReport thread_report() const { return {"gw-link", faults_, link_thread_.stack_used()}; }

 private:
  LinkRunner(const LinkRunnerOptions& options, std::unique_ptr<link::LinkService> service,
             const std::atomic<bool>& user_stop);
  rt::Result<void> start_threads();
  void run_link();
  void run_keeper();
  void watch(const link::LinkStatus& status);
  void look_at_machine(rt::TimeNs now_ns);
  void watch_aids(rt::TimeNs now_ns);
  void tell(LinkLogLevel level, const std::string& text) const;

  const LinkRunnerOptions options_;
  std::unique_ptr<link::LinkService> service_;
  PoseSampler sampler_;  ///< tracker thread's
  std::optional<BusAids> aids_;
  AidWatch aid_watch_;  ///< keeper's
  const std::atomic<bool>& user_stop_;
  /// finish() -> both threads: end. Relaxed, as the two below: nothing is ordered by them.
  std::atomic<bool> ending_{false};
  std::atomic<bool> stop_{false};  ///< link thread -> pipeline
  /// Keeper -> finish(): it has nothing left to do. Release at its end, acquire before the join.
  std::atomic<bool> keeper_ended_{false};
  std::atomic<bool> restart_due_{false};  ///< link thread -> keeper and the pipeline's caller
  /// Tracker -> keeper: when it last gave a sign of life (0: not yet), and what it sees of the others. Relaxed:
  /// each stands for itself, and one that is seen a look late is told 50 ms late; the link's own watch has told the
  /// silence by then.
  std::atomic<rt::TimeNs> t_tracker_alive_ns_{0};
  std::atomic<int> quality_{-1};  ///< keeper -> anybody; relaxed, a figure alone
  std::atomic<bool> camera_silent_{false};
  std::atomic<bool> imu_ok_{true};
  std::atomic<bool> detector_ok_{true};
  link::SystemHealth health_;  ///< keeper's: as published last
  link::LinkStatus status_;    ///< keeper's; finish() reads it after the join
  link::LinkStatus told_;      ///< keeper's: what the log has been told
  mutable std::mutex shown_mutex_;
  link::LinkStatus shown_;  ///< status_, for status(); under shown_mutex_
  rt::TimeNs t_next_report_ns_ = 0;
  rt::TimeNs t_next_health_ns_ = 0;
  std::string told_storage_error_;
  const hal::MachineMonitor machine_;  ///< keeper's
  rt::PageFaults faults_;              ///< link thread's, from its first step on; finish() joins it
  rt::Pulse link_pulse_, keeper_pulse_;
  rt::Thread link_thread_;
  std::thread keeper_thread_;
};

/// The link that the configuration asks for, already sending; null where it asks for none. T_body_cam: of the camera's
/// calibration. Tells the log how the camera is mounted. departures: told of each pose that left, for whoever measures.
/// hears_aids: somebody reads aids().
rt::Result<std::unique_ptr<LinkRunner>> start_link(
    const Config& config, const std::optional<std::array<double, 16>>& T_body_cam, const LinkLog& log,
    const std::atomic<bool>& user_stop, link::DepartureRing* departures = nullptr, rt::Heartbeats* heartbeats = nullptr,
    std::function<void(const char*)> abandon = {}, bool wait_for_bus = false, bool hears_aids = false);

/// Lines for people: latency with the VISO_DELAY_MS to set, our own share of it, messages, bus load, what was lost.
std::vector<std::string> link_report(const link::LinkStatus& status);

/// The same as one JSON object, on one line.
std::string link_report_json(const link::LinkStatus& status);

}  // namespace godwit::app
