#include "firmware_app/config_schema.h"

#include "hal/rt/frame_pool.h"

namespace godwit::app {

std::vector<Key> config_keys(Config* c) {
  return {
      keys::whole("pipeline.frame_slots", 0, rt::kMaxFrameSlots, &c->pipeline.frame_slots),
      keys::whole("pipeline.mapper_delay_frames", 1, 30, &c->pipeline.mapper_delay_frames),
  };
}

void check_contradictions(ConfigReport* /*report*/) {}

}  // namespace godwit::app
