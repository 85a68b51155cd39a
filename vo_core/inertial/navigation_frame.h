// One frame for a whole flight, whatever becomes of the maps: z up, metres, origin and heading where it began. What is
// metric in a map is hung into it; between maps the inertial sensor goes on.
#pragma once

#include <cstdint>

#include "vo_core/inertial/carried_motion.h"
#include "vo_core/inertial/map_correction.h"
#include "vo_core/inertial/self_check.h"

namespace godwit::vo {

/// What is known of one picture in the present map made metric: a frame with z up whose origin and heading are its own.
struct MetricMoment {
  std::uint32_t child_id = 0;  ///< moments of one number stand in one such frame
  SE3 T_child_cam;
  Vec3 velocity_m_s = Vec3::Zero();  ///< of the camera along the frame's axes
  Mat6 covariance = Mat6::Zero();    ///< of (place [m], rotation vector [rad]) along the frame's axes
  Mat3 velocity_covariance = Mat3::Zero();
  Vec3 moved_by_m = Vec3::Zero(), turned_by_rad = Vec3::Zero();  ///< by what was found out since the last moment
  /// What a correction of the map has of that: vision strayed by it in the last kStrayedNs before.
  Vec3 map_moved_by_m = Vec3::Zero(), map_turned_by_rad = Vec3::Zero();
  ImuBias bias;
  double gyro_bias_sigma = 5e-3;  ///< [rad/s], an axis
  double accel_bias_sigma = 0.1;  ///< [m/s^2]
  Mat3 R_body_cam = Mat3::Identity();
  double time_offset_s = 0;  ///< a picture stamped t was taken at t + this on the sensor's clock
};

struct NavigationOptions {
  DeadReckoningOptions inertial;
  /// A place without a picture is told so long at most, and no longer than its sigma has grown by so much. What a
  /// sensor of the MPU-6000's grade is worth: a vertical known to 5 mrad and a bias known to 0.05 m/s^2 are 0.2 m after
  /// 2 s.
  rt::TimeNs coast_ns = 2 * rt::kNsPerSecond;
  double coast_sigma_m = 0.3;
  /// Beyond this nothing is joined on any more: the frame begins anew, and that is a reset.
  double broken_sigma_m = 5;
  double broken_heading_rad = 0.35;
  /// A new map that disagrees with what the sensor told by more than this [sigmas squared] is not joined on either:
  /// vertical (2 degrees of freedom) and speed (3); by chance one in 10,000 does.
  double most_tilt2 = 18.4;
  double most_speed2 = 21.1;
  /// Vision against dead reckoning over this time, again and again. Vision itself may be off by so much then: a length,
  /// and a share of the way.
  rt::TimeNs check_ns = rt::kNsPerSecond;
  double check_sigma_m = 0.02, check_share = 0.01;
  SelfCheckOptions self_check;
};

/// What is told of one picture.
struct NavigationPose {
  enum class Source : std::uint8_t {
    kNone,    ///< nothing that may be told; the rest means nothing but frame_id and why
    kSeen,    ///< by its picture
    kCoasted  ///< by the inertial sensor, from the last one that was seen
  };
  Source source = Source::kNone;
  SE3 T_nav_cam;
  Vec3 velocity_m_s = Vec3::Zero();  ///< of the camera along the frame's axes
  /// Of (place [m], rotation vector [rad]) along the frame's axes, relative to where and how the frame began.
  Mat6 covariance = Mat6::Zero();
  Mat3 velocity_covariance = Mat3::Zero();
  std::uint32_t frame_id = 0;  ///< another one: the frame began anew, places before cannot be compared; 0: none yet
  /// The last picture's pose would now be told moved by so much, and turned (rotation vector along the frame's axes).
  Vec3 moved_by_m = Vec3::Zero(), turned_by_rad = Vec3::Zero();
  rt::TimeNs unseen_ns = 0;  ///< since the last picture that was seen
  double trust = 1;      ///< 0 to 1: whether vision and inertial sensor agree over time (vo_core/inertial/self_check.h)
  const char* why = "";  ///< kNone, or a frame begun anew: static text
  double value = 0, limit = 0;  ///< in the unit that why names, as of MetricMap::Refusal
};

/// One thread; no allocation after the constructor. Readings and pictures in the order of their times, a picture after
/// the readings up to its time.
///
/// A frame that is joined on takes its heading and place from dead reckoning; its own vertical and speed correct that:
/// so the way flown blind is known better than by the sensor alone, and the covariance goes on through the gap.
class NavigationFrame {
 public:
  explicit NavigationFrame(const Vec3& t_body_cam_m, const NavigationOptions& options = {});

