// Motion-only bundle adjustment (Forster et al. 2014, section IV-C): the pose that makes the measured features agree
// with the map, robust, with its covariance.
#pragma once

#include <span>

#include "vo_core/features/feature_detector.h"
#include "vo_core/geometry/camera_model.h"
#include "vo_core/geometry/geometry.h"
#include "vo_core/tracking/motion_prior.h"

namespace godwit::vo {

struct PoseMeasurement {
  Vec2 px = Vec2::Zero();  ///< measured, level-0 px
  Vec3 p_world = Vec3::Zero();
  Vec2 gradient = Vec2::UnitX();  ///< edgelets: unit direction in which the measurement counts
  double sigma_px = 1.0;          ///< of each coordinate
  FeatureType type = FeatureType::kCorner;
  bool inlier = true;  ///< result
  double error = 0.0;  ///< result, of an inlier: length of its residual [sigma]
};

struct PoseOptimizerOptions {
  int max_iterations = 8;
  double outlier_sigma = 3.0;  ///< a measurement further off than this many stated sigmas is an outlier in the end
  /// Most by which the residuals' own spread may widen the weights in the end. On the way there it may be any: the pose
  /// to begin with is off.
  double max_scale = 1.5;
};

struct PoseOptimizerResult {
  int inliers = 0;
  int measurements = 0;
  double rms_px = 0.0;        ///< of the inliers [px]
  double sigma_scale = 1.0;   ///< robust estimate of the noise in units of the stated sigmas
  double weight_scale = 1.0;  ///< stated sigmas by this: what the weights took for one sigma
  double chi_square = 0.0;    ///< of the inliers against their stated sigmas
  int freedom = 0;            ///< its degrees of freedom: coordinates measured less six
  /// Of the left twist (v, w) of T_cam_world: as the stated sigmas have it, and larger where the residuals are.
  Mat6 covariance = Mat6::Identity();
  Mat6 with_prior = Mat6::Identity();  ///< the same of measurements and prior together
  bool ok = false;
};

/// The value that chi-square of so many degrees of freedom stays below in 999 of 1,000 cases (Wilson and Hilferty, PNAS
/// 1931; good to a per cent from three degrees on).
double chi_square_limit(int freedom);

/// Refines T_cam_world in place; marks outliers. A prior that is known counts as one more measurement, weighed against
/// the others by what their residuals say of them. ok = false (pose untouched) when fewer than 10 inliers remain,
/// beside a prior 6, or the normal equations are singular. No allocation.
PoseOptimizerResult optimize_pose(const CameraModel& camera, const PoseOptimizerOptions& options,
                                  std::span<PoseMeasurement> measurements, SE3* T_cam_world,
                                  const PosePrediction& prior = {});

/// Residual [px] and its Jacobian for the left twist of T_cam_world: the measured minus the predicted pixel. False when
/// the point cannot be seen.
bool pose_residual(const CameraModel& camera, const SE3& T_cam_world, const PoseMeasurement& m, Vec2* residual,
                   Mat26* J);

/// The same as Tukey's biweight of a pose sees it: `v` is the square of the residual over where it counts no more,
/// which is kTukey times weight_scale stated sigmas.
struct JudgedResidual {
  Vec2 r;
  Mat26 J;
  double inv_sigma, v;
};
bool judge_residual(const CameraModel& camera, const SE3& T_cam_world, const PoseMeasurement& m, double weight_scale,
                    JudgedResidual* out);

}  // namespace godwit::vo
