// The first map from two views (the paper, section 2.4): tracks from the first frame, homography and fundamental matrix
// side by side, the better one by score, cheirality and parallax checks, triangulation, two-view refinement.
#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "hal/rt/image.h"
#include "hal/rt/time.h"
#include "vo_core/features/feature_detector.h"
#include "vo_core/features/initial_tracks.h"
#include "vo_core/geometry/camera_model.h"
#include "vo_core/geometry/geometry.h"
#include "vo_core/geometry/two_view_geometry.h"

namespace godwit::vo {

struct InitializerOptions {
  int features = 400;             ///< tracks started in the first frame
  int min_tracks = 80;            ///< fewer left: start again from the present frame
  double min_disparity_px = 2.0;  ///< median motion of the tracks below which nothing is tried
  double min_parallax_px = 0.6;   ///< median distance of the tracks from the best pure rotation, to be tried
  int min_views = 4;              ///< views after the first before anything is tried
  double min_parallax_deg = 1.0;  ///< median angle between the rays of the triangulated points
  int min_points = 60;            ///< accepted points of the first map
  /// Median of depth_sigma / depth above which the map is refused. 0.03 let climbs from a flat pad begin 4 degrees off
  /// their direction (take-off-and-land: 0.33 m instead of 0.07); with 0.01 bare ground begins later for nothing.
  double max_depth_uncertainty = 0.02;
  /// One sigma of the baseline over the mean depth, relative, above which the map is refused. Of 474 first maps of
  /// tum_fr1_xyz, euroc_mh01 and two take-offs 4 had more, two of those more than 20 degrees off their direction; one
  /// that saw a tenth of the picture's width beside walkers had 0.10, and its first second was 0.8 depths off.
  double max_baseline_uncertainty = 0.04;
  /// Robust cost of the best motion over that of a different one, at most. Of first maps among walkers with more than
  /// 0.75 three of eleven were of a wrong motion (15 degrees and more off its direction), with less two of 57.
  double max_ambiguity = 0.75;
  /// Tracks that follow a motion of their own over those that follow the best one, at most. In 403 right first maps
  /// of tum_fr1_xyz, euroc_mh01 and a take-off it was 0.31 at most; beside a motorway, where 62 of 160 were of the
  /// trucks, 0.60 at least in those.
  double max_second_motion = 0.5;
  double homography_ratio = 0.4;  ///< R_H above this picks the homography (the paper, equation for R_H)
  int ransac_iterations = 100;
  double sigma_px = 1.0;       ///< measurement noise in the transfer error's outlier cut
  double readout = 0.0;        ///< rolling shutter: time from the first row to the last, in frame intervals
  double min_noise_px = 0.15;  ///< the tracks are never believed to be better than this
};

enum class InitStatus : std::uint8_t {
  kFirstFrame,      ///< this frame became the first view
  kTooFewFeatures,  ///< not enough features in the first view
  kTracksLost,      ///< too few tracks left: this frame became the first view
  kNoMotion,        ///< disparity too small to try
  kNoParallax,      ///< motion, but a rotation explains it, the rays are too parallel or the depths too uncertain
  kNoModel,         ///< neither model stands (too few inliers or points in front of the cameras)
  kTurnOrWay,       ///< the tracks lie too near each other to tell how far the camera went from how it turned
  kAmbiguous,       ///< two different motions explain the tracks about equally well
  kTwoMotions,      ///< many of the tracks that do not follow the best motion follow another one: which is the world's?
  kDone
};

/// One point of the first map.
struct InitPoint {
  Vec2f px_ref;                        ///< in the first view, level-0 px
  Vec2f px_cur;                        ///< in the present view, level-0 px, sub-pixel
  Vec2f px_ref_global, px_cur_global;  ///< both as a global shutter would have seen them
  std::int8_t level;                   ///< pyramid level of the feature in the first view
  Vec3 p_ref;                          ///< position in the first view's camera frame, units of the chosen scale
  double depth_sigma;                  ///< one sigma of the depth along the first view's ray, same units
};

struct InitReport {
  InitStatus status = InitStatus::kFirstFrame;
  InitModel model = InitModel::kNone;
  int tracks = 0;
  int inliers = 0;
  int points = 0;
  double median_disparity_px = 0;
  double median_parallax_deg = 0;
  double parallax_px = 0;           ///< median distance of the tracks from the best pure rotation
  double ratio_homography = 0;      ///< R_H
  double depth_uncertainty = 0;     ///< median of depth_sigma / depth
  double baseline_uncertainty = 0;  ///< sigma of the baseline over the mean depth, relative
  double ambiguity = 0;      ///< robust cost of the best motion over that of the next different one; 0: there is none
  double second_motion = 0;  ///< tracks that follow a motion of their own over those that follow the best one
  double noise_px = 0;       ///< of one coordinate of a track, from the residuals
  double still_rad = 0;      ///< with kNoMotion: by so much at most the picture moved since the first view
};

/// All buffers are allocated by the constructor; add_frame does not allocate and is bounded. One thread at a time.
class Initializer {
 public:
  Initializer(const CameraModel& camera, const InitializerOptions& options);
  ~Initializer();
  Initializer(const Initializer&) = delete;
  Initializer& operator=(const Initializer&) = delete;

  /// Forgets the first view.
  void reset();

  /// Feeds the next frame; unless `decide`, its tracks are followed and nothing is tried. The pyramid of the FIRST view
  /// must stay readable until reset() or until a status says that the present frame became the first view: the caller
  /// holds that frame's slot. Tracks that enter a masked pixel are dropped. Of the motion the shake counts. On kDone,
  /// T_cur_ref() and points() hold the first map, scaled so that the median depth in the first view is 1.
  InitReport add_frame(const rt::PyramidView& frame, const rt::MaskPyramidView& mask, bool decide = true,
                       const ReadoutMotion& motion = {});

  /// Of the last add_frame(): InitialTracks::in_three_views().
  std::span<const InitialTracks::InThreeViews> in_three_views() const;
  /// Valid after kDone until the next call.
  const SE3& T_cur_ref() const;
  /// Left twist rates of T_ref_world and T_cur_world at their times, per frame interval, units of the chosen scale.
  const Vec6& velocity_ref() const;
  const Vec6& velocity_cur() const;
  std::span<const InitPoint> points() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace godwit::vo