  /// False: a reading that is no number or out of order. It is passed over.
  bool add(const ImuReading& reading);
  /// seen: what is known of the picture of time t_ns; null where nothing is. What is no number, no rotation or no
  /// covariance counts as not seen.
  NavigationPose frame(rt::TimeNs t_ns, const MetricMoment* seen);
  /// Where the camera should be at a time after the last picture's, by dead reckoning, in the child that was seen last,
  /// and how far it may have strayed since that picture [m, rad; root of the sum over the axes].
  struct Expected {
    SE3 T_child_cam;
    double place_sigma_m = 0, turn_sigma_rad = 0;
  };
  /// False: nobody knows.
  bool expected(rt::TimeNs t_ns, Expected* out) const;
  /// What was told of the last picture as whoever goes on from it needs it: the body's motion and the covariance of all
  /// of it. Not known where nothing was, or nobody measured since.
  Motion motion() const;
  /// Somebody beside vision and inertial sensor knows lengths, too: by how much they are off from his, squared, in
  /// sigmas, one degree of freedom. Counts once in check_ns, before that picture's frame(); lowers trust, ends nothing.
  void contradicted(CheckedBy by, double squared, rt::TimeNs t_ns);
  /// The frame begins anew with the next moment that is seen. Static text, and figures in the unit that it names.
  void break_frame(const char* why, double value, double limit);

  std::uint32_t frame_id() const { return frame_id_; }
  const SelfCheck& self_check() const { return self_check_; }

 private:
  void go_on_to(rt::TimeNs t_ns);
  Vec3 rate_at(rt::TimeNs t_ns) const;
  void begin(const MetricMoment& m, const Mat3& R_child_body, const Vec3& p_child_body);
  bool join(const MetricMoment& m, const Mat3& R_child_body, const Vec3& p_child_body);
  void hold(const NavigationPose& pose, const MetricMoment& m, rt::TimeNs t_ns);
  void check(const NavigationPose& pose, const MetricMoment& m, rt::TimeNs t_ns);
  void correct_checked(const NavigationPose& pose, const MetricMoment& m);
  NavigationPose tell_seen(const MetricMoment& m) const;
  NavigationPose tell_coasted(rt::TimeNs t_ns) const;

  const Vec3 t_body_cam_;
  const NavigationOptions options_;
  ImuBuffer buffer_;
  DeadReckoning state_;  ///< of the body; of the last picture, or further on
  Mat3 R_body_cam_ = Mat3::Identity();
  bool known_ = false;        ///< state_ ties on to the frame
  bool drifted_off_ = false;  ///< it no longer does, by nothing but the time it was blind
  bool any_ = false;          ///< there was a frame: state_ says where it ended
  rt::TimeNs t_state_ns_ = 0, t_seen_ns_ = 0, shift_ns_ = 0;
  rt::TimeNs blind_ns_ = 0;  ///< nobody measured since t_seen_ns_
  double seen_variance_ = 0, seen_heading_variance_ = 0;
  bool last_seen_ = false;  ///< the last picture was
  std::uint32_t frame_id_ = 0, child_id_ = 0;
  // The child in the frame: p = anchor_ + turn_ (p_child - anchor_child_), turn_ about z.
  Mat3 turn_ = Mat3::Identity();
  Vec3 anchor_ = Vec3::Zero(), anchor_child_ = Vec3::Zero();
  Eigen::Matrix4d gauge_ = Eigen::Matrix4d::Zero();  ///< covariance of (anchor_, heading)
  // Vision against dead reckoning that began with it a while ago.
  SelfCheck self_check_;
  DeadReckoning checked_;
  Vec3 check_from_ = Vec3::Zero();
  rt::TimeNs t_check_ns_ = 0, t_checked_ns_ = 0;  ///< begun (0: not), and how far it is
  rt::TimeNs t_contradicted_ns_ = 0;              ///< one was counted then
  const char* why_ = "not metric yet";
  double value_ = 0, limit_ = 0;
};

}  // namespace godwit::vo
