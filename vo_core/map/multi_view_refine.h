// Bundle adjustment of a reference view, the views after it and the inverse depths of points first seen in the
// reference view. With a small baseline a single pair of views leaves the depths poor; all views together give them.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>

#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// What is estimated. The unit of length is the distance of the last view from the reference.
struct MultiViewState {
  static constexpr int kMaxViews = 8;
  static constexpr int kMaxPoints = 512;
  std::array<SE3, kMaxViews> T_view_ref;
  std::array<double, kMaxPoints> inverse_depth{};
};

/// Levenberg-Marquardt with the points eliminated (Schur complement), Cauchy weights whose width follows the residuals'
/// median, scale held by the last view's distance. Every point is measured in every view. All memory is taken by the
/// constructor; one thread at a time.
class MultiViewRefiner {
 public:
  static constexpr int kMaxViews = MultiViewState::kMaxViews;
  static constexpr int kMaxPoints = MultiViewState::kMaxPoints;

  MultiViewRefiner();
  ~MultiViewRefiner();
  MultiViewRefiner(const MultiViewRefiner&) = delete;
  MultiViewRefiner& operator=(const MultiViewRefiner&) = delete;

  /// Starts a problem: the points' rays in the reference view (x, y of z = 1), at most kMaxPoints. focal_px scales
  /// residuals to pixels; min_sigma_px is the least noise believed.
  void begin(std::span<const Vec2> rays, double focal_px, double min_sigma_px);
  /// Adds a view with the points' places in it (z = 1), in the order of begin. At most kMaxViews. The last one added
  /// carries the scale.
  void add_view(std::span<const Vec2> measured);

  /// Gauss-Newton on one view's pose alone, the points standing still.
  void refine_pose(int view, int iterations, MultiViewState* state) const;
  /// All together; at most `iterations` steps. Returns the share of the cost that was gained.
  double refine(int iterations, MultiViewState* state);

  /// Robust cost (Cauchy, units of sigma^2) for comparing two states of one problem with the same sigma_px.
  double cost(const MultiViewState& state, double sigma_px) const;
  /// Noise of one coordinate from the median residual [px].
  double sigma(const MultiViewState& state);
  /// Root mean square of one point's residuals over all views [px]; infinity if it is not in front of all of them.
  double point_rms(const MultiViewState& state, int point) const;

  /// One sigma of each point's relative depth error against the mean of the points with use[i] != 0, poses being
  /// uncertain too; and in `baseline` that of the last view's distance over the mean depth, relative, too: points side
  /// by side may tell their depths apart and hardly a turn from a way. False, and nothing written, if the motion is not
  /// determined.
  bool relative_depth_sigma(const MultiViewState& state, double sigma_px, std::span<const std::uint8_t> use,
                            std::span<double> out, double* baseline);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace godwit::vo
