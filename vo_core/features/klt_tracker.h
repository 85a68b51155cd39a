// Follows features of one reference picture through later pictures: pyramidal inverse-compositional Lucas-Kanade (Baker
// and Matthews, IJCV 2004) against the patches of the reference picture, never of the frame before, so that a track
// does not drift off its feature. As the picture grows and turns, the patches are cut anew from the reference picture
// through what most tracks tell of that (picture_warp.h): else those at the rim would follow off their places.
#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "hal/rt/image.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

struct KltOptions {
  /// On each level. Where the picture is blurred a step leaves a third of the way: on tum_fr1_xyz, turning by 20 px a
  /// frame, 8 lost 78 of 309 tracks in one frame, 16 lose 30, 24 lose 21.
  int max_iterations = 16;
  float converged_px = 0.02f;  ///< step on the finest level below which a track stands; coarser: twice that
  /// Normalised cross-correlation with the reference patch below which a track is lost, of what noise leaves of it.
  float min_correlation = 0.85f;
  /// Smaller eigenvalue of a patch's gradient matrix, per pixel, over the variance of the level's grey noise: a patch
  /// below is not used. Noise alone has 0.5.
  float min_eigenvalue = 4.0f;
  float max_jump_px = 40.0f;  ///< a longer way between two frames is a mismatch
};

/// One followed feature.
struct KltTrack {
  Vec2f px_ref = Vec2f::Zero();  ///< in the reference picture, level-0 px
  Vec2f px = Vec2f::Zero();      ///< in the latest picture, level-0 px, sub-pixel
  Vec2f way = Vec2f::Zero();     ///< there from the picture before [level-0 px]
  /// From px_ref, and from px, to the place whose motion this is: the centre of the patch's gradients [level-0 px].
  /// Where the picture grows or turns, one corner in the patch's corner does not move as the patch's centre.
  Vec2f centre_ref = Vec2f::Zero(), centre = Vec2f::Zero();
  /// What a step beside px_ref is beside px, as far as the patch has been told.
  Eigen::Matrix2f warp = Eigen::Matrix2f::Identity();
  float correlation = 1.0f;  ///< with the reference patch
  int level = 0;             ///< that tells the place: 0 but where the patch there is lost in noise
  bool alive = false;        ///< once false it stays false until set_reference
};

/// Brightness gain and offset are eliminated exactly: the gradient images are made orthogonal to the patch and to the
/// constant, so that neither moves the solution. All memory is taken by the constructor; one thread at a time.
class KltTracker {
 public:
  static constexpr int kMaxTracks = 512;
  static constexpr int kLevels = 4;       ///< pyramid levels used, if the picture has them
  static constexpr int kFineLevels = 3;   ///< of these the finest whose patch stands out from the noise tells the place
  static constexpr int kFinePatch = 16;   ///< edge of that patch [px of its level]
  static constexpr int kCoarsePatch = 8;  ///< edge of the patch on the levels above [px of theirs]

  explicit KltTracker(const KltOptions& options);
  ~KltTracker();
  KltTracker(const KltTracker&) = delete;
  KltTracker& operator=(const KltTracker&) = delete;

  /// Starts tracks at px (level-0 px; at most kMaxTracks are taken). The picture must stay as long as track() is
  /// called. A track whose patch leaves the picture or has no texture is dead from the start. Returns the number alive.
  /// grey_noise: one sigma of the picture's (grey_noise.h).
  int set_reference(const rt::PyramidView& reference, std::span<const Vec2f> px, float grey_noise);

  /// Finds every living track in the picture, starting where its last way leads, and where that fails, where most
  /// others went; tracks that leave the picture, do not converge, jump too far or no longer look like the reference
  /// die. Returns the number alive. No allocation.
  int track(const rt::PyramidView& picture);

  /// In the order of set_reference.
  std::span<const KltTrack> tracks() const;

  /// The caller knows better (a mask, an outlier).
  void drop(int index);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace godwit::vo
