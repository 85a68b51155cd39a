// A box that stands still in the scene, a parked car, gives its pixels back to the odometry.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "detector/box.h"
#include "firmware_app/dynamic/standing_point.h"
#include "firmware_app/pipeline/mask_source.h"
#include "hal/rt/time.h"
#include "vo_core/geometry/camera_model.h"

namespace godwit::app {

struct ParkedLimits {
  rt::TimeNs watched_ns = 2 * rt::kNsPerSecond;  ///< so long a thing must have stood still
  int sightings = 6;                             ///< and been seen so often
  rt::TimeNs window_ns = 5 * rt::kNsPerSecond;   ///< what is older says nothing any more
  rt::TimeNs apart_ns = 100 * rt::kNsPerMs;      ///< sightings closer together are tested, not kept
  rt::TimeNs unseen_ns = rt::kNsPerSecond;       ///< without a sighting for longer: masked again
  double tolerance = 0.12;                       ///< of the box's smaller side: how far its centre may be off
  double least_tolerance_px = 1.5;               ///< boxes jump by a pixel, however small they are
  double depth_factor = 1.5;                     ///< between the thing's depth and that of the scene around it
  double swelling = 0.08;                        ///< what drives along the line of sight keeps its bearing
  float overlap = 0.3F;                          ///< intersection over union, of the same thing in two detections
  int points_around = 4;                         ///< fewest, to know the depth around a box
  float ring_px = 40.F;                          ///< width of the ring around the box, at least
};

/// Follows boxes from detection to detection by their overlap, and says which of them stand. A thing is parked when
/// for ParkedLimits::watched_ns one point of the world explains all its centres, when its depth, where the camera's way
/// lets it be told, is that of the map around it (what drives along with the aircraft has another), and when it did not
/// grow or shrink but for its distance. People are never parked: who stands goes on in a moment. What drives within the
/// line of sight's plane at less than about a third of the camera's own speed (half of it where it comes the other way)
/// cannot be told from a thing at another depth, nor from a parked one. Once found off its place by twice the
/// tolerance, unseen or without a pose for long, or in another map, it has to prove itself anew. Pure logic, the
/// tracker's thread; after construction no allocation; all loops are bounded by the constants below.
class ParkedBoxes {
 public:
  static constexpr int kTracks = 32;
  static constexpr int kSightings = 32;
  static constexpr int kFrames = 32;  ///< back to which a late detection finds its picture's pose
  static constexpr int kPoints = 256;

  /// `may_park[class_id]`: false for people; classes outside may not.
  ParkedBoxes(const vo::CameraModel& camera, std::vector<bool> may_park, const ParkedLimits& limits = {});

  /// Each frame, in order: the boxes known for it, carried from an earlier detection.
  void note_boxes(rt::TimeNs t_capture_ns, std::span<const detector::Box> carried);
  /// The boxes of an earlier frame, if better ones are known by now.
  void correct_boxes(rt::TimeNs t_capture_ns, std::span<const detector::Box> carried);
  /// The frame's pose, if it has one.
  void note_tracked(const TrackedFrame& frame);
  /// A detection on the picture of `t_capture_ns`, one of the last kFrames: writes each box's track, -1 where it is not
  /// followed, and judges anew. One older than the last is left out. A box that is held (Box::missed) keeps its track
  /// and is no sighting.
  void take_detection(rt::TimeNs t_capture_ns, std::span<detector::Box> boxes);

  bool parked(int track) const;

 private:
  struct TrackedBox {
    int track = -1;
    float x0 = 0.F, y0 = 0.F, x1 = 0.F, y1 = 0.F;
  };
  struct Frame {
    rt::TimeNs t_ns = INT64_MIN;
    bool has_pose = false;
    vo::SE3 T_cam_world;
    int box_count = 0, point_count = 0;
    std::array<TrackedBox, kTracks> boxes;
    std::array<SeenPoint, kPoints> points;
  };
  struct Track {
    int id = -1;  ///< -1: free
    bool parked = false, placed = false;
    rt::TimeNs t_seen_ns = 0;      ///< last box
    rt::TimeNs t_sighting_ns = 0;  ///< last one with a pose and a centre
    StandingPoint point;           ///< where placed: what would explain it, though no place could be that
    float width_px = 0.F, height_px = 0.F;
    int count = 0;
    std::array<Sighting, kSightings> sightings;

    std::span<const Sighting> view() const { return std::span(sightings).first(count); }
    void drop_oldest(int n) {
      std::move(sightings.begin() + n, sightings.begin() + count, sightings.begin());
      count -= n;
    }
    void forget() {
      parked = placed = false;
      count = 0;
    }
  };
  struct Scene {
    double inverse_depth = 0.0;
    bool around = false;  ///< of what stands around the box, not of all the picture shows
    bool known = false;
  };

  static void fill(std::span<const detector::Box> carried, Frame* frame);
  Frame* frame_of(rt::TimeNs t_ns);
  Track* track_of(int id);
  Track* new_track();
  Track* match(const Frame& frame, const detector::Box& box, const std::array<bool, kTracks>& taken);
  bool cut_off(const detector::Box& box) const;
  Sighting sighting(const Frame& frame, const detector::Box& box) const;
  Scene scene(const Frame& frame, const detector::Box& box);
  void add(const Sighting& s, Track* track) const;
  void judge(const Scene& scene, Track* track) const;
  double tolerance(const Sighting& s) const;

  const vo::CameraModel camera_;
  const std::vector<bool> may_park_;
  const ParkedLimits limits_;
  std::vector<Frame> frames_;  // a ring; head_ is the next to be written
  int head_ = 0;
  std::vector<Track> tracks_;
  int next_id_ = 0;
  std::uint32_t map_id_ = 0;
  rt::TimeNs t_detection_ns_ = INT64_MIN;
  std::array<float, kPoints> distances_{};
};

}  // namespace godwit::app
