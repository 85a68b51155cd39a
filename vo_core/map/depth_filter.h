// Bayesian depth filter of one seed: a Gaussian on inverse depth and a Beta on the share of good measurements
// (Vogiatzis and Hernandez, "Video-based, real-time multi-view stereo", Image and Vision Computing 2011).
#pragma once

#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

struct DepthEstimate {
  double inv_depth = 1.0;     ///< mean of 1 / distance along the bearing, map units
  double variance = 1.0;      ///< of it
  double inv_range = 1.0;     ///< outliers are uniform over this range of inverse depth
  double a = 10.0, b = 10.0;  ///< Beta: a good, b bad measurements

  /// Prior: mean depth of the scene, nearest depth considered.
  static DepthEstimate prior(double depth_mean, double depth_min);

  /// Fuses a measured inverse depth with its variance (the closed-form moment matching of the paper above). One less
  /// certain than the range of what may be measured fits anything: it tells neither the depth nor whether it is good.
  void update(double measured, double measured_variance);
  /// A search that found nothing although the seed was in view and would have been told apart.
  void miss() { b += 0.5; }

  /// One sigma of depth over depth.
  double relative_sigma() const;
  double inlier_ratio() const { return a / (a + b); }
};

/// Measurements, one after the other, that agree on one inverse depth, and their weighted mean. Where points are needed
/// at once this tells sooner than the filter's variance, which has to rule out first that the measurements are chance.
class AgreedDepth {
 public:
  /// A measurement off by more than kSigmas of mean and measurement together begins a new run.
  static constexpr double kSigmas = 2.5;
  /// What is not finite, or of no positive variance, is left out.
  void add(double measured_inv_depth, double measured_variance);

  int matches() const { return matches_; }
  // Of one match at least.
  double inv_depth() const { return weighted_ / weight_; }
  double variance() const { return 1.0 / weight_; }
  /// One sigma of depth over depth.
  double relative_sigma() const;

 private:
  int matches_ = 0;
  double weight_ = 0.0, weighted_ = 0.0;
};

/// Inverse-depth variance of a triangulated depth when the match is off by px_error_angle [rad] along the epipolar line
/// (Pizzoli, Forster, Scaramuzza, "REMODE", ICRA 2014, section III-B). f_ref: unit bearing, t_ref_cur: place of the
/// other camera in the reference frame.
double inverse_depth_variance(const Vec3& t_ref_cur, const Vec3& f_ref, double depth, double px_error_angle);

}  // namespace godwit::vo
