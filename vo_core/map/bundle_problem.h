// The bundle adjustment as a least-squares problem: which keyframes and points take part, what the observations are off
// by, and the normal equations with the points eliminated. bundle_adjuster.cpp minimises it, bundle_shares.cpp reads
// from it how certain the solution is.
#pragma once

#include <array>
#include <cstdint>

#include "vo_core/geometry/reprojection.h"
#include "vo_core/map/bundle_adjuster.h"

namespace godwit::vo {

using Mat63 = Eigen::Matrix<double, 6, 3>;

/// Plain storage, some 10 MB; made once. No function allocates.
struct BundleProblem {
  static constexpr int kMaxFree = BundleAdjuster::kMaxFree;
  static constexpr int kDim = 6 * kMaxFree;

  struct Obs {
    ImageObservation seen;
    std::int16_t pose;  ///< < free_count: free; else fixed
    std::uint8_t place;
    bool used;
    std::uint16_t feature;
    Vec2f error;  ///< at the last linearisation, in stated sigmas
    Vec6 b;       ///< of free poses: this observation's part of bp
    Mat63 Hpl;
  };
  struct Point {
    int index;
    int first, count;  ///< observations
    Vec3 p, p_new;
    Mat3 H, H_inv;
    Vec3 b;
  };

  /// For bundle_shares.cpp. Views beside the centre: at its own place and a little along each of its axes.
  static constexpr int kViews = 4;
  /// Clusters of points: cells of the centre's picture, as far as neighbours err together.
  static constexpr int kCellColumns = 8, kCellRows = 6, kCells = kCellColumns * kCellRows;
  struct Views {
    std::array<SE3, kViews> T_view_world;
    std::array<Mat6, kViews> own;                            ///< inverse information of what each measures
    std::array<std::array<Mat6, kMaxFree>, kViews> by_pose;  ///< of the normal equations, by the free poses
    std::array<Eigen::Matrix<double, 6 * kViews, 3>, BundleAdjuster::kMaxBundlePoints> by_point;  ///< zero: out of view
    std::array<std::array<Vec6, kMaxFree + 1>, kCells> here;  ///< sums over a cell's points
    std::array<Vec18, kCells> change;
  };

  BundleProblem(const CameraModel& c, const BundleAdjusterOptions& o) : camera(c), options(o) {}

  /// Keyframe `centre`, those that share most points with it, free; and all other observers of their points, fixed.
  void select(const Map& map, int centre);
  /// Robust cost (Huber) of these poses, with the points as they are or, fresh, as the last step would have them.
  double cost(const std::array<SE3, kMaxKeyframes>& poses, bool fresh) const;
  /// Normal equations at the present poses and points; returns their cost. bp and Point::b are minus half the cost's
  /// gradient by the left twists and by the points.
  double linearize();
  /// Schur complement over the points, damped by lambda, into S and rhs.
  void eliminate_points(double lambda);
  /// One step, damped: pose_new and Point::p_new. False: not positive definite.
  bool solve(double lambda);

  const CameraModel& camera;
  BundleAdjusterOptions options;
  int pose_count = 0, free_count = 0, point_count = 0, obs_count = 0, outlier_count = 0;
  std::array<int, kMaxKeyframes> pose_place;
  std::array<SE3, kMaxKeyframes> pose, pose_new;
  std::array<int, kMaxKeyframes> place_pose;
  std::array<int, kMaxKeyframes> shared;
  std::array<Point, BundleAdjuster::kMaxBundlePoints> points;
  std::array<Obs, BundleAdjuster::kMaxObservations> obs;
  std::array<Observation, BundleAdjuster::kMaxOutliers> outliers;
  std::array<std::uint16_t, kMaxPoints> point_mark;
  std::array<Mat6, kMaxFree> Hpp;
  std::array<Vec6, kMaxFree> bp;
  std::array<Mat6, kMaxFree * kMaxFree> inverse;  ///< of S, by blocks: bundle_shares.cpp
  Views views;
  alignas(32) std::array<double, kDim * kDim> S;
  alignas(32) std::array<double, kDim> rhs;
};

}  // namespace godwit::vo
