// The flight of inertial_flight.h through the inertial odometry, picture by picture.
#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>

#include "tests/vo_core/inertial_flight.h"
#include "vo_core/inertial/inertial_odometry.h"

namespace godwit::vo::test {

/// Flies at 20 pictures and 200 readings a second, and remembers what was told.
class Flown {
 public:
  /// as_modelled: nothing is told on top of the smoother's own covariance, as this flight errs in no other way.
  explicit Flown(Flight* flight, bool as_modelled = false) : flight_(*flight) {
    InertialOdometryOptions options;
    options.model = flight->model_;
    if (as_modelled) options.told_place_sigma_m = options.told_scale_sigma = options.told_speed_sigma_m_s = 0;
    odometry_ = std::make_unique<InertialOdometry>(flight->mounting_, options);
  }

  /// The readings of the 50 ms before t.
  void feel(double t) {
    for (int i = 1; i <= 10; ++i) {
      if (silent_) continue;
      ImuReading r = flight_.reading(t - 0.05 + i / 200.0);
      r.gyro_rad_s += flight_.model_.imu.gyro * std::sqrt(200.0) * flight_.random();
      r.accel_m_s2 += flight_.model_.imu.accel * std::sqrt(200.0) * flight_.random();
      if (poison_) r.accel_m_s2.y() = std::numeric_limits<double>::quiet_NaN();
      odometry_->add(r);
    }
  }
  MetricPose frame(int k) {
    const double t = k / 20.0;
    // A picture that is stamped early comes before the readings up to when it was taken.
    feel(t + std::min(0.0, rt::to_seconds(late_ns_)));
    const InertialNode seen = flight_.node(k, {});
    VisualPose pose;
    pose.t_ns = seen.t_ns + late_ns_;
    pose.tracked = tracked_;
    if (still_) pose.still_rad = 1e-3;
    pose.map_id = map_id_;
    pose.T_map_cam = {seen.sight.R_map_cam, seen.sight.camera};
    pose.covariance = 1e-9 * Mat6::Identity();
    if (flight_.scale_walks_ > 0) {
      // New things come into view, and the tracker says how well they are known.
      pose.relative_age_ns = rt::kNsPerSecond / 2;
      pose.relative_covariance.diagonal().head<3>().setConstant(0.5 * flight_.scale_walks_ * flight_.scale_walks_);
      pose.relative_covariance.diagonal().tail<3>().setConstant(1e-9);
    }
    if (young_) stray(t, &pose);
    if (lean_ != 0) lean(&pose);
    if (creeps_ != 0) creep(k, &pose);
    if (corrected_at_ > 0) correct(k, &pose);
    if (walks_ != 0) walk(t, &pose);
    if (turns_ != 0) turn_as_a_whole(t, &pose);
    return odometry_->frame(pose);
  }
  /// As a map does that began on a climb over flat ground: its rotation walks by some 15 mrad in its first half second,
  /// which it says, and, less and less, for seconds after that, which it doesn't. That second part stays in what it
  /// says of the whole map.
  void stray(double t, VisualPose* pose) {
    const double rate = 0.02 * std::exp(-t / 2.5);
    strayed_ += rate * std::sqrt(0.05) * flight_.random();
    pose->T_map_cam.R = so3_exp(strayed_) * pose->T_map_cam.R;
    const double told = t < 1 ? 0.02 : 5e-4;
    told_variance_ += told * told * 0.05;
    pose->relative_age_ns = rt::kNsPerSecond / 2;
    pose->relative_covariance.diagonal().head<3>().setConstant(1e-9);
    pose->relative_covariance.diagonal().tail<3>().setConstant(0.5 * told * told);
    pose->covariance.diagonal().tail<3>().setConstant(told_variance_);
  }
  /// As in a map whose depths lean: all ways are askew, and how far a way is known says that much.
  void lean(VisualPose* pose) const {
    pose->T_map_cam.t = so3_exp(lean_ * Vec3(0.6, 0.8, 0)) * pose->T_map_cam.t;
    pose->relative_age_ns = rt::kNsPerSecond / 2;
    pose->relative_covariance.diagonal().head<3>().setConstant(2e-5);
    pose->relative_covariance.diagonal().tail<3>().setConstant(1e-7);
  }
  /// Between corrections of the map ways come out too long, each correction takes that back.
  void creep(int k, VisualPose* pose) {
    const Vec3 camera = pose->T_map_cam.t;
    if (k > 0) crept_ += creeps_ * (camera - last_camera_);
    last_camera_ = camera;
    if (k % 10 == 9) {
      pose->map_moved = true;
      pose->moved_by = -before_;
      crept_ -= before_;
    }
    pose->T_map_cam.t += crept_;
    before_ = crept_;
  }
  /// Vision strays for some pictures, by default as a map that turns fast says, and then the map is corrected by that.
  void correct(int k, VisualPose* pose) {
    pose->relative_age_ns = rt::kNsPerSecond / 2;
    pose->relative_covariance.diagonal().setConstant(corrected_told_);
    if (k == corrected_at_) {
      pose->map_moved = true;
      pose->moved_by = strayed_by_ * corrected_move_;
      pose->turned_by = strayed_by_ * corrected_turn_;
    }
    strayed_by_ = k < corrected_at_ ? std::max(0.0, 1 - double(corrected_at_ - k) / corrected_over_) : 0;
    pose->T_map_cam.R = so3_exp(-strayed_by_ * corrected_turn_) * pose->T_map_cam.R;
    pose->T_map_cam.t -= strayed_by_ * corrected_move_;
  }
  /// As a map does whose first part was seen badly: the tracker says so of that part, and that the whole map is off by
  /// as much. What is hung on it walks on, less and less (VisionStrayOptions::memory_ns), and the tracker does not say.
  void walk(double t, VisualPose* pose) {
    const double rate = walks_ * std::exp(-t / 5);
    walked_ += rate * std::sqrt(0.05) * flight_.random();
    pose->T_map_cam.t += walked_;
    const double told = (t < 0.5 ? 1 : 0.02) * walks_ / flight_.model_.position_stray;
    pose->relative_age_ns = rt::kNsPerSecond / 2;
    pose->relative_covariance.diagonal().head<3>().setConstant(0.5 * told * told);
    pose->relative_covariance.diagonal().tail<3>().setConstant(1e-9);
    pose->covariance.diagonal().head<3>().setConstant(2.5 * walks_ * walks_);
  }
  /// As a map does that began on a climb: as its depths become known it turns, and all that was flown in it with it.
  void turn_as_a_whole(double t, VisualPose* pose) {
    if (!tracked_) return;
    if (turns_since_ < 0) {
      turns_since_ = t;
      turns_about_ = pose->T_map_cam.t;
    }
    const Vec3 axis = kUpInMap.cross(Vec3::UnitX()).normalized();
    const Mat3 turn = so3_exp(turns_ * std::min(1.0, (t - turns_since_) / 1.5) * axis);
    pose->T_map_cam = {turn * pose->T_map_cam.R, turns_about_ + turn * (pose->T_map_cam.t - turns_about_)};
    pose->relative_age_ns = rt::kNsPerSecond / 2;
    const bool turns = t - turns_since_ < 1.5;
    pose->relative_covariance.diagonal().head<3>().setConstant(turns ? 2e-6 : 1e-9);
    pose->relative_covariance.diagonal().tail<3>().setConstant(turns ? 2e-4 : 1e-7);
    pose->covariance.diagonal().tail<3>().setConstant(turns_ * turns_);
  }
  /// The true place less what is told; heading and place of the first pose are taken over, since nobody told them.
  Vec3 place_error(int k, const MetricPose& pose) {
    const double t = k / 20.0;
    if (begun_ < 0) {
      begun_ = k;
      const Mat3 D = pose.T_nav_cam.R * (flight_.R(t) * flight_.mounting_.R_body_cam).transpose();
      turn_ = so3_exp(Vec3(0, 0, std::atan2(D(1, 0) - D(0, 1), D(0, 0) + D(1, 1))));
      p_first_ = camera(t);
      q_first_ = pose.T_nav_cam.t;
    }
    return turn_ * (camera(t) - p_first_) - (pose.T_nav_cam.t - q_first_);
  }
  /// The camera's true place.
  Vec3 camera(double t) const { return flight_.p(t) + flight_.R(t) * flight_.mounting_.t_body_cam_m; }

