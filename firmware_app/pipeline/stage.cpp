#include "firmware_app/pipeline/stage.h"

namespace godwit::app {

void track_frame(FrameStage* stage, const rt::FrameHandle& handle, FrameRecord* record) {
  *record = {};
  record->sequence = handle.meta.sequence;
  record->t_source_ns = handle.meta.t_source_ns;
  record->t_capture_ns = handle.meta.t_capture_ns;
  record->t_delivered_ns = handle.meta.t_delivered_ns;
  const rt::TimeNs wall = rt::monotonic_now_ns();
  const rt::TimeNs cpu = rt::thread_cpu_now_ns();
  stage->track(handle, record);
  record->thread_cpu_ns = rt::thread_cpu_now_ns() - cpu - record->view_cpu_ns;
  record->t_done_ns = rt::monotonic_now_ns();
  record->wall_ns = record->t_done_ns - wall - record->view_ns;
}

}  // namespace godwit::app
