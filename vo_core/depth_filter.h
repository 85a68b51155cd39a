// Bayesian depth filter of one seed: a Gaussian on inverse depth and a Beta on the share of good measurements
// (Vogiatzis and Hernandez, "Video-based, real-time multi-view stereo", Image and Vision Computing 2011).
#pragma once

#include "vo_core/geometry.h"

namespace godwit::vo {

struct DepthEstimate {
  double inv_depth = 1.0;     ///< mean of 1 / distance along the bearing, map units
  double variance = 1.0;      ///< of it
  double inv_range = 1.0;     ///< outliers are uniform over this range of inverse depth
  double a = 10.0, b = 10.0;  ///< Beta: a good, b bad measurements

  /// Prior: mean depth of the scene, nearest depth considered.
  static DepthEstimate prior(double depth_mean, double depth_min);

  /// Fuses a measured inverse depth with its variance (the closed-form moment matching of the paper above).
  void update(double measured, double measured_variance);
  /// A search that found nothing although the seed was in view.
  void miss() { b += 0.5; }

  /// One sigma of depth over depth.
  double relative_sigma() const;
  double inlier_ratio() const { return a / (a + b); }
};

/// Inverse-depth variance of a triangulated depth when the match is off by px_error_angle [rad] along the epipolar line
/// (Pizzoli, Forster, Scaramuzza, "REMODE", ICRA 2014, section III-B). f_ref: unit bearing, t_ref_cur: place of the
/// other camera in the reference frame.
double inverse_depth_variance(const Vec3& t_ref_cur, const Vec3& f_ref, double depth, double px_error_angle);

}  // namespace godwit::vo
