#include "vo_core/tracking/health.h"

#include <algorithm>

namespace godwit::vo {

State Health::step(const FrameEvidence& e) {
  if (e.kind != FrameEvidence::Kind::kSamePicture) t_new_picture_ns_ = e.t_capture_ns;
  switch (e.kind) {
    case FrameEvidence::Kind::kNoMap:
      // Stays INITIALISING. The caller knows best what the initialisation lacks.
      reason_ = {"no map yet", e.measurements, options_.min_measurements};
      break;
    case FrameEvidence::Kind::kFirstMap:
    case FrameEvidence::Kind::kPose:
    case FrameEvidence::Kind::kFound:
      if (e.kind == FrameEvidence::Kind::kFirstMap) flown_ns_ = 0;
      if (e.kind == FrameEvidence::Kind::kPose && !counting_)
        flown_ns_ += std::max<rt::TimeNs>(0, e.t_capture_ns - t_pose_ns_);
      t_pose_ns_ = e.t_capture_ns;
      state_ = State::kTracking;
      reason_ = {e.kind == FrameEvidence::Kind::kFirstMap ? "first map" : "tracking", e.measurements,
                 options_.min_measurements};
      counting_ = false;
      without_pose_ns_ = 0;
      break;
    case FrameEvidence::Kind::kUnproved:
      without_pose(e, {"found in the map, to be confirmed", e.measurements, options_.min_measurements});
      break;
    case FrameEvidence::Kind::kWeak:
      without_pose(e, e.refusal.text[0] != '\0'
                          ? e.refusal
                          : Reason{"a pose of few features, not counted", e.measurements, options_.min_measurements});
      break;
    case FrameEvidence::Kind::kNoPose:
      without_pose(e, e.refusal.text[0] != '\0'
                          ? e.refusal
                          : Reason{"too few features", e.measurements, options_.min_measurements});
      break;
    case FrameEvidence::Kind::kSamePicture:
      // No pose comes of it, but neither is one lost as long as it does not last.
      if (state_ == State::kInitialising || state_ == State::kLost ||
          e.t_capture_ns - t_new_picture_ns_ <= options_.frozen_ns) {
        reason_ = {"the picture is the one before, bit for bit", 0, 0};
      } else {
        without_pose(e, {"the picture is the one before, bit for bit", 0, 0});
      }
      break;
  }
  return state_;
}

void Health::without_pose(const FrameEvidence& e, const Reason& why) {
  if (!counting_) {
    t_first_without_ns_ = t_last_ns_ = e.t_capture_ns;
    without_pose_ns_ = searched_ns_ = 0;
  }
  counting_ = true;
  const bool searched = e.kind != FrameEvidence::Kind::kSamePicture && !e.shows_nothing;
  if (searched) searched_ns_ += std::max<rt::TimeNs>(0, e.t_capture_ns - t_last_ns_);
  t_last_ns_ = std::max(t_last_ns_, e.t_capture_ns);
  without_pose_ns_ = std::max(without_pose_ns_, e.t_capture_ns - t_first_without_ns_);
  reason_ = why;
  // Until the map is found again after all, or another has taken its place.
  if (state_ == State::kLost) return;
  const rt::TimeNs most_ns = e.expected ? options_.give_up_expected_ns : options_.give_up_ns;
  const rt::TimeNs give_up_ns = std::min(most_ns, std::max(flown_ns_, options_.coast_ns));
  if (searched_ns_ >= give_up_ns) {
    state_ = State::kLost;
    reason_ = {"not found in the map for too long, another may begin [ms]",
               static_cast<int>(searched_ns_ / rt::kNsPerMs), static_cast<int>(give_up_ns / rt::kNsPerMs)};
  } else if (e.inertial_pose && (state_ == State::kTracking || state_ == State::kCoasting) &&
             without_pose_ns_ <= options_.coast_ns) {
    state_ = State::kCoasting;
  } else {
    state_ = State::kRelocalising;
  }
}

}  // namespace godwit::vo
