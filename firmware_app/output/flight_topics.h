// What stands in a flight log, topic by topic (docs/flight-log.md). Pure.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "firmware_app/link/link_node.h"
#include "firmware_app/output/ulog.h"
#include "firmware_app/pipeline/detector_stage.h"
#include "firmware_app/pipeline/frame_record.h"
#include "hal/imu/imu.h"
#include "hal/machine/machine_state.h"

namespace godwit::app::flight_topics {

enum Topic : std::uint16_t {
  kPose,
  kFrame,
  kMapper,
  kMachine,
  kLog,
  kOrder,
  kDetection,
  kBox,
  kEnd,
  kLoad,
  kImu,
  kBus,
  kTopics
};

/// What each file begins with: when, `info` by key and value, `parameters`, and the topics with their fields.
std::string definitions(const std::vector<std::pair<std::string, std::string>>& info,
                        const std::vector<std::pair<std::string, double>>& parameters, rt::TimeNs t_ns);

ulog::Sample frame(const FrameRecord& r);
/// Of a record that has one.
ulog::Sample pose(const FrameRecord& r);
ulog::Sample mapper(const FrameRecord& r);
/// Of a record that knows it.
ulog::Sample load(const FrameRecord& r);
ulog::Sample imu(const hal::ImuSample& s);
ulog::Sample bus(const link::LinkStatus& s);
ulog::Sample machine(const hal::MachineState& state, rt::TimeNs t_ns);
/// The log's own figures; waiting: bytes not yet handed to the disc.
ulog::Sample log(std::uint64_t written_bytes, std::uint64_t dropped, std::uint32_t waiting, rt::TimeNs t_ns);

/// Of a frame that was tracked: by what it is flown again.
ulog::Sample order(const FrameRecord& r);
/// Of a detection how many boxes there are, and of each box.
ulog::Sample detection(const FoundBoxes& found);
ulog::Sample box(rt::TimeNs t_capture_ns, const detector::Box& b);
/// After everything else: the log is whole if the last frame's number is this.
ulog::Sample end(std::uint64_t frames, rt::TimeNs t_ns);

}  // namespace godwit::app::flight_topics
