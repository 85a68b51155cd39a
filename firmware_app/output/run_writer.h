// What a replay leaves behind: trajectory.tum, frames.csv, pose.csv and summary.json.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "firmware_app/output/event_line.h"
#include "firmware_app/output/statistics.h"
#include "firmware_app/pipeline/pipeline.h"
#include "hal/atomic_file.h"

namespace godwit::app {

/// What summary.json says of the run besides the frames themselves.
struct RunDescription {
  std::string version;
  std::string sequence;
  std::string mode;  ///< "sequential" or "threads"
  std::string pace;  ///< "max" or "real"
  std::int64_t start = 0;
  std::string link;  ///< what the autopilot link says of itself, as a JSON object; empty: there was none
};

/// The figures of summary.json.
struct RunSummary {
  PipelineCounters counters;
  std::uint64_t tracked = 0;
  double tracked_share = 0;              ///< of all pictures that were due
  double tracked_share_after_first = 0;  ///< of those from the first pose on
  std::uint32_t maps = 0;
  std::int64_t first_pose_frames = -1;        ///< pictures before the first pose; -1: there was none
  double first_pose_ms = -1;                  ///< source time from the first picture to the first pose
  double pictures_hz = 0, poses_hz = 0;       ///< due, and tracked, a second of the source's time; 0: too few
  Statistics ms, thread_cpu_ms, proc_cpu_ms;  ///< over tracked frames
  Statistics age_ms;                          ///< real pace: from capture to pose, over tracked frames
  /// Of the last tracked frame; share: of what rangefinder, barometer and satellites and starting height say of lengths
  /// (vo::ScaleSource).
  double aided_log_sigma = 0;
  std::array<double, vo::kScaleSources> aid_share{};
  EarthRecord earth;  ///< of the last tracked frame in metres
};

/// Writes line by line while the run goes on; the files get their names in finish(), summary.json last, so a folder
/// with a summary.json is whole. One thread.
///
/// - trajectory.tum: `t tx ty tz qx qy qz qw map_id`, camera to world, a line for each tracked frame.
/// - frames.csv: a line for each picture that was due, also bad and dropped ones.
/// - pose.csv: a line for each pose given out, coasted ones included, with the upper triangle of its covariance.
/// t is the source's time in seconds with 9 decimals; other numbers are written so that they read back to the same
/// bits.
class RunWriter final : public FrameSink {
 public:
  /// Creates the folder and the files, and removes what an earlier run left under the same names. with_age: capture
  /// times are moments of this machine's clock (real pace), so the age of a pose can be told. Error: file, reason.
  rt::Result<void> open(const std::string& folder, bool with_age);
  rt::Result<void> take(const FrameRecord& record) override;
  /// Kept for the summary, the first thousand; their times count from the first picture's capture.
  void event(const rt::LogEntry& entry) override;
  /// What the pipeline counted, for the summary; before finish().
  void set_pipeline(const PipelineCounters& counters) { pipeline_ = counters; }
  const PipelineCounters& pipeline() const { return pipeline_; }
  rt::Result<void> finish(const RunDescription& description);

  /// Valid at any time; complete after the last take().
  RunSummary summary() const;
  /// First few reasons why pictures were not flown, each once, for the user's eyes.
  const std::vector<std::string>& bad_reasons() const { return bad_reasons_; }

 private:
  static constexpr std::size_t kReasonsKept = 5;
  static constexpr std::size_t kEventsKept = 1000;

  hal::AtomicFile trajectory_, frames_, poses_, summary_;
  std::string line_;
  bool with_age_ = false;
  vo::State state_ = vo::State::kInitialising;  ///< of the last processed frame: what holds while pictures are missing
  InertialRecord inertial_;                     ///< of the last tracked frame
  EarthRecord earth_;                           ///< of the last tracked frame in metres
  PipelineCounters counters_;
  PipelineCounters pipeline_;  ///< as set_pipeline() was told
  std::uint64_t tracked_ = 0;
  std::uint32_t maps_ = 0;
  std::int64_t first_pose_frames_ = -1;
  rt::TimeNs first_t_ns_ = -1, last_t_ns_ = -1, first_pose_t_ns_ = -1;
  std::vector<double> ms_, thread_cpu_ms_, proc_cpu_ms_, age_ms_;
  std::vector<rt::LogEntry> events_;
  EventClock clock_;
  std::uint64_t events_seen_ = 0;
  std::vector<std::string> bad_reasons_;
};

}  // namespace godwit::app
