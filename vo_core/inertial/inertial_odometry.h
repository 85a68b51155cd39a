// Metres and the vertical for a visual map: beside the tracker, from its poses and an inertial sensor's readings.
// Loosely coupled: vision's poses are taken as they are, the smoother finds what they are in metres and against
// gravity.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>

#include "vo_core/geometry/rolling_shutter.h"
#include "vo_core/inertial/inertial_alignment.h"
#include "vo_core/inertial/inertial_smoother.h"
#include "vo_core/inertial/metric_map.h"
#include "vo_core/inertial/rest_vertical.h"
#include "vo_core/inertial/scale_aids.h"

namespace godwit::vo {

struct InertialOdometryOptions {
  InertialModel model;
  ScaleAidsOptions aids;
  Vec3 range_beam = Vec3::UnitZ();  ///< of the rangefinder, along the body's axes, unit length
  double aid_limit = 4;             ///< what others say of the scale is left out where it is so many sigmas off
  InertialPrior prior;
  AlignmentMethod method = AlignmentMethod::kWhole;
  rt::TimeNs begin_node_ns = 45 * rt::kNsPerMs;   ///< shortest time between two moments until it is metric
  rt::TimeNs node_ns = 95 * rt::kNsPerMs;         ///< and from then on
  rt::TimeNs begin_span_ns = 400 * rt::kNsPerMs;  ///< no attempt with less
  int window = 12;                                ///< moments kept from then on
  /// What refuses to guess: the scale's sigma, the vertical's, and how badly all fits. At rest the scale's comes out
  /// above 0.1: places that only seem to move carry about one unit of information each.
  double begin_scale_sigma = 0.08;
  double begin_up_sigma = 0.03;  ///< [rad]
  double begin_chi2 = 3;         ///< a degree of freedom
  /// Whether to begin is asked with an accelerometer's bias that may be so many times what its prior says, and whether
  /// one is absurd, too. What is told has the prior as it is: a margin in it is no error of anything.
  double begin_bias_margin = 1;
  /// So long nobody trusts it again: the scale's sigma above which it is no longer metric.
  double lost_scale_sigma = 0.15;
  double most_sigmas = 6;  ///< the same for biases and mounting, in sigmas of what they were taken to be at first
  /// Where readings do not reach a picture's moment by more than this, since it was stamped early, the picture before
  /// it is taken instead.
  rt::TimeNs unmeasured_ns = 10 * rt::kNsPerMs;
  /// Rolling shutter, first row to last, around the picture's time; 0: global. What shakes within it is in the
  /// picture's rows: vision's attitude is its mean over them, and what one picture is off by its neighbours are not.
  rt::TimeNs readout_ns = 0;
  rt::TimeNs max_missing_ns = 100 * rt::kNsPerMs;  ///< without readings between two moments the window begins anew
  VisionStrayOptions stray;
  /// What shakes a rolling shutter is in each picture alone.
  VisionStrayOptions stray_as_seen() const {
    VisionStrayOptions out = stray;
    out.pictures_err_alone |= readout_ns > 0;
    return out;
  }
  double least_course_sigma = 1e-3, most_course_sigma = 0.1;  ///< where a map begins [rad]
  /// What is told is less certain than the window holds it for, by what its model leaves out; none of it decides
  /// anything here. Measured on euroc_mh01 (docs/inertial-design.md), one sigma each:
  double told_place_sigma_m = 4e-3;    ///< an axis
  double told_turn_sigma_rad = 2e-4;   ///< an axis
  double told_scale_sigma = 1e-2;      ///< of lengths: the accelerometer's scale, and what vision's drifts
  double told_speed_sigma_m_s = 6e-3;  ///< an axis
};

/// One thread; no allocation after the constructor. Frames and readings in the order of their times.
class InertialOdometry : public MetricMap {
 public:
  explicit InertialOdometry(const CameraMounting& mounting, const InertialOdometryOptions& options = {});

