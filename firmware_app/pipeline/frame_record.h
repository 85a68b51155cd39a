// What is known of one frame when it is done: what the pipeline hands to files, logs and links.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <limits>
#include <string_view>

#include "firmware_app/pipeline/flown_order.h"
#include "firmware_app/pipeline/load_record.h"
#include "hal/rt/time.h"
#include "vo_core/inertial/motion.h"
#include "vo_core/inertial/scale_state.h"
#include "vo_core/tracking/state.h"

namespace godwit::app {

/// What became of a picture that was due.
enum class FrameFate : std::uint8_t {
  kProcessed,     ///< went through the tracker
  kBadPicture,    ///< missing, unreadable, of the wrong size, or with a time that repeats or goes back
  kDroppedSlots,  ///< no frame slot was free
  kDroppedLate    ///< a newer picture had already come when the tracker got to it
};
constexpr const char* fate_name(FrameFate fate) {
  constexpr const char* kNames[] = {"processed", "bad", "dropped_slots", "dropped_late"};
  return kNames[static_cast<std::size_t>(fate)];
}

/// Stages whose time is kept, in the order of the columns.
constexpr std::array<const char*, 8> kStageNames = {"pyramid",   "apply", "initialise", "align",
                                                    "reproject", "pose",  "keyframe",   "map"};
constexpr std::size_t kStages = kStageNames.size();
constexpr std::size_t kMapStage = 7;

/// A fixed piece of text that may travel through rings.
struct ShortText {
  std::array<char, 200> text{};

