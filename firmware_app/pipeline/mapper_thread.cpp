#include "firmware_app/pipeline/mapper_thread.h"

#include "hal/rt/rt_scope.h"

namespace godwit::app {

void MapperThread::run(rt::Pulse* pulse) {
  Channels& c = *channels_;
  while (!c.tracker_done.load(std::memory_order_acquire)) {
    pulse->beat();
    const rt::RtScope real_time;
    if (stage_->map_step()) {
      c.mapper_cpu_ns.store(rt::thread_cpu_now_ns(), std::memory_order_relaxed);
      // One message less; the tracker's next look corrects it. Never below zero: the tracker may have looked in
      // between.
      int seen = c.mapper_backlog.load(std::memory_order_relaxed);
      while (seen > 0 && !c.mapper_backlog.compare_exchange_weak(seen, seen - 1, std::memory_order_relaxed)) {
      }
      c.feeder_wake.post();
    } else {
      c.mapper_backlog.store(0, std::memory_order_relaxed);
      c.feeder_wake.post();
      c.mapper_wake.wait_for(kSleepNs);
    }
  }
}

}  // namespace godwit::app
