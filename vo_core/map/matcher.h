// Finding a known patch in another picture: affine warp, direct matching of map points, epipolar search for seeds
// (Forster et al. 2014, sections IV-B and V).
#pragma once

#include <Eigen/Core>

#include "hal/rt/image.h"
#include "vo_core/features/feature_align.h"
#include "vo_core/geometry/camera_model.h"
#include "vo_core/geometry/geometry.h"
#include "vo_core/map/map.h"

namespace godwit::vo {

/// Where a patch comes from: a feature of a keyframe, and how deep it lies.
struct PatchSource {
  const rt::PyramidView* pyramid = nullptr;
  const KeyframeFeature* feature = nullptr;
  double depth = 1.0;  ///< distance along the feature's bearing, map units
};

using Mat32 = Eigen::Matrix<double, 3, 2>;

/// How a feature's bearing turns with its pixel [1/px]: what warp_matrix() asks of the source's camera, the same for
/// each picture. False where the camera cannot tell.
bool bearing_by_pixel(const CameraModel& camera, const KeyframeFeature& feature, Mat32* turned);

/// warp_matrix() from that.
bool warp_matrix(const CameraModel& camera, const PatchSource& source, const Mat32& turned, const SE3& T_cur_ref,
                 Eigen::Matrix2f* A_cur_ref);

/// Linear map from level-0 pixels around the source feature to level-0 pixels of the other view. False when a
/// neighbouring ray cannot be seen there.
bool warp_matrix(const CameraModel& camera, const PatchSource& source, const SE3& T_cur_ref,
                 Eigen::Matrix2f* A_cur_ref);

/// Pyramid level of the other view on which a patch of level_ref appears at about its own scale.
int search_level(const Eigen::Matrix2f& A_cur_ref, int level_ref, int max_level);

/// Cuts the source's patch as it appears on `level_cur` of the other view. False when it leaves the source picture.
bool warp_patch(const PatchSource& source, const Eigen::Matrix2f& A_cur_ref, int level_cur, ReferencePatch* patch);

/// Asks for the pixels that warp_patch() will read of a feature, about as many as an unturned patch of its own scale
/// covers. Says nothing and changes nothing.
void prefetch_patch(const rt::PyramidView& pyramid, const KeyframeFeature& feature);

struct MatchResult {
  bool found = false;
  Vec2f px = Vec2f::Zero();  ///< level-0 pixels
  Vec2f gradient = Vec2f::UnitX();
  int level = 0;
  float residual = 0.0f;
};

/// A source's patch as another picture shows it, ready to be aligned.
struct PreparedPatch {
  Eigen::Matrix2f A_cur_ref;
  int level = 0;  ///< of the other picture
  AlignTemplate reference;
};

/// Cuts and prepares it. False when it leaves the source picture or has no texture.
bool prepare_patch(const PatchSource& source, const Eigen::Matrix2f& A_cur_ref, int level, PreparedPatch* patch);

/// Aligns it in `cur`, starting at px_guess (level 0).
MatchResult match_prepared(const PreparedPatch& patch, const rt::PyramidView& cur, const Vec2f& px_guess);

/// Aligns the source's patch in `cur`, starting at px_guess (level 0), on the level of its own scale or `coarser`
/// levels above it. Not found above max_level.
MatchResult match_direct(const CameraModel& camera, const PatchSource& source, const SE3& T_cur_ref,
                         const rt::PyramidView& cur, const Vec2f& px_guess, int max_level, int coarser = 0);

/// Searches `cur` along the epipolar curve of the source between depths depth_min and depth_max (max may be infinite
/// in practice: pass a large value), then aligns. Gives the depth along the source's bearing by triangulation.
/// `displaced`: by what the picture's rolling shutter has moved the point [px]; the match's place has it, the depth
/// not. Bounded: at most kMaxEpipolarSteps patch comparisons.
constexpr int kMaxEpipolarSteps = 120;
struct EpipolarResult {
  MatchResult match;
  double depth = 0.0;
  bool depth_known = false;  ///< the match's ray meets the source's: else it is found, and tells no depth
  bool visible = false;      ///< the search line crosses the picture (a failure then counts against the seed)
};
EpipolarResult match_epipolar(const CameraModel& camera, const PatchSource& source, const SE3& T_cur_ref,
                              const rt::PyramidView& cur, double depth_min, double depth_max, int max_level,
                              const Vec2& displaced = Vec2::Zero());

/// Depth along f_ref (unit) of the point seen under f_ref and f_cur. False when the rays are parallel.
bool depth_from_triangulation(const SE3& T_cur_ref, const Vec3& f_ref, const Vec3& f_cur, double* depth);

}  // namespace godwit::vo
