// The caller's thread while the others fly: hands finished frames and events to the sink, looks after threads and end.
#pragma once

#include <atomic>

#include "firmware_app/pipeline/channels.h"
#include "firmware_app/pipeline/pipeline.h"

namespace godwit::app {

/// Somebody outside wants the run to end.
inline bool stop_asked(const PipelineOptions& options, const std::atomic<bool>& stop) {
  // Relaxed: a flag alone, nothing is ordered by it.
  return stop.load(std::memory_order_relaxed) ||
         (options.also_stop != nullptr && options.also_stop->load(std::memory_order_relaxed));
}

class Collector {
 public:
  /// All outlive it.
  Collector(hal::Camera* camera, const PipelineOptions& options, Channels* channels, FrameSink* sink)
      : camera_(camera), options_(options), channels_(channels), sink_(sink) {}

  /// Until the tracker's thread has ended and its last record is taken. Raises Channels::stop when it is asked to end,
  /// or when the sink fails, whose error it returns. refused: what the machine refused of the threads' plans.
  /// take_last() when all threads have been joined: what the detector and the inertial sensor told last.
  rt::Result<void> collect(const std::vector<std::string>& refused, const std::atomic<bool>& stop,
                           PipelineCounters* counters);
  void take_last();

 private:
  void take_detections();
  void take_readings();
  bool take_one(FrameRecord* record, bool all_done);
  void take_records(bool all_done, PipelineCounters* counters);
  void take_events();
  void look_at_machine(rt::TimeNs now_ns);
  void look_for_silence(rt::TimeNs now_ns);
  void insist_on_end(rt::TimeNs now_ns);

  hal::Camera* const camera_;
  const PipelineOptions& options_;
  Channels* const channels_;
  FrameSink* const sink_;
  rt::Pulse pulse_;
  rt::Result<void> taken_;  ///< what the sink said last
  rt::TimeNs t_machine_due_ns_ = 0;
  rt::TimeNs t_stop_ns_ = 0;             ///< when the run was told to end; 0: not yet
  const char* silent_thread_ = nullptr;  ///< told to the log as silent
};

}  // namespace godwit::app
