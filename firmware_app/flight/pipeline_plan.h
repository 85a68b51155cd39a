// From a configuration to a pipeline that is armed: memory, threads, scheduler.
#pragma once

#include <string>
#include <vector>

#include "firmware_app/config/config.h"
#include "firmware_app/pipeline/pipeline.h"

namespace godwit::app {

/// Threads, scheduler and limits as the configuration wants them. fps: of the camera; 0 or less: 30.
void plan_pipeline(const Config& config, double fps, PipelineOptions* options);

/// Locks the memory if the configuration wants it; call when everything is allocated. Returns what was refused, in
/// words; empty: nothing. Blocks.
std::string arm_memory(const Config& config);

/// One warning for all that the machine refused; empty for nothing.
std::string privilege_warning(const std::string& memory, const std::vector<std::string>& threads);

}  // namespace godwit::app