  void add(const ImuReading& reading);
  /// What knows metres beside the camera. False: no number, out of order, or no room; it is passed over.
  bool take(const AidReading& reading) { return aids_.take(reading); }
  /// The turn of the camera between two times by the gyroscope, R_cur_ref, or false where it was not measured
  /// whole, a gyroscope at the end of its range among that.
  bool camera_turn(rt::TimeNs t_ref_ns, rt::TimeNs t_cur_ns, Mat3* R_cur_ref) const;
  /// How the camera turned while the rows of a rolling shutter's picture were read, as ImuBuffer::row_turns() has it,
  /// but of T_cam_world and along the camera's axes. Times as the calibration has them: no estimate goes in, so that
  /// nothing is learned of its own. False where it was not measured.
  bool row_turns(rt::TimeNs t_before_ns, rt::TimeNs t_ns, RowTurns* turns, RowTurns* rates) const;
  /// Takes in one frame and says what it is in metres. Bounded: one solution of the window at most.
  MetricPose frame(const VisualPose& pose);

  /// A pose in the frame that MetricPose has, in the map's own; map_id: of that map. False while it is not metric.
  bool in_map(const SE3& T_nav_cam, SE3* T_map_cam, std::uint32_t* map_id) const;

  const InertialSmoother& smoother() const { return smoother_; }
  const ScaleState& aided_scale() const { return aids_.state(); }
  /// What they say of the scale against what the window knows without them: squared, in sigmas, one degree of freedom.
  /// Below 0: nothing was compared with the last picture.
  double aids_off2() const { return aids_off2_; }
  /// Pictures with which others contradicted the scale that is held for true.
  std::uint64_t aids_contradicted() const { return aids_contradicted_; }
  std::uint64_t refused_readings() const { return buffer_.refused(); }
  /// With the last frame vision and sensor contradicted each other so far that what the window had was given up. Which
  /// of them is wrong nobody knows: neither may be gone on from.
  bool contradicted() const { return contradicted_; }

 private:
  /// What was measured since the newest moment, up to a time; returns how much of it nobody measured.
  rt::TimeNs measured_since(rt::TimeNs t_ns, Preintegration* since) const;
  void hear_aids(const VisualPose& pose);
  /// What they say of the scale now, as far as it may be believed.
  ScaleHint hint();
  /// Who fell silent contradicts nobody any more, though what he said is still known.
  void look_who_speaks(rt::TimeNs t_ns) {
    std::uint64_t used = 0;
    for (std::size_t i = 0; i < kScaleSources; ++i)
      used += aids_.state().count(static_cast<ScaleSource>(i), ScaleVerdict::kUsed);
    if (used != aids_used_) t_aids_used_ns_ = t_ns;
    aids_used_ = used;
    aids_speak_ = used > 0 && t_ns - t_aids_used_ns_ < 2 * rt::kNsPerSecond;
    aids_off2_ = -1;
  }
  void count_on(const ScaleHint& others) {
    counted_ = others;
    smoother_.hint_scale(others.log_scale, others.sigma);
  }
  /// How many times larger than the window's own its variances are told: what contradicts itself is no surer together
  /// than each of the two alone (Birge's ratio). The two are others' word and the window's own opinion of the scale,
  /// and how the camera is screwed on and how the window would have it.
  double doubt2() const {
    const double turned = (smoother_.newest().mounting - prior_.mounting).norm() / prior_.mounting_sigma;
    return std::max(dispute2_, turned * turned / 3);
  }
  void begin_window(const VisualPose& pose);
  /// How far the course may be off in a map that begins so [rad, an axis].
  double course_sigma(std::span<const InertialNode> window) const;
  /// The vertical of its first moment is known from a rest before it.
  bool stood() const { return first_vertical_.known && first_vertical_.sigma < options_.begin_up_sigma; }
  /// And how fast one has become since, well enough to tell the scale by: after a minute of shaking on the ground it is
  /// not.
  bool gone_since_rest() const {
    const double sigma = first_vertical_.whole_velocity_sigma();
    return stood() && sigma > 0 && sigma < options_.begin_scale_sigma * first_vertical_.velocity.norm();
  }
  bool add_node(const VisualPose& pose, rt::TimeNs after_ns);
  /// Whether the map became metric with it.
  bool try_to_begin(const VisualPose& pose);
  /// What a window whose first moment knows its velocity from a rest before begins with: in a steady climb the closed
  /// form sees no scale.
  Alignment align_by_rest(std::span<const InertialNode> window, const ImuBias& bias) const;
  /// Begins with what is known of the sensor, its accelerometer's bias as well as this.
  void set_prior(double accel_bias_sigma, double course_sigma);
  /// Biases and mounting are no further from what they were taken to be at first.
  bool plausible(double most_sigmas);
  bool convincing(const InertialSmoother::Report& report);
  /// What vision strayed by from the moment before to the newest one, as the window counts with it.
  void stray_on();
  /// Vectors along the map's axes, from how the window has the newest moment turned in them to how vision has it.
  Mat3 R_seen_map() const;
  /// The vertical at the newest moment along the map's axes as vision has the camera turned in them.
  Vec3 up_seen() const { return R_seen_map() * smoother_.newest().up; }
  /// How the logarithm of the scale and that vertical, about the frame's x and y, answer to the newest moment's error.
  Eigen::Matrix<double, 3, InertialState::kSize> shared_by_window() const;
  MetricPose tell(const VisualPose& pose);
  void tell_velocity(const VisualPose& pose, MetricPose* out) const;
  VisionSight sight_of(const VisualPose& pose, rt::TimeNs t_ns) const;
  /// Readings do not reach that picture's moment, but that of the picture before, in the same map. Not where the sensor
  /// is silent: then neither is measured. Where a shutter rolls they have to reach the last row, as what shakes does
  /// not go on as it was.
  bool too_early(const VisualPose& pose) const {
    const bool rolls = options_.readout_ns > 0;
    const rt::TimeNs reach_ns = buffer_.newest_ns() + (rolls ? -options_.readout_ns / 2 : options_.unmeasured_ns);
    const bool before_is_measured = rolls ? moment_of(before_) <= reach_ns : pose.t_ns <= reach_ns;
    return moment_of(pose) > reach_ns && before_is_measured && before_.map_id == pose.map_id;
  }
  /// When that picture was taken on the sensor's clock, and the same as far as readings reach.
  rt::TimeNs moment_of(const VisualPose& pose) const;
  rt::TimeNs measured_moment_of(const VisualPose& pose) const {
    return std::min(moment_of(pose), std::max(buffer_.newest_ns(), pose.t_ns));
  }

