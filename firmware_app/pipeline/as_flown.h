// A flight flown again as it was flown: the same pictures, each finding what it found then, in one thread.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "firmware_app/pipeline/detector_stage.h"
#include "firmware_app/pipeline/flown_order.h"
#include "firmware_app/pipeline/pipeline.h"

namespace godwit::app {

/// A frame that was tracked, as its flight log has it.
struct FlownFrame {
  std::uint32_t sequence = 0;
  rt::TimeNs t_source_ns = 0, t_capture_ns = 0;
  FlownOrder order;
  bool has_pose = false;  ///< its pose is in the log
  std::array<double, 3> t_world_cam{};
  std::array<double, 4> q_world_cam{};
};

/// A flight as its log has it: without a gap from its first frame on.
struct FlownLog {
  std::vector<FlownFrame> frames;               ///< in the order in which they were flown
  std::map<rt::TimeNs, FoundBoxes> detections;  ///< by the capture time of their picture
  std::string gap;                              ///< why there are no more frames, in words; empty: it is whole
};

/// Reads the camera, without a pace, to the last frame of the log (PipelineOptions::as_flown). Pictures that were not
/// flown then are passed over. The mapper is done with each frame before the next; boxes of the log stand in for the
/// detector, so that neither its network nor its machine matters. Error: the sink's; pictures or readings that are not
/// those of the flight; a detector or an inertial sensor that is not there.
rt::Result<PipelineCounters> run_as_flown(hal::Camera* camera, FrameStage* stage, rt::FramePool* pool,
                                          const PipelineOptions& options, FrameSink* sink,
                                          const std::atomic<bool>& stop);

}  // namespace godwit::app
