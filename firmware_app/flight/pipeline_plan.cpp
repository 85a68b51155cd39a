#include "firmware_app/flight/pipeline_plan.h"

#include <malloc.h>

namespace godwit::app {

void plan_pipeline(const Config& config, double fps, PipelineOptions* options) {
  options->threads.camera = config.threads.camera;
  options->threads.imu = config.threads.imu;
  options->threads.detector = config.threads.detector;
  options->imu_silence_ns = static_cast<rt::TimeNs>(config.imu.silent_s * 1e9);
  options->threads.tracker = config.threads.tracker;
  options->threads.mapper = config.threads.mapper;
  SchedulerOptions& s = options->scheduler;
  s.deadline_ns = static_cast<rt::TimeNs>(config.scheduler.deadline_ms * 1e6);
  s.tracker_p95_ns = static_cast<rt::TimeNs>(config.scheduler.tracker_p95_ms * 1e6);
  s.temperature_c = config.scheduler.temperature_c;
  s.calm_ns = static_cast<rt::TimeNs>(config.scheduler.calm_s * 1e9);
  if (fps > 0) s.frame_ns = static_cast<rt::TimeNs>(1e9 / fps);
}

std::string arm_memory(const Config& config) {
  // What starting needed goes back first: locked, it would never.
  malloc_trim(0);
  return config.threads.lock_memory ? rt::lock_memory() : std::string();
}

std::string privilege_warning(const std::string& memory, const std::vector<std::string>& threads) {
  std::string out = memory;
  for (const std::string& thread : threads) {
    if (!out.empty()) out.append("; ");
    out.append(thread);
  }
  if (!out.empty()) out.insert(0, "not real-time, flying on without: ");
  return out;
}

}  // namespace godwit::app
