// Metres and the vertical for a visual map: beside the tracker, from its poses and an inertial sensor's readings.
// Loosely coupled: vision's poses are taken as they are, the smoother finds what they are in metres and against
// gravity.
#pragma once

#include <cstdint>
#include <memory>

#include "vo_core/inertial_alignment.h"
#include "vo_core/inertial_smoother.h"

namespace godwit::vo {

/// What the tracker said of one frame, as much of it as counts here.
struct VisualPose {
  rt::TimeNs t_ns = 0;
  bool tracked = false;
  std::uint32_t map_id = 0;
  SE3 T_map_cam;
  Mat6 covariance = Mat6::Zero();      ///< of the left twist (v, w) of T_cam_map, map units and rad
  Mat6 own_covariance = Mat6::Zero();  ///< the same from the picture's own noise alone, the map taken for true
  double median_depth = 1;             ///< [map units]
  bool map_moved = false;              ///< the map was corrected before this frame; by it the last frame's camera
  Vec3 moved_by = Vec3::Zero();        ///< moved [map units]
  Vec3 turned_by = Vec3::Zero();       ///< and turned, rotation vector along the map's axes
};

struct InertialOdometryOptions {
  InertialModel model;
  InertialPrior prior;
  AlignmentMethod method = AlignmentMethod::kWhole;
  rt::TimeNs begin_node_ns = 45 * rt::kNsPerMs;   ///< shortest time between two moments until it is metric
  rt::TimeNs node_ns = 95 * rt::kNsPerMs;         ///< and from then on
  rt::TimeNs begin_span_ns = 400 * rt::kNsPerMs;  ///< no attempt with less
  int window = 12;                                ///< moments kept from then on
  /// What refuses to guess: the scale's sigma, the vertical's, and how badly all fits. At rest the scale's comes out
  /// above 0.1: places that only seem to move carry about one unit of information each.
  double begin_scale_sigma = 0.08;
  double begin_up_sigma = 0.05;  ///< [rad]
  double begin_chi2 = 3;         ///< a degree of freedom
  /// So long nobody trusts it again: the scale's sigma above which it is no longer metric.
  double lost_scale_sigma = 0.15;
  /// How long it goes on without vision: until the place's sigma has grown by so much, which is what the sensor's grade
  /// allows, and at most so long, which is what is remembered of its readings.
  double coast_sigma_m = 0.1;
  rt::TimeNs coast_ns = 1500 * rt::kNsPerMs;
  rt::TimeNs max_missing_ns = 100 * rt::kNsPerMs;  ///< without readings between two moments the window begins anew
};

/// Position and attitude of the camera in the navigation frame: metres, z up; origin and heading where it began.
struct MetricPose {
  bool valid = false;    ///< the rest means something
  bool coasted = false;  ///< no picture is behind it: from the inertial sensor alone
  SE3 T_nav_cam;
  Vec3 velocity_m_s = Vec3::Zero();  ///< of the camera, along the navigation frame's axes
  Mat6 covariance = Mat6::Zero();    ///< of (position [m], rotation vector [rad]), along the navigation frame's axes
  Mat3 velocity_covariance = Mat3::Zero();
  double log_scale_sigma = 0;
  /// By how much better knowledge of scale, vertical and map moved the last frame's pose [m], and turned it.
  Vec3 moved_by_m = Vec3::Zero(), turned_by_rad = Vec3::Zero();
};

/// One thread; no allocation after the constructor. Frames and readings in the order of their times.
class InertialOdometry {
 public:
  explicit InertialOdometry(const CameraMounting& mounting, const InertialOdometryOptions& options = {});

  void add(const ImuReading& reading) { buffer_.add(reading); }
  /// The turn of the camera between two times by the gyroscope, R_cur_ref, or false where it was not measured whole.
  bool camera_turn(rt::TimeNs t_ref_ns, rt::TimeNs t_cur_ns, Mat3* R_cur_ref) const;
  /// Takes in one frame and says what it is in metres. Bounded: one solution of the window at most.
  MetricPose frame(const VisualPose& pose);

  bool metric() const { return metric_; }
  std::uint32_t map_id() const { return map_id_; }  ///< the map that it is metric in
  /// Attempts to begin, and why the last one was refused.
  struct Refusal {
    const char* text = "";
    double value = 0, limit = 0;
  };
  const Refusal& refusal() const { return refusal_; }
  const InertialSmoother& smoother() const { return smoother_; }
  std::uint64_t refused_readings() const { return buffer_.refused(); }

 private:
  void begin_window(const VisualPose& pose);
  bool add_node(const VisualPose& pose, rt::TimeNs after_ns);
  void try_to_begin(const VisualPose& pose);
  bool refuse(const char* text, double value, double limit);
  bool convincing(const InertialSmoother::Report& report);
  void level();
  MetricPose tell(const VisualPose& pose);
  MetricPose coast(rt::TimeNs t_ns);
  Vec3 way_to(const Vec3& camera_map) const;
  double scene_replaced(const Vec3& camera, double depth);
  VisionSight sight_of(const VisualPose& pose) const;

  const InertialOdometryOptions options_;
  InertialPrior prior_;
  ImuBuffer buffer_;
  InertialSmoother smoother_;
  bool metric_ = false;
  std::uint32_t map_id_ = 0;
  Refusal refusal_;
  // From the map to the navigation frame: p_nav = anchor_nav + R_nav_map way, the way counted from the anchor, in
  // metres along the map's axes (InertialState::place).
  Mat3 R_nav_map_ = Mat3::Identity();
  Vec3 anchor_nav_ = Vec3::Zero();
  SE3 last_map_;  ///< the last pose told, as vision has it, corrections of the map taken in
  SE3 last_nav_;  ///< the last pose told: where a new map is joined on
  bool have_nav_ = false;
  bool told_ = false;            ///< last_map_ is of the present window
  rt::TimeNs t_told_ns_ = 0;     ///< of the last pose with a picture behind it
  double last_variance_m2_ = 0;  ///< of its place
  Vec3 scene_ = Vec3::Zero();    ///< trails the camera by a depth: the scene in view was seen from there, too [map]
};

}  // namespace godwit::vo
