// A flight whose pictures and inertial sensor InertialPoses is given, with what may go wrong in either.
#pragma once

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <functional>

#include "firmware_app/pipeline/inertial_poses.h"
#include "tests/app/mounting_matrix.h"
#include "tests/vo_core/inertial_flown.h"

namespace godwit::app::flown_poses {

using vo::Mat3;
using vo::Mat6;
using vo::Vec3;

/// A flight through vision's eyes, as the tracker tells of it, 20 pictures a second.
class Flown {
 public:
  explicit Flown(unsigned seed, rt::TimeNs coast_ns = 2 * rt::kNsPerSecond, double time_offset_s = 0,
                 const hal::ImuErrorModel& errors = {})
      : flight_(1.0, seed), poses_(mounting_matrix(flight_.mounting_), coast_ns, time_offset_s, errors) {}

  FrameRecord frame(int k) {
    for (int i = 1; i <= 10; ++i) {
      vo::ImuReading r = flight_.reading(k / 20.0 - 0.05 + i / 200.0);
      r.gyro_rad_s += flight_.model_.imu.gyro * std::sqrt(200.0) * flight_.random();
      r.accel_m_s2 += flight_.model_.imu.accel * std::sqrt(200.0) * flight_.random();
      hal::ImuSample s;
      s.t_ns = r.t_ns;
      Eigen::Map<Vec3>(s.gyro_rad_s.data()) = r.gyro_rad_s;
      Eigen::Map<Vec3>(s.accel_m_s2.data()) = r.accel_m_s2;
      if (spoil_sample_) spoil_sample_(&s);
      poses_.take(s);
    }
    const vo::InertialNode seen = flight_.node(k, {});
    vo::FrameResult result;
    result.tracked = tracked_;
    result.state = tracked_ ? vo::State::kTracking : vo::State::kRelocalising;
    result.map_id = map_id_;
    result.T_world_cam = {seen.sight.R_map_cam, seen.sight.camera};
    // As this flight's vision errs (inertial_flight.h), half a second after a keyframe.
    result.covariance = 2e-6 * Mat6::Identity();
    result.relative.keyframe_id = 1;
    result.relative.t_keyframe_ns = seen.t_ns + late_ns_ - rt::kNsPerSecond / 2;
    result.relative.covariance = 2e-7 * Mat6::Identity();
    result.median_depth = 1;
    if (spoil_result_) spoil_result_(&result);
    FrameRecord record = as_vision_has_it(result);
    poses_.make_metric(result, seen.t_ns + late_ns_, &record);
    return record;
  }
  /// The record before it is made metric.
  static FrameRecord as_vision_has_it(const vo::FrameResult& result) {
    FrameRecord r;
    r.tracked = r.has_pose = result.tracked;
    r.state = result.state;
    r.map_id = result.map_id;
    r.features = 77;
    r.own_covariance.fill(0.25);
    r.reference_covariance.fill(0.5);
    r.reference_id = 9;
    r.t_ref_cam = {1, 2, 3};
    r.q_ref_cam = {0, 0, 0, 1};
    r.median_depth = 4.5;
    return r;
  }
  Vec3 camera(int k) const {
    const double t = k / 20.0;
    return flight_.p(t) + flight_.R(t) * flight_.mounting_.t_body_cam_m;
  }

  vo::test::Flight flight_;
  InertialPoses poses_;
  bool tracked_ = true;
  rt::TimeNs late_ns_ = 0;  ///< pictures are stamped later than they were taken
  std::uint32_t map_id_ = 1;
  std::function<void(hal::ImuSample*)> spoil_sample_;
  std::function<void(vo::FrameResult*)> spoil_result_;
};

}  // namespace godwit::app::flown_poses
