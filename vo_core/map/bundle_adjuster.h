// Bounded bundle adjustment (Triggs et al. 2000): poses of some keyframes and positions of the points they see, by
// Levenberg-Marquardt with the Schur complement over the points. Huber weights. Fixed storage.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <memory>

#include "vo_core/geometry/camera_model.h"
#include "vo_core/geometry/geometry.h"
#include "vo_core/map/map.h"
#include "vo_core/map/pose_certainty.h"

namespace godwit::vo {

struct BundleAdjusterOptions {
  int max_free_keyframes = 14;
  int max_iterations = 4;
  double huber_px = 1.5;    ///< in units of a level-0 pixel's sigma
  double outlier_px = 3.5;  ///< observations further off in the end are reported as outliers
};

struct BundleReport {
  int free_keyframes = 0;
  int fixed_keyframes = 0;
  int points = 0;
  int observations = 0;
  int iterations = 0;
  double rms_before_px = 0.0;
  double rms_after_px = 0.0;
  int outliers = 0;
};

struct BundleProblem;

class BundleAdjuster {
 public:
  static constexpr int kMaxFree = 24;
  static constexpr int kMaxBundlePoints = 3000;
  static constexpr int kMaxObservations = 24000;
  static constexpr int kMaxOutliers = 512;

  BundleAdjuster(const CameraModel& camera, const BundleAdjusterOptions& options);
  ~BundleAdjuster();
  BundleAdjuster(const BundleAdjuster&) = delete;
  BundleAdjuster& operator=(const BundleAdjuster&) = delete;

  /// Adjusts keyframe `centre` and those that share most points with it, and all points that they see; other observers
  /// are held fixed. Writes poses and points into the map. Keyframe with id 1 is never moved (gauge).
  /// No allocation; bounded.
  BundleReport run(Map* map, int centre);

  /// After run(): how certain the centre is relative to the other keyframes that were adjusted with it
  /// (bundle_shares.cpp). Of centre 0 when nothing was adjusted or the information does not suffice. No allocation;
  /// bounded; costs about as much as one iteration.
  void shares(const Map& map, MapShares* out);

  /// After run(): places of the keyframes that moved, indices of points that moved, outlier observations.
  int moved_keyframe_count() const;
  int moved_keyframe(int i) const;
  int moved_point_count() const;
  int moved_point(int i) const;
  int outlier_count() const;
  Observation outlier(int i) const;

 private:
  std::unique_ptr<BundleProblem> problem_;
};

}  // namespace godwit::vo
