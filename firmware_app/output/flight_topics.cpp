#include "firmware_app/output/flight_topics.h"

#include <array>
#include <span>

namespace godwit::app::flight_topics {
namespace {
using ulog::Field;

constexpr std::array<Field, 17> kPoseFields = {{{"uint64_t", "timestamp"},
                                                {"uint64_t", "t_done"},
                                                {"double[3]", "position"},
                                                {"double[4]", "q_xyzw"},
                                                {"double[21]", "covariance"},
                                                {"double[3]", "velocity"},
                                                {"double[6]", "velocity_covariance"},
                                                {"double[3]", "reference_position"},
                                                {"double[4]", "reference_q_xyzw"},
                                                {"double[21]", "reference_covariance"},
                                                {"double", "median_depth"},
                                                {"uint64_t", "t_reference"},
                                                {"uint32_t", "reference_id"},
                                                {"uint32_t", "sequence"},
                                                {"uint32_t", "map_id"},
                                                {"uint8_t", "tracked"},
                                                {"uint8_t", "metric"}}};
constexpr std::array<Field, 22> kFrameFields = {
    {{"uint64_t", "timestamp"},  {"uint64_t", "t_delivered"}, {"uint64_t", "t_done"}, {"uint32_t", "sequence"},
     {"uint32_t", "map_id"},     {"int32_t", "features"},     {"float", "wall_ms"},   {"float", "thread_cpu_ms"},
     {"float", "mapper_cpu_ms"}, {"float", "pyramid_ms"},     {"float", "apply_ms"},  {"float", "initialise_ms"},
     {"float", "align_ms"},      {"float", "reproject_ms"},   {"float", "pose_ms"},   {"float", "keyframe_ms"},
     {"float", "map_ms"},        {"uint8_t", "fate"},         {"uint8_t", "tracked"}, {"uint8_t", "is_keyframe"},
     {"uint8_t", "map_moved"},   {"uint8_t", "state"}}};
static_assert(kStages == 8, "frame lists the stages by name");
constexpr std::array<Field, 16> kMapperFields = {{{"uint64_t", "timestamp"},
                                                  {"float", "rms_before_px"},
                                                  {"float", "rms_after_px"},
                                                  {"uint32_t", "messages"},
                                                  {"uint32_t", "adjustments"},
                                                  {"int32_t", "seeds"},
                                                  {"int32_t", "seeds_updated"},
                                                  {"int32_t", "points"},
                                                  {"int32_t", "points_new"},
                                                  {"int32_t", "keyframes"},
                                                  {"int32_t", "free_keyframes"},
                                                  {"int32_t", "fixed_keyframes"},
                                                  {"int32_t", "adjusted_points"},
                                                  {"int32_t", "observations"},
                                                  {"int32_t", "iterations"},
                                                  {"int32_t", "outliers"}}};
constexpr std::array<Field, 3> kMachineFields = {
    {{"uint64_t", "timestamp"}, {"float", "temperature_c"}, {"uint8_t", "throttled"}}};
constexpr std::array<Field, 4> kLogFields = {
    {{"uint64_t", "timestamp"}, {"uint64_t", "written_bytes"}, {"uint64_t", "dropped"}, {"uint32_t", "waiting_bytes"}}};
// What must come back exact is in nanoseconds.
constexpr std::array<Field, 13> kOrderFields = {{{"uint64_t", "timestamp"},
                                                 {"int64_t", "t_capture_ns"},
                                                 {"int64_t", "t_source_ns"},
                                                 {"int64_t", "t_detection_ns"},
                                                 {"int64_t", "t_reading_ns"},
                                                 {"uint64_t", "number"},
                                                 {"uint64_t", "readings"},
                                                 {"double", "feature_share"},
                                                 {"uint32_t", "sequence"},
                                                 {"int32_t", "room"},
                                                 {"int32_t", "deltas"},
                                                 {"uint8_t", "has_pose"},
                                                 {"uint8_t", "tracked"}}};
constexpr std::array<Field, 3> kDetectionFields = {
    {{"uint64_t", "timestamp"}, {"int64_t", "t_capture_ns"}, {"int32_t", "boxes"}}};
constexpr std::array<Field, 5> kBoxFields = {{{"uint64_t", "timestamp"},
                                              {"int64_t", "t_capture_ns"},
                                              {"float[4]", "x0_y0_x1_y1"},
                                              {"float", "score"},
                                              {"int32_t", "class_id"}}};
constexpr std::array<Field, 2> kEndFields = {{{"uint64_t", "timestamp"}, {"uint64_t", "frames"}}};
constexpr std::array<Field, 17> kLoadFields = {{{"uint64_t", "timestamp"},
                                                {"uint64_t", "slips"},
                                                {"uint64_t", "detections"},
                                                {"uint64_t", "detections_failed"},
                                                {"uint64_t", "detections_late"},
                                                {"uint64_t", "detector_stuck"},
                                                {"uint64_t", "keyframes_undetected"},
                                                {"uint64_t", "records_lost"},
                                                {"uint64_t", "events_lost"},
                                                {"float", "mask_age_ms"},
                                                {"int32_t", "frames_waiting"},
                                                {"int32_t", "readings_waiting"},
                                                {"int32_t", "mapper_backlog"},
                                                {"int32_t", "records_waiting"},
                                                {"int32_t", "slots_free"},
                                                {"int32_t", "slots_fewest"},
                                                {"uint8_t", "rung"}}};
constexpr std::array<Field, 4> kImuFields = {
    {{"uint64_t", "timestamp"}, {"float[3]", "gyro_rad_s"}, {"float[3]", "accel_m_s2"}, {"uint8_t", "flags"}}};
constexpr std::array<Field, 33> kBusFields = {{{"uint64_t", "timestamp"},
                                               {"uint64_t", "odometry_sent"},
                                               {"uint64_t", "poses_stale"},
                                               {"uint64_t", "poses_paced"},
                                               {"uint64_t", "pictures_repeated"},
                                               {"uint64_t", "tx_frames"},
                                               {"uint64_t", "tx_messages"},
                                               {"uint64_t", "poses_replaced"},
                                               {"uint64_t", "tx_refused"},
                                               {"uint64_t", "tx_abandoned"},
                                               {"uint64_t", "sent"},
                                               {"uint64_t", "received"},
                                               {"uint64_t", "send_full"},
                                               {"uint64_t", "send_failed"},
                                               {"uint64_t", "receive_failed"},
                                               {"uint64_t", "receive_malformed"},
                                               {"uint64_t", "receive_overflow"},
                                               {"uint64_t", "error_frames"},
                                               {"uint64_t", "bus_off"},
                                               {"uint64_t", "reopened"},
                                               {"float", "load_percent"},
                                               {"float", "latency_p50_ms"},
                                               {"float", "latency_p99_ms"},
                                               {"float", "own_p50_ms"},
                                               {"float", "own_p99_ms"},
                                               {"float", "round_trip_ms"},
                                               {"int8_t", "quality"},
                                               {"uint8_t", "reset_counter"},
                                               {"uint8_t", "bus_state"},
                                               {"uint8_t", "armed"},
                                               {"uint8_t", "autopilot_alive"},
                                               {"uint8_t", "synchronised"},
                                               {"uint8_t", "own_id_heard"}}};

struct TopicFields {
  const char* name;
  std::span<const Field> fields;
};
/// By Topic.
constexpr std::array<TopicFields, kTopics> kTopicFields = {{{"pose", kPoseFields},
                                                            {"frame", kFrameFields},
                                                            {"mapper", kMapperFields},
                                                            {"machine", kMachineFields},
                                                            {"log", kLogFields},
                                                            {"order", kOrderFields},
                                                            {"detection", kDetectionFields},
                                                            {"box", kBoxFields},
                                                            {"end", kEndFields},
                                                            {"load", kLoadFields},
                                                            {"imu", kImuFields},
                                                            {"bus", kBusFields}}};

std::uint64_t us(rt::TimeNs t_ns) {
  return static_cast<std::uint64_t>(t_ns / 1000);
}

float ms(rt::TimeNs t_ns) {
  return static_cast<float>(rt::to_ms(t_ns));
}
}  // namespace

std::string definitions(const std::vector<std::pair<std::string, std::string>>& info,
                        const std::vector<std::pair<std::string, double>>& parameters, rt::TimeNs t_ns) {
  std::string out;
  ulog::append_header(t_ns, &out);
  ulog::append_flags(&out);
  ulog::append_info("sys_name", "godwit", &out);
  for (const auto& [key, value] : info) ulog::append_info(key, value, &out);
  for (const auto& [key, value] : parameters) ulog::append_parameter(key, static_cast<float>(value), &out);
  for (const auto& [name, fields] : kTopicFields) ulog::append_format(name, fields, &out);
  for (std::uint16_t id = 0; id < kTopics; ++id) ulog::append_subscription(id, kTopicFields[id].name, &out);
  return out;
}

ulog::Sample frame(const FrameRecord& r) {
  ulog::Sample out(r.t_capture_ns);
  out.put(us(r.t_delivered_ns)).put(us(r.t_done_ns)).put(r.sequence).put(r.map_id).put(r.features);
  out.put(ms(r.wall_ns)).put(ms(r.thread_cpu_ns)).put(ms(r.mapper_cpu_ns));
  for (const rt::TimeNs stage : r.stage_ns) out.put(ms(stage));
  out.put(static_cast<std::uint8_t>(r.fate));
  for (const bool flag : {r.tracked, r.is_keyframe, r.map_moved}) out.put(static_cast<std::uint8_t>(flag));
  out.put(static_cast<std::uint8_t>(r.state));
  return out;
}

ulog::Sample pose(const FrameRecord& r) {
  ulog::Sample out(r.t_capture_ns);
  out.put(us(r.t_done_ns)).put_all<double>(r.t_world_cam).put_all<double>(r.q_world_cam);
  out.put_all<double>(r.covariance).put_all<double>(r.velocity).put_all<double>(r.velocity_covariance);
  out.put_all<double>(r.t_ref_cam).put_all<double>(r.q_ref_cam).put_all<double>(r.reference_covariance);
  out.put(r.median_depth).put(us(r.t_reference_ns)).put(r.reference_id).put(r.sequence).put(r.map_id);
  for (const bool flag : {r.tracked, r.metric}) out.put(static_cast<std::uint8_t>(flag));
  return out;
}

ulog::Sample mapper(const FrameRecord& r) {
  const MappingRecord& m = r.mapping;
  ulog::Sample out(r.t_capture_ns);
  out.put(static_cast<float>(m.rms_before_px)).put(static_cast<float>(m.rms_after_px));
  out.put(m.messages).put(m.adjustments);
  for (const std::int32_t n : {m.seeds, m.seeds_updated, m.points, m.points_new, m.keyframes, m.free_keyframes,
                               m.fixed_keyframes, m.adjusted_points, m.observations, m.iterations, m.outliers}) {
    out.put(n);
  }
  return out;
}

ulog::Sample load(const FrameRecord& r) {
  const LoadRecord& l = r.load;
  ulog::Sample out(r.t_capture_ns);
  out.put(l.slips).put(l.detections).put(l.detections_failed).put(l.detections_late).put(l.detector_stuck);
  out.put(l.keyframes_undetected).put(l.records_lost).put(l.events_lost);
  out.put(l.mask_age_ns < 0 ? -1.0F : ms(l.mask_age_ns));
  for (const std::int32_t n :
       {l.frames_waiting, l.readings_waiting, l.mapper_backlog, l.records_waiting, l.slots_free, l.slots_fewest}) {
    out.put(n);
  }
  out.put(static_cast<std::uint8_t>(l.rung));
  return out;
}

ulog::Sample imu(const hal::ImuSample& s) {
  return ulog::Sample(s.t_ns).put_all<float>(s.gyro_rad_s).put_all<float>(s.accel_m_s2).put(s.flags);
}

ulog::Sample bus(const link::LinkStatus& s) {
  ulog::Sample out(s.t_ns);
  out.put(s.odometry_sent).put(s.poses_stale).put(s.poses_paced).put(s.pictures_repeated);
  out.put(s.tx.frames).put(s.tx.messages).put(s.tx.poses_replaced).put(s.tx.refused).put(s.tx.abandoned);
  const hal::CanCounters& b = s.bus;
  for (const std::uint64_t n : {b.sent, b.received, b.send_full, b.send_failed, b.receive_failed, b.receive_malformed,
                                b.receive_overflow, b.error_frames, b.bus_off, b.reopened}) {
    out.put(n);
  }
  for (const double x :
       {s.bus_load_percent, s.latency.p50_ms, s.latency.p99_ms, s.own_p50_ms, s.own_p99_ms, s.round_trip_ms}) {
    out.put(static_cast<float>(x));
  }
  out.put(s.quality).put(s.reset_counter).put(static_cast<std::uint8_t>(s.bus_state));
  for (const bool flag : {s.armed, s.autopilot_alive, s.synchronised, s.own_id_heard})
    out.put(static_cast<std::uint8_t>(flag));
  return out;
}

ulog::Sample machine(const hal::MachineState& state, rt::TimeNs t_ns) {
  return ulog::Sample(t_ns)
      .put(static_cast<float>(state.temperature_c))
      .put(static_cast<std::uint8_t>(state.throttled));
}

ulog::Sample log(std::uint64_t written_bytes, std::uint64_t dropped, std::uint32_t waiting, rt::TimeNs t_ns) {
  return ulog::Sample(t_ns).put(written_bytes).put(dropped).put(waiting);
}

ulog::Sample order(const FrameRecord& r) {
  const FlownOrder& o = r.order;
  ulog::Sample out(r.t_capture_ns);
  for (const rt::TimeNs t : {r.t_capture_ns, r.t_source_ns, o.t_detection_ns, o.t_reading_ns}) out.put(t);
  out.put(o.number).put(o.readings).put(o.feature_share).put(r.sequence).put(o.room).put(o.deltas);
  for (const bool flag : {r.has_pose, r.tracked}) out.put(static_cast<std::uint8_t>(flag));
  return out;
}

ulog::Sample detection(const FoundBoxes& found) {
  return ulog::Sample(found.t_capture_ns).put(found.t_capture_ns).put(static_cast<std::int32_t>(found.boxes.count));
}

ulog::Sample box(rt::TimeNs t_capture_ns, const detector::Box& b) {
  ulog::Sample out(t_capture_ns);
  out.put(t_capture_ns).put_all<float>(std::array{b.x0, b.y0, b.x1, b.y1});
  out.put(b.score).put(static_cast<std::int32_t>(b.class_id));
  return out;
}

ulog::Sample end(std::uint64_t frames, rt::TimeNs t_ns) {
  return ulog::Sample(t_ns).put(frames);
}

}  // namespace godwit::app::flight_topics
