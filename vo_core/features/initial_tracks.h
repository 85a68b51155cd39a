// What the first map is made of: features of the first view followed through the next ones, with their velocities and
// where a global shutter would have seen them. Knows no map and no motion model.
#pragma once

#include <array>
#include <span>
#include <vector>

#include "hal/rt/image.h"
#include "vo_core/features/feature_detector.h"
#include "vo_core/features/klt_tracker.h"
#include "vo_core/geometry/camera_model.h"
#include "vo_core/geometry/geometry.h"
#include "vo_core/geometry/rolling_shutter.h"

namespace godwit::vo {

/// All memory is taken by the constructor; start() and follow() do not allocate. One thread at a time.
class InitialTracks {
 public:
  static constexpr int kMaxTracks = KltTracker::kMaxTracks;
  /// Views since the first that are remembered; when full, every second one is forgotten.
  static constexpr int kHistory = 24;

  /// Where the tracks lay in one view, on the plane z = 1, by their number, freed of what is known of its shake.
  struct View {
    std::array<Vec2, kMaxTracks> xy;
    std::array<Vec2, kMaxTracks> velocity;  ///< per frame interval
    std::array<double, kMaxTracks> row;     ///< -0.5 top .. 0.5 bottom
    double parallax_px = 0;                 ///< the caller's

    /// Where the track would lie had the whole picture been taken when its middle row was: moved along the track's own
    /// way by what a rolling shutter was early or late. Needs no model of the motion.
    Vec2 at_middle_row(std::size_t track, double readout) const {
      return xy[track] - readout * row[track] * velocity[track];
    }
  };

  /// A living track in the latest three views, the newest first, as it was seen: what shook the camera is in there.
  struct InThreeViews {
    std::array<Vec2, 3> xy;     ///< on the plane z = 1
    std::array<double, 3> row;  ///< share of the picture's height
  };

  /// readout: from the first row to the last, in frame intervals.
  InitialTracks(const CameraModel& camera, double readout);

  /// The frame becomes the first view, with at most `wanted` tracks; tracks of coarse levels only where without them
  /// fewer than `enough` were left. Of the motion the shake counts. Returns how many live.
  int start(const rt::PyramidView& frame, const rt::MaskPyramidView& mask, const ReadoutMotion& motion, int wanted,
            int enough);

  /// The next view. Tracks that are lost or enter a masked pixel end; those that live are packed into ref_xy(),
  /// cur_xy() and track_of(), and the view is remembered. Returns how many live; *median_px: of their ways [px].
  int follow(const rt::PyramidView& frame, const rt::MaskPyramidView& mask, const ReadoutMotion& motion,
             double* median_px);

  int frames() const { return frames_; }  ///< since the first view
  int count() const { return count_; }    ///< of living tracks
  /// Of the living tracks: number, and places at the middle row's time in the first and in the latest view (z = 1).
  int track_of(std::size_t living) const { return track_of_[living]; }
  const std::vector<Vec2>& ref_xy() const { return ref_xy_; }
  const std::vector<Vec2>& cur_xy() const { return cur_xy_; }

  /// Of the living tracks, once there are three views; the first among them.
  std::span<const InThreeViews> in_three_views() const {
    return std::span(in_three_).first(frames_ < 2 ? 0 : static_cast<std::size_t>(count_));
  }

  const View& first() const { return first_; }
  int history_count() const { return history_count_; }
  const View& history(int k) const { return history_[k]; }
  View& latest() { return history_[history_count_ - 1]; }

  /// By the track's number: its patch's place in the first and in the latest view [level-0 px], and the level of the
  /// coarser of its corner and its patch.
  Vec2f px_ref(std::size_t track) const;
  Vec2f px_cur(std::size_t track) const;
  int level(std::size_t track) const;

 private:
  bool to_plane(const Vec2f& px, const ReadoutMotion& motion, Vec2* xy) const;
  /// Keeps it as seen in this view.
  void see(std::size_t k, const Vec2f& px);
  double row_of(const Vec2f& px) const { return (static_cast<double>(px.y()) + 0.5) / camera_.height() - 0.5; }
  void drop_coarse(int enough, int* alive);
  void differentiate(std::size_t k, View* newest);

  const CameraModel camera_;
  const double readout_;
  FeatureDetector detector_;
  KltTracker tracker_{KltOptions{}};
  std::vector<Feature> features_;
  std::vector<Vec2f> starts_;
  View first_;
  std::array<Vec2, kMaxTracks> previous_, before_previous_;  ///< xy of the last two frames
  /// By the track's number.
  std::array<InThreeViews, kMaxTracks> seen_;
  std::vector<InThreeViews> in_three_;
  int frames_ = 0;
  std::vector<View> history_;
  int history_count_ = 0;
  int count_ = 0;
  std::array<int, kMaxTracks> track_of_;
  std::vector<Vec2> ref_xy_, cur_xy_;
  std::vector<double> ways_;
};

}  // namespace godwit::vo