  const InertialOdometryOptions options_;
  InertialPrior prior_;
  double begin_accel_sigma_;  ///< of prior_'s accelerometer bias where it is asked whether to begin [m/s^2]
  ImuBuffer buffer_;
  RestVertical rest_;
  KnownVertical first_vertical_;  ///< from a rest before, at the window's first moment until it is metric
  InertialSmoother smoother_;
  ScaleAids aids_;
  std::uint64_t aids_contradicted_ = 0;
  double aids_off2_ = -1;
  std::uint64_t aids_used_ = 0;  ///< readings of all of them
  rt::TimeNs t_aids_used_ns_ = 0;
  bool aids_speak_ = false;
  ScaleHint counted_;  ///< what the window's last solution took from them
  /// And by how much that stands apart from what the window knows without it: squared, in sigmas; 1 where it is less,
  /// or nothing was taken. As long as the word counts, long after who gave it fell silent.
  double dispute2_ = 1;
  double strayed2_ = 0;  ///< what vision's places strayed by since the map became metric [map units^2, an axis]
  // The vertical of the last attempt to begin, if that was sure of it; else zero.
  Vec3 attempt_up_ = Vec3::Zero();
  double attempt_up_sigma_ = 0;
  // What the buffer forgets while no picture gives a pose: measured from the newest moment to t_bridge_ns_ (0:
  // nothing).
  Preintegration bridge_;
  rt::TimeNs t_bridge_ns_ = 0, bridge_missing_ns_ = 0;
  bool contradicted_ = false;
  bool prior_kept_ = true;  ///< what the window says of the sensor is taken over by the next one
  std::uint32_t map_id_ = 0;
  VisualPose before_;                     ///< the last picture's, corrections of the map taken in; without points
  Vec3 last_seen_camera_ = Vec3::Zero();  ///< of the last picture with a pose
  rt::TimeNs t_last_seen_ns_ = 0;
};

}  // namespace godwit::vo
