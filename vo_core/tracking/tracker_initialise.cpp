// The tracker without a map, or beside one that it does not find: from the first view to the first two keyframes.
#include <algorithm>

#include "vo_core/features/match_noise.h"
#include "vo_core/map/matcher.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::vo {
namespace {
constexpr float kMaxTrackErrorPx = 2.0f;
/// Half of what a track's place in a picture is taken to be off by: InitializerOptions::sigma_px
constexpr double kMostShakeOffPx = 0.25;

/// Why no map began; no text: one did.
Reason refusal(const InitReport& init, const InitializerOptions& limits) {
  const auto hundredths = [](double share) { return static_cast<int>(100.0 * share); };
  switch (init.status) {
    case InitStatus::kFirstFrame:
      return Reason{"first view"};
    case InitStatus::kTooFewFeatures:
      return Reason{"too few features in the first view", init.tracks, limits.min_tracks};
    case InitStatus::kTracksLost:
      return Reason{"too few tracks left, new first view", init.tracks, limits.min_tracks};
    case InitStatus::kNoMotion:
      return Reason{"disparity too small [px]", static_cast<int>(init.median_disparity_px),
                    static_cast<int>(limits.min_disparity_px)};
    case InitStatus::kNoParallax:
      return Reason{"parallax too small [0.01 deg]", hundredths(init.median_parallax_deg),
                    hundredths(limits.min_parallax_deg)};
    case InitStatus::kNoModel:
      return Reason{"neither homography nor fundamental matrix fits", init.inliers, limits.min_points};
    case InitStatus::kAmbiguous:
      return Reason{"two motions explain the tracks alike [0.01]", hundredths(init.ambiguity),
                    hundredths(limits.max_ambiguity)};
    case InitStatus::kTurnOrWay:
      return Reason{"a turn or a way? the tracks are too near each other, baseline uncertain by [%]",
                    hundredths(init.baseline_uncertainty), hundredths(limits.max_baseline_uncertainty)};
    case InitStatus::kTwoMotions:
      return Reason{"two things move, of the larger the smaller is [%]", hundredths(init.second_motion),
                    hundredths(limits.max_second_motion)};
    case InitStatus::kDone:
      break;
  }
  return {};
}
}  // namespace

