// Homography or fundamental matrix? Both are estimated side by side by RANSAC, the scores decide (the paper, section
// 2.4; Mur-Artal, Montiel, Tardos, TRO 2015, section IV), and the winner gives candidate motions.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>

#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

enum class InitModel : std::uint8_t { kNone, kHomography, kFundamental };

struct TwoViewOptions {
  int iterations = 100;           ///< RANSAC samples; each feeds both models
  double sigma_px = 1.0;          ///< measurement noise in the outlier cut
  double homography_ratio = 0.4;  ///< R_H above this picks the homography
};

/// A motion with the structure it implies.
struct TwoViewCandidate {
  SE3 T_b_a;  ///< |t| = 1
  InitModel model = InitModel::kNone;
  int in_front = 0;  ///< inliers of the model that lie in front of both cameras
};

struct TwoViewResult {
  InitModel model = InitModel::kNone;
  double score_homography = 0, score_fundamental = 0;
  double ratio_homography = 0;  ///< R_H = S_H / (S_H + S_F)
  int inliers = 0;              ///< of the picked model
  /// Both models' motions, the picked model's first and by falling in_front within a model; at most two of each.
  std::array<TwoViewCandidate, 4> candidates;
  int candidate_count = 0;
};

/// Triangulates a correspondence of normalised image planes (z = 1): inverse depth in view a of the point that lies on
/// a's ray and nearest to b's ray (least squares in b's image). False if the rays are parallel.
bool triangulate_inverse_depth(const SE3& T_b_a, const Vec2& a, const Vec2& b, double* inverse_depth);

/// Works in buffers allocated by the constructor; estimate() does not allocate. One thread at a time.
class TwoViewGeometry {
 public:
  static constexpr int kMaxPoints = 512;
  explicit TwoViewGeometry(const TwoViewOptions& options);
  ~TwoViewGeometry();
  TwoViewGeometry(const TwoViewGeometry&) = delete;
  TwoViewGeometry& operator=(const TwoViewGeometry&) = delete;

  /// a, b: the same points (8..kMaxPoints) in both views, undistorted, in pixels relative to the principal point:
  /// (x, y) = focal_px * (X, Y) / Z. The same input gives the same result: the random numbers start anew every time.
  /// model is kNone where neither model could be formed.
  TwoViewResult estimate(std::span<const Vec2> a, std::span<const Vec2> b, double focal_px);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace godwit::vo
