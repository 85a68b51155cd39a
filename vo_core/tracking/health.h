// What the odometry says of itself: INITIALISING -> TRACKING <-> COASTING -> RELOCALISING -> LOST
// (docs/architecture.md). Pure logic: evidence of one frame in, state and its measured reason out. Time is an argument.
#pragma once

#include <cstdint>

#include "hal/rt/time.h"
#include "vo_core/tracking/state.h"

namespace godwit::vo {

/// A figure and the limit that it was measured against. Static text.
struct Reason {
  const char* text = "";
  int value = 0;
  int limit = 0;
};

struct HealthOptions {
  int min_measurements = 20;  ///< image measurements without which a frame does not count (docs/architecture.md)
  rt::TimeNs coast_ns = rt::kNsPerSecond / 2;  ///< longest flight on inertial measurements alone
  /// A picture may be repeated for so long, as recorders and drivers do, before the camera is taken for a frozen one:
  /// until then the next new picture is followed as if nothing had been (TrackerOptions::direct_gap_ns).
  rt::TimeNs frozen_ns = 150 * rt::kNsPerMs;
  /// The old map is searched for so long in pictures that show anything, then a new one may take its place; shorter
  /// where every picture was searched from where the camera should be: what is not found there in 30 pictures is out of
  /// view.
  rt::TimeNs give_up_ns = 5 * rt::kNsPerSecond;
  rt::TimeNs give_up_expected_ns = rt::kNsPerSecond;
  // And in any case no longer than the map has been flown in, though as long as is coasted: who has to choose between
  // going on waiting and paying for what waiting would have saved loses at most twice the least by waiting for just as
  // long as that is worth (the ski rental problem, Karlin et al., Algorithmica 1988). What beginning another map takes
  // is no part of it: that goes on beside the search, and LOST ends with whichever comes first.
};

/// What one frame has shown.
struct FrameEvidence {
  enum class Kind : std::uint8_t {
    kNoMap,        ///< there has never been a map, and this frame did not begin one
    kFirstMap,     ///< this frame began a map
    kPose,         ///< the picture gave a pose that was proved
    kFound,        ///< found in the map again, and proved by this picture alone
    kUnproved,     ///< found in the map again, and not yet confirmed by another frame
    kWeak,         ///< a pose of too few measurements, or too little evidence, to count, good enough to go on from
    kNoPose,       ///< measurements were too few
    kSamePicture,  ///< bit for bit the picture before: a frozen camera, nothing was measured
  };
  Kind kind = Kind::kNoMap;
  int measurements = 0;
  bool inertial_pose = false;  ///< a pose from inertial measurements is at hand
  rt::TimeNs t_capture_ns = 0;
  Reason refusal{};            ///< kNoPose, kWeak: what the pose failed by; without text: measurements were too few
  bool shows_nothing = false;  ///< kNoPose: nothing could have been found in this picture
  bool expected = false;       ///< where the camera should be is known by other means
};

/// One for each tracker. No allocation.
class Health {
 public:
  explicit Health(const HealthOptions& options) : options_(options) {}

  /// Evidence in the order of the frames' times; a time that goes back counts as no time passed.
  State step(const FrameEvidence& e);

  State state() const { return state_; }
  const Reason& reason() const { return reason_; }
  /// Time since the first frame without a pose from its picture; 0 while tracking.
  rt::TimeNs without_pose_ns() const { return without_pose_ns_; }

 private:
  void without_pose(const FrameEvidence& e, const Reason& why);

  HealthOptions options_;
  State state_ = State::kInitialising;
  Reason reason_;
  rt::TimeNs t_new_picture_ns_ = 0;  ///< capture time of the last picture that was a new one
  bool counting_ = false;            ///< since t_first_without_ns_ no picture gave a pose
  rt::TimeNs t_first_without_ns_ = 0;
  rt::TimeNs without_pose_ns_ = 0;
  rt::TimeNs searched_ns_ = 0, t_last_ns_ = 0;
  rt::TimeNs flown_ns_ = 0, t_pose_ns_ = 0;  ///< tracked in this map; capture time of the last pose in it
};

}  // namespace godwit::vo