  Flight& flight_;
  std::unique_ptr<InertialOdometry> odometry_;
  bool silent_ = false, poison_ = false, tracked_ = true, young_ = false, still_ = false;
  Vec3 strayed_ = Vec3::Zero();
  double told_variance_ = 1e-9;
  double lean_ = 0;   ///< [rad]
  double turns_ = 0;  ///< [rad], over the first 1.5 s of the map
  double turns_since_ = -1;
  Vec3 turns_about_ = Vec3::Zero();
  double creeps_ = 0;  ///< share of the way
  Vec3 crept_ = Vec3::Zero(), before_ = Vec3::Zero(), last_camera_ = Vec3::Zero();
  int corrected_at_ = 0, corrected_over_ = 16;  ///< pictures; 16: kStrayedNs
  double corrected_told_ = 1e-4;                ///< variance relative to a keyframe half a second ago
  double strayed_by_ = 0;                       ///< of that correction, in the last picture
  Vec3 corrected_turn_ = Vec3::Zero(), corrected_move_ = Vec3::Zero();
  int begun_ = -1;                ///< the first picture that place_error heard of
  Mat3 turn_ = Mat3::Identity();  ///< the truth's heading into the frame's
  Vec3 p_first_ = Vec3::Zero(), q_first_ = Vec3::Zero();
  double walks_ = 0;  ///< [map units/sqrt(s), an axis]
  Vec3 walked_ = Vec3::Zero();
  std::uint32_t map_id_ = 1;
  rt::TimeNs late_ns_ = 0;  ///< pictures are stamped so much later than they were taken
};

}  // namespace godwit::vo::test
