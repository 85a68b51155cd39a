#include "firmware_app/pipeline/part_thread.h"

#include <utility>

namespace godwit::app {

rt::Result<void> PartThread::start(const rt::ThreadPlan& plan, rt::Heartbeats* heartbeats, rt::TimeNs patience_ns,
                                   rt::WakeUp* at_end, std::function<void(rt::Pulse*)> body) {
  if (heartbeats != nullptr) pulse_ = heartbeats->watch(name_, patience_ns);
  auto started = thread_.start(name_, plan, [this, at_end, body = std::move(body)] {
    const rt::PageFaults before = rt::thread_page_faults();
    body(&pulse_);
    faults_ = rt::thread_page_faults() - before;
    pulse_.end();
    ended_.store(true, std::memory_order_release);
    at_end->post();
  });
  if (!started) pulse_.end();
  return started;
}

}  // namespace godwit::app
