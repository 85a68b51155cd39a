// The mapper: depth-filter seeds, new points, bundle adjustment and forgetting, on its own replica of the map. Runs
// beside the tracker, never in its way; what it finds out goes back as deltas.
#pragma once

#include <array>
#include <cstdint>
#include <memory>

#include "hal/rt/time.h"
#include "vo_core/features/feature_detector.h"
#include "vo_core/geometry/camera_model.h"
#include "vo_core/geometry/rolling_shutter.h"
#include "vo_core/image/coarse_mask.h"
#include "vo_core/map/bundle_adjuster.h"
#include "vo_core/map/depth_filter.h"
#include "vo_core/map/map_channel.h"
#include "vo_core/map/slot_releases.h"

namespace godwit::vo {

struct MapperOptions {
  FeatureDetectorOptions detector;
  int features_per_keyframe = 160;  ///< new seeds of a keyframe
  int max_seed_updates = 220;       ///< epipolar searches a frame
  double converged_sigma = 0.04;    ///< sigma of depth over depth below which a seed becomes a point
  double starving_sigma = 0.15;     ///< the same when the tracker sees next to no points
  int starving_features = 120;      ///< tracked features below which the limit begins to rise
  double crowded = kCrowdedShare;   ///< share of the picture under the mask above which it is hunger too
  double hungry = 0.5;              ///< hunger above which a seed needs little more than a place in the picture:
  double hungry_shift_px = 2.0;     ///< by how much its depth's sigma may move it
  /// Hungry in a crowd: so many matches in a row that agree on the depth are enough. With three in place of four the
  /// severe walkers are kept 1.5 to 2 % of the frames longer, mean of nine flights, with half the error; with two one
  /// of four was bent.
  int agreeing_matches = 3;
  double match_sigma_px = 0.6;    ///< noise of an epipolar match
  int seed_keyframes = 4;         ///< older keyframes that new seeds are searched in at once
  int observation_keyframes = 8;  ///< keyframes in which a new point is looked for
  int max_keyframes = 56;         ///< above: the least useful keyframe is forgotten
  int spare_points = 600;         ///< with less room: the farthest is, for a full map would take in nothing new
  BundleAdjusterOptions bundle;
  RollingShutter shutter;
};

/// Counters and stage times of the last message, for logs.
struct MapperReport {
  MessageKind kind = MessageKind::kReset;
  std::uint32_t sequence = 0;
  int seeds = 0;
  int seeds_updated = 0;
  int points_new = 0;
  int keyframes = 0;
  int points = 0;
  BundleReport bundle;
};

class Mapper {
 public:
  static constexpr int kMaxSeeds = 800;

  /// All memory is taken here.
  Mapper(const CameraModel& camera, const MapperOptions& options, MapChannel* channel);
  ~Mapper();
  Mapper(const Mapper&) = delete;
  Mapper& operator=(const Mapper&) = delete;

  /// Handles the oldest message, if there is one and a delta is free to answer with. False: nothing done. Bounded, no
  /// allocation.
  bool step();

  /// References to frame slots that the mapper no longer needs. False when there are none.
  bool take_release(SlotRelease* release);

  const MapperReport& report() const { return report_; }
  const Map& map() const { return map_; }

 private:
  struct Seed {
    bool active = false;
    int place = -1;
    std::uint32_t keyframe_id = 0;
    KeyframeFeature feature;
    DepthEstimate estimate;
    int misses = 0, matches = 0;
    AgreedDepth agreed;
  };

  void handle_reset(const MapperMessage& m);
  void handle_keyframe(const MapperMessage& m, const SE3& T_cam_world);
  bool place_in_map(const MapperMessage& m, SE3* T_cam_world) const;
  void handle_late_mask(const MapperMessage& m);
  void update_seeds(const MapperMessage& m, const SE3& T_cam_world);
  /// The seed's point, at its mean depth, lies in the picture and beside the mask.
  bool in_view(const Seed& seed, const CoarseMask& mask, const SE3& T_cur_host) const;
  /// Searches a seed that is in view.
  void update_seed(Seed* seed, const rt::PyramidView& pyramid, const CoarseMask& mask, const SE3& T_cur_host,
                   const ReadoutMotion& motion);
  rt::MaskPyramidView spread(const CoarseMask& mask, const rt::PyramidView& pyramid);
  void create_seeds(int place, const MapperMessage& m);
  bool seed_to_point(Seed* seed);
  void find_observations(PointHandle h, int host);
  void adjust(int place);
  void forget_keyframes(int newest);
  int least_useful_keyframe(int newest, bool points) const;
  /// By what the rolling shutter of a picture taken in this motion moves a point that lies here in its camera's
  /// frame.
  Vec2 displacement(const Vec3& p_cam, const ReadoutMotion& motion) const;
  /// Pixel and ray that a global shutter would have given the feature of this keyframe, whose point lies here in its
  /// camera's frame.
  void place_feature(KeyframeFeature* f, const Keyframe& kf, const Vec3& p_cam) const;
  void remove_point(PointHandle h);
  void remove_observation(int place, int feature);

  const CameraModel& camera_;
  MapperOptions options_;
  MapChannel* channel_;
  MapDelta* delta_ = nullptr;
  Map map_;
  std::uint32_t epoch_ = 0;
  std::uint32_t newest_keyframe_id_ = 0;
  std::array<CoarseMask, kMaxKeyframes> masks_;  ///< of the keyframes, by place
  std::unique_ptr<std::uint8_t[]> mask_storage_;
  FeatureDetector detector_;
  BundleAdjuster bundle_;
  std::unique_ptr<std::array<Seed, kMaxSeeds>> seeds_;
  int next_seed_ = 0;
  bool crowded_ = false;      ///< movers cover much of the frame at hand
  double hunger_ = 0.0;       ///< 0: the tracker sees enough points, 1: none
  double sigma_limit_ = 0.0;  ///< converged_sigma, raised while the tracker starves
  MapperReport report_;
  SlotReleases releases_;
};

}  // namespace godwit::vo
