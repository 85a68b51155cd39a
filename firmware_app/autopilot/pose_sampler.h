// From what the tracker says of a frame to what the link tells the autopilot: the world turned upright, velocity and
// turn rate, jumps counted.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "firmware_app/link/pose_sample.h"
#include "firmware_app/pipeline/frame_record.h"
#include "vo_core/inertial/velocity_fit.h"

namespace godwit::app {

/// Turns the map's world, which is the first view's camera, into the link's: z up, x where the body's front was.
/// Assumes that the body was level when the map began; whether that is so, gravity alone can tell. R_body_cam: camera
/// (x right, y down, z ahead) to body (front, right, down).
Eigen::Matrix3d world_of_level_start(const Eigen::Matrix3d& R_body_cam);

/// Remembers the last few poses. Tracker thread; no allocation.
class PoseSampler {
 public:
  /// north: where it becomes known it is told. Who does not turn to it is to hear of no jump either.
  explicit PoseSampler(const Eigen::Matrix3d& R_world_map, bool north = true)
      : R_world_map_(R_world_map), north_(north) {}

  /// Of a picture that is the one before, bit for bit, there is nothing to tell while the state stands: it claims a
  /// pose, and this frame has none. sample() is not to be given it.
  static bool nothing_new(const FrameRecord& record) {
    return record.repeated && !record.has_pose && vo::claims_pose(record.state);
  }
  /// Frames in the order of their capture, processed ones only. Where the record is not metric, lengths are the map's,
  /// neither scale nor gravity is known, and the sample says so.
  ///
  /// The reset counter goes up where a correction of the map moved the pose by more than the largest of 3 sigma, 5 cm
  /// and 1 degree. What it moved is no velocity. A new map has a new map id, which the link counts; metric records
  /// stand in a navigation frame that goes on through new maps, and its number takes that id's place. Less trust than 1
  /// makes their sigmas larger, 1 / trust times. Where north has become known the frame that is sent turns there, about
  /// the camera, which is a jump; and again where north is known to be off by more than a degree and its sigma. Between
  /// it stands.
  link::PoseSample sample(const FrameRecord& record);

 private:
  /// From the record's world to the link's: a metric record has the link's already.
  Eigen::Matrix3d world_of(const FrameRecord& record) const;
  void tell_north(const FrameRecord& record, link::PoseSample* sample);
  void follow_correction(const FrameRecord& record, const Eigen::Matrix<double, 6, 6>& covariance);

  const Eigen::Matrix3d R_world_map_;
  const bool north_;
  vo::VelocityFit fit_;
  bool has_last_ = false;
  rt::TimeNs t_last_ns_ = 0;
  Eigen::Quaterniond last_q_{1, 0, 0, 0};  // camera to world
  std::uint32_t map_id_ = 0;
  std::uint8_t jumps_ = 0;
  bool north_told_ = false;
  double heading_ = 0;  ///< by which the frame was turned last [rad]
  std::array<double, 2> turned_about_{}, moved_by_{};
};

}  // namespace godwit::app