bool Tracker::initialise(const FrameInput& in, const Frame& frame, bool may_begin, FrameResult* result) {
  if (reset_pending_ && !have_map() && !send_reset()) {
    result->reason = "mapper is still busy with the last map";
    Frame f = frame;
    retire(&f);
    return false;
  }
  // A first view that was freed of another shake than is known by now is none: the next one is better.
  if (first_.slot >= 0 && shake_.off(first_shake_, first_.motion) > kMostShakeOffPx * camera_.rad_per_px())
    forget_first_view();
  result->init = initializer_.add_frame(frame.pyramid, in.mask, may_begin, frame.motion);
  shakes_ = {in.shake, shakes_[0], shakes_[1]};
  shake_.learn(initializer_.in_three_views(), shakes_);
  Frame current = frame;
  const Reason reason = refusal(result->init, options_.initializer);
  result->reason = reason.text;
  result->reason_value = reason.value;
  result->reason_limit = reason.limit;
  if (result->init.status == InitStatus::kFirstFrame || result->init.status == InitStatus::kTracksLost ||
      result->init.status == InitStatus::kTooFewFeatures) {
    retire(&first_);
    first_ = current;
    first_mask_.assign(in.mask);
    first_shake_ = in.shake;
    first_.mask = {};
    return false;
  }
  if (result->init.status != InitStatus::kDone) {
    retire(&current);
    return false;
  }

  // The order to forget the old map and both keyframes must find room, or nothing is sent.
  if (room() < (have_map() ? 3 : 2)) {
    retire(&current);
    if (!have_map()) begin_map();
    result->reason = "mapper is still busy with the last map";
    return false;
  }
  if (have_map()) {
    drop_map();
    send_reset();
  }
  // Two keyframes and their common points. World frame: the first view's camera.
  const std::span<const InitPoint> points = initializer_.points();
  const int n = static_cast<int>(std::min<std::size_t>(points.size(), kMaxFrameFeatures - 20));
  first_.T_cam_world = SE3();
  current.T_cam_world = initializer_.T_cur_ref();
  // How fast the camera was matters to a rolling shutter only, and by that the frames' interval is known.
  const double interval_s =
      options_.initializer.readout > 0.0 ? options_.shutter.readout_s / options_.initializer.readout : 0.0;
  if (interval_s > 0.0) {
    first_.motion.velocity = initializer_.velocity_ref() / interval_s;
    current.motion.velocity = initializer_.velocity_cur() / interval_s;
  }
  median_depth_ = 1.0;
  feature_count_ = map_feature_count_ = n;
  for (int i = 0; i < n; ++i) {
    // Evenly out of all, whatever their order.
    const InitPoint& p = points[i * points.size() / n];
    FrameFeature& f = features_[i];
    f = {};
    f.px = p.px_ref;
    f.px_global = p.px_ref_global;
    f.level = p.level;
    f.point = {static_cast<std::uint16_t>(i), map_->point(i).generation};
    // As the message has it: the two maps are equal to the bit.
    map_->activate_point(f.point, p.p_ref.cast<float>().cast<double>());
    map_->point(f.point.index).vouched = true;
  }
  median_depth_ = scene_depth(first_.T_cam_world, &min_depth_);
  const int place1 = insert_keyframe(first_, 1);
  send(MessageKind::kKeyframe, &first_, 1, place1);
  for (int i = 0; i < n; ++i) {
    const InitPoint& p = points[i * points.size() / n];
    FrameFeature& f = features_[i];
    f.px = p.px_cur;
    f.px_global = p.px_cur_global;
    // The track knew nothing of how the patch turns and stretches between the two views; the map does.
    const PatchSource source{&first_.pyramid, &map_->keyframe(place1).features[i], p.p_ref.norm()};
    const MatchResult m =
        match_direct(camera_, source, current.T_cam_world, current.pyramid, p.px_cur, options_.reprojector.max_level);
    if (!m.found || (m.px - p.px_cur).norm() > kMaxTrackErrorPx) continue;
    f.px = m.px;
    f.px_global += m.px - p.px_cur;
    f.level = static_cast<std::int8_t>(m.level);
  }
  median_depth_ = scene_depth(current.T_cam_world, &min_depth_);
  const int place2 = insert_keyframe(current, 2);
  send(MessageKind::kKeyframe, &current, 2, place2);
  next_keyframe_id_ = 3;
  last_keyframe_id_ = 2;
  frames_since_keyframe_ = 0;
  last_keyframe_features_ = n;
  keyframe_mask_.assign(current.mask);
  forget_first_view();
  last_ = current;
  last_.gathered = options_.most_evidence;
  last_.mask = {};
  seen_ = {current.T_cam_world, current.t_capture_ns, true};
  last_.velocity_known = interval_s > 0.0;
  ++map_id_;
  result->tracked = n >= options_.health.min_measurements;
  result->is_keyframe = true;
  result->measurements = result->matches = n;
  result->T_world_cam = current.T_cam_world.inverse();
  // The pose stands as the initialisation gave it; its covariance is that of its measurements against the first points.
  for (int i = 0; i < n; ++i) {
    PoseMeasurement& m = measurements_[i];
    m = {};
    m.px = features_[i].px_global.cast<double>();
    m.p_world = map_->point(features_[i].point.index).p_world;
    m.sigma_px = match_sigma_px(features_[i].level);
  }
  SE3 refined = current.T_cam_world;
  const PoseOptimizerResult fit = optimize_pose(camera_, options_.pose, std::span(measurements_.data(), n), &refined);
  result->own_covariance = fit.ok ? fit.covariance : Mat6::Identity();
  result->relative =
      certainty_.relative(*map_, current.T_cam_world, current.t_capture_ns, result->own_covariance, Mat6::Zero());
  result->covariance = certainty_.in_map(*map_, result->relative);
  certainty_.keyframe(place2, result->covariance);
  result->rms_px = fit.rms_px;
  result->median_depth = median_depth_;
  result->reason =
      result->init.model == InitModel::kHomography ? "first map, homography" : "first map, fundamental matrix";
  result->reason_value = n;
  result->reason_limit = options_.health.min_measurements;
  return true;
}

}  // namespace godwit::vo