  void assign(std::string_view s) {
    const std::size_t n = s.size() < text.size() - 1 ? s.size() : text.size() - 1;
    for (std::size_t i = 0; i < n; ++i) text[i] = s[i];
    text[n] = '\0';
  }
  /// "what: value of limit", as a measured reason is told; without a limit "what" alone. No allocation.
  void assign_measured(const char* what, int value, int limit) {
    std::snprintf(text.data(), text.size(), limit != 0 ? "%s: %d of %d" : "%s", what, value, limit);
  }
  std::string_view view() const { return text.data(); }
};

/// A reason in parts, as the odometry measured it: static text, its figure and the limit; 0: there is none.
struct Measured {
  const char* text = "";
  std::int32_t value = 0;
  std::int32_t limit = 0;
};

/// A figure as Measured holds it: rounded; what it cannot hold, and what is no number, is the largest of its sign.
inline std::int32_t measured_figure(double x) {
  constexpr double kMost = std::numeric_limits<std::int32_t>::max();
  return static_cast<std::int32_t>(std::isnan(x) ? kMost : std::round(std::clamp(x, -kMost, kMost)));
}

/// What the mapper did between two frames.
struct MappingRecord {
  std::uint32_t messages = 0;                         ///< frames and keyframes it worked on; 0: nothing came back
  std::int32_t seeds_updated = 0, points_new = 0;     ///< in all of them
  std::int32_t seeds = 0, keyframes = 0, points = 0;  ///< after the last one
  std::uint32_t adjustments = 0;                      ///< bundle adjustments; the rest tells of the last one
  std::int32_t free_keyframes = 0, fixed_keyframes = 0;
  std::int32_t adjusted_points = 0, observations = 0, iterations = 0, outliers = 0;
  double rms_before_px = 0, rms_after_px = 0;
};

/// What the inertial estimator knows of the sensor and of lengths; means something with a metric pose.
struct InertialRecord {
  double log_scale_sigma = 0;          ///< one sigma of the lengths told, as a share
  std::array<double, 3> gyro_bias{};   ///< [rad/s]
  std::array<double, 3> accel_bias{};  ///< [m/s^2]
  std::array<double, 3> mounting{};    ///< rotation vector right of the configured R_body_cam: what that has wrong
  double time_offset_s = 0;            ///< a picture stamped t was taken at t + this on the inertial sensor's clock
  double aided_log_sigma = 0;  ///< of the scale by what stands beside camera and that sensor; 0: it says nothing
  std::array<double, vo::kScaleSources> aid_share{};  ///< of that, by vo::ScaleSource; together 1, or 0
};

/// How the navigation frame lies on the earth, as satellites told while they lasted (vo_core/inertial/georeference.h).
struct EarthRecord {
  bool known = false;                 ///< heading, origin and their sigmas mean something
  bool held = false, broken = false;  ///< as vo::Georeference says
  /// All that came; of those what was compared and fitted, and what contradicted. The rest came before a heading
  /// showed, between pictures too far apart, or was no fix.
  std::uint32_t fixes = 0, fixes_used = 0, fixes_refused = 0;
  /// Of the frame's x axis, from east towards north [rad].
  double heading = 0, heading_sigma = 0;
  std::array<double, 3> origin_m{};  ///< of the frame in the receiver's local frame (east, north, up)
  double place_sigma_m = 0;          ///< an axis, of where the receiver's frame has the camera
};

/// One word for how sure north is.
constexpr const char* north_word(const EarthRecord& e) {
  if (!e.known) return "unknown";
  if (e.broken) return "broken";
  if (e.held) return "held";
  return "known";
}

/// Plain data. Poses: camera to world, T_world_cam; units of the map until scale is known.
struct FrameRecord {
  std::uint32_t sequence = 0;
  FrameFate fate = FrameFate::kProcessed;
  bool tracked = false;   ///< HealthOptions::min_measurements updated the pose
  bool has_pose = false;  ///< a pose was given out: tracked or coasted
  bool repeated = false;  ///< the picture is the one before, bit for bit: nothing was measured, the state stands
  bool is_keyframe = false;
  bool map_moved = false;  ///< a bundle adjustment moved the map before this frame
  /// By that the last frame's camera moved in the world, and turned (rotation vector along world axes).
  std::array<double, 3> moved_by{};
  std::array<double, 3> turned_by{};
  std::uint32_t map_id = 0;   ///< counts from 1; 0: no map
  std::int32_t features = 0;  ///< image measurements behind the pose
  rt::TimeNs t_source_ns = 0;
  rt::TimeNs t_capture_ns = 0;
  rt::TimeNs t_delivered_ns = 0;  ///< CLOCK_MONOTONIC when the camera handed the picture over
  rt::TimeNs t_done_ns = 0;       ///< CLOCK_MONOTONIC when the pose stood
  rt::TimeNs wall_ns = 0;         ///< the tracking call, pyramid included
  rt::TimeNs thread_cpu_ns = 0;   ///< processor time of the tracking call
  rt::TimeNs mapper_cpu_ns = 0;   ///< processor time of the mapping since the last frame
  rt::TimeNs view_ns = 0;         ///< in neither of the two: what a FrameView took that does not count
  rt::TimeNs view_cpu_ns = 0;     ///< and its processor time
  std::array<rt::TimeNs, kStages> stage_ns{};
  vo::State state = vo::State::kInitialising;  ///< processed frames
  std::array<double, 3> t_world_cam{};
  std::array<double, 4> q_world_cam{};  ///< x y z w
  /// Covariances: of the left twist (v, w) of the camera's pose, T_cam_true = exp(x) T_cam, that is along the camera's
  /// axes [map units, rad]; upper triangle by rows. Of the pose in its map, everything counted:
  std::array<double, 21> covariance{};
  std::array<double, 21> own_covariance{};  ///< of this frame's noise alone, the map taken for true
  /// The reference keyframe, the pose relative to it (camera to keyframe) and the covariance of that.
  std::uint32_t reference_id = 0;  ///< counts from 1 in each map; 0: there is none
  rt::TimeNs t_reference_ns = 0;   ///< its capture time
  std::array<double, 3> t_ref_cam{};
  std::array<double, 4> q_ref_cam{};  ///< x y z w
  std::array<double, 21> reference_covariance{};
  /// The pose, its covariance, moved_by and turned_by are in the navigation frame: metres, z up; and the camera's
  /// velocity is known. own_covariance, the pose relative to the reference keyframe with its covariance, and
  /// median_depth stay in map units: they are what vision saw, and whoever reads them needs no metres.
  bool metric = false;
  /// metric: another number is another navigation frame, whose places cannot be compared with those before.
  std::uint32_t frame_id = 0;
  double trust = 1;                             ///< metric: whether vision and inertial sensor agree over time, 0 to 1
  std::array<double, 3> velocity{};             ///< of the camera along the frame's axes [m/s]
  std::array<double, 6> velocity_covariance{};  ///< upper triangle by rows
  InertialRecord inertial;
  EarthRecord earth;                 ///< metric
  vo::Motion motion;                 ///< metric: of the body, for whoever goes on from it until the next picture
  double median_depth = 0;           ///< of the points behind the pose [map units]
  const char* keyframe_reason = "";  ///< static text: why the frame should become a keyframe
  MappingRecord mapping;             ///< what the mapper has done since the frame before
  FlownOrder order;                  ///< what it found when it was flown; processed frames
  LoadRecord load;                   ///< the same of the threads around it
  Measured why;                      ///< why the state is what it is; processed frames
  ShortText reason;                  ///< the same in words, or why the picture was not flown
};

}  // namespace godwit::app
