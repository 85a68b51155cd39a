// The tracker with a map: the pose of a frame, from the last frame, from a keyframe or from what points look like, and
// whether it may be believed.
#include <algorithm>
#include <cmath>

#include "vo_core/features/match_noise.h"
#include "vo_core/tracking/pose_evidence.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::vo {
namespace {
/// Of the inliers, chi-square over its limit.
double misfit(const PoseOptimizerResult& fit) {
  return fit.chi_square / chi_square_limit(fit.freedom);
}
}  // namespace

bool Tracker::align_with_last(const FrameInput& in, Frame* frame, const SE3& T_cur_last_guess, FrameResult* result) {
  const rt::TimeNs t0 = now();
  int n = 0;
  for (int i = 0; i < feature_count_; ++i) {
    const MapPoint* p = map_->find(features_[i].point);
    if (!p) continue;
    align_points_[n++] = {features_[i].px, last_.T_cam_world * p->p_world};
  }
  SE3 T_cur_last = T_cur_last_guess;
  // What an IMU has measured since the picture before belongs to the last frame only if that is the picture before.
  const RotationPrior prior = last_.counter + 1 == frame_counter_ ? in.rotation : RotationPrior{};
  const double dt = rt::to_seconds(frame->t_capture_ns - last_.t_capture_ns);
  const AlignShutter shutter{dt > 0.0 ? options_.shutter.readout_s / dt : 0.0, options_.shutter.reference,
                             frame->motion.shakes ? &frame->motion.shake : nullptr};
  if (n >= 15)
    T_cur_last =
        align_->run(last_.pyramid, frame->pyramid, std::span(align_points_.data(), n), T_cur_last_guess, prior, shutter)
            .T_cur_ref;
  frame->T_cam_world = T_cur_last * last_.T_cam_world;
  // Velocity over the interval since the last frame: what the readout of this one sees.
  frame->motion.velocity = dt > 0.0 ? Vec6(T_cur_last.log() / dt) : Vec6::Zero();
  result->times.align += now() - t0;
  return n >= 15;
}

bool Tracker::align_with_keyframe(const RelocalisationGuess& guess, Frame* frame) {
  int n = 0;
  if (guess.place >= 0) {
    const Keyframe& kf = map_->keyframe(guess.place);
    for (int i = 0; i < kf.feature_count && n < kMaxFrameFeatures; ++i) {
      const MapPoint* p = map_->find(kf.features[i].point);
      if (p) align_points_[n++] = {kf.features[i].px, kf.T_kf_world * p->p_world};
    }
    if (n >= 15)
      frame->T_cam_world =
          align_->run(kf.pyramid, frame->pyramid, std::span(align_points_.data(), n), guess.T_cur_kf, RotationPrior{})
              .T_cur_ref *
          kf.T_kf_world;
  }
  frame->motion.velocity.setZero();
  if (n < 15) refusal_ = {"no keyframe to begin with, points in it", n, 15};
  return n >= 15;
}

bool Tracker::look_where_expected(const PosePrior& expected, Frame* frame, FrameResult* result) {
  const rt::TimeNs t0 = now();
  const RelocalisationGuess guess = relocaliser_->expect(*map_, expected.T_cam_map);
  const bool found = align_with_keyframe(guess, frame);
  result->times.align += now() - t0;
  return found;
}

bool Tracker::look_for_likeness(int attempt, Frame* frame, FrameResult* result) {
  const rt::TimeNs t0 = now();
  const bool found = align_with_keyframe(relocaliser_->guess(*map_, frame->pyramid, frame->mask, attempt), frame);
  result->times.align += now() - t0;
  return found;
}

bool Tracker::recognise_landmarks(int attempt, bool near, Frame* frame, FrameResult* result) {
  const rt::TimeNs t0 = now();
  const LastSeen last{seen_.T_cam_world, rt::to_seconds(frame->t_capture_ns - seen_.t_capture_ns)};
  const LandmarkReport found =
      landmarks_->find(*map_, frame->pyramid, frame->mask, attempt, near && seen_.known ? &last : nullptr);
  if (found.found) frame->T_cam_world = found.T_cam_world;
  if (!found.found) refusal_ = {"too few landmarks recognised", found.agreeing, options_.landmarks.min_agreeing};
  frame->motion.velocity.setZero();
  result->times.align += now() - t0;
  return found.found;
}

PoseOptimizerResult Tracker::fit_pose(int matches, Frame* frame) {
  const std::span measured(measurements_.data(), static_cast<std::size_t>(matches));
  const PoseOptimizerResult p = optimize_pose(camera_, options_.pose, measured, &frame->T_cam_world, frame->predicted);
  frame->goes_on = frame->predicted.known && p.ok && misfit(p) <= options_.noise_allowance;
  if (frame->goes_on || !frame->predicted.known) return p;
  // The picture has it that the camera was pushed, or shaken: then nothing is known of how it moves.
  return optimize_pose(camera_, options_.pose, measured, &frame->T_cam_world);
}

bool Tracker::measure(const FrameInput& in, bool coarser, Frame* frame, FrameResult* result) {
  rt::TimeNs t0 = now();
  std::array<FrameFeature, kMaxFrameFeatures>& found = features_scratch_;
  const int wanted = static_cast<int>(in.feature_share * options_.reprojector.max_features);
  const ReprojectionResult r =
      reprojector_->run(map_.get(), frame->pyramid, in.mask, frame->T_cam_world, frame->motion, coarser,
                        ++reprojection_mark_, std::max(wanted, 2 * options_.health.min_measurements), found.data());
  result->matches = r.matches;
  result->shaded = r.shaded;
  result->trials = r.trials;
  result->candidates = r.candidates;
  rt::TimeNs t1 = now();
  result->times.reproject += t1 - t0;

  const double shaken = std::sqrt(1.0 + noise_.shake());
  for (int i = 0; i < r.matches; ++i) {
    PoseMeasurement& m = measurements_[i];
    m.p_world = map_->point(found[i].point.index).p_world;
    found[i].px_global =
        global_pixel(options_.shutter, camera_, found[i].px, frame->T_cam_world * m.p_world, frame->motion);
    m.px = found[i].px_global.cast<double>();
    m.gradient = found[i].gradient.cast<double>();
    m.type = found[i].type;
    m.sigma_px = match_sigma_px(found[i].level) * shaken * (found[i].shaded ? options_.shaded_sigma : 1.0);
  }
  match_count_ = r.matches;
  PoseOptimizerResult p = fit_pose(r.matches, frame);
  rejected_count_ = 0;
  if (options_.gate.on && p.ok) {
    const std::size_t all = r.matches;
    const int left = gate_.run({found.data(), all}, {measurements_.data(), all});
    if (left < r.matches) {
      match_count_ = result->matches = left;
      rejected_count_ = r.matches - left;
      result->shaded = static_cast<int>(
          std::count_if(found.begin(), found.begin() + left, [](const FrameFeature& f) { return f.shaded; }));
      p = fit_pose(left, frame);
    }
  }
  result->times.pose += now() - t1;
  result->measurements = p.ok ? p.inliers : 0;
  result->rms_px = p.rms_px;
  weight_scale_ = p.weight_scale;
  with_prior_ = p.with_prior;
  refusal_ = {};
  result->misfit = p.ok ? misfit(p) : 0.0;
  evidence_ = pose_evidence(p, r.matches, r.trials - (r.matches - r.shaded));
  vouched_ = (frame->crowded || untold_ > 0) && p.ok ? evidence_of_vouched() : evidence_;
  const int least = frame->goes_on ? options_.least_beside_prior : options_.least_measurements;
  return result->measurements >= least && as_noisy_as_stated(*result);
}

double Tracker::evidence_of_vouched() const {
  PoseOptimizerResult fit;
  fit.ok = true;
  fit.freedom = -6;
  int found = 0;
  for (int i = 0; i < match_count_ + rejected_count_; ++i) {
    const PoseMeasurement& m = measurements_[i];
    if (!map_->point(features_scratch_[i].point.index).vouched) continue;
    ++found;
    if (i >= match_count_ || !m.inlier) continue;
    ++fit.inliers;
    fit.freedom += m.type == FeatureType::kEdgelet ? 1 : 2;
    fit.chi_square += m.error * m.error;
  }
  return pose_evidence(fit, found, 0);
}

bool Tracker::as_noisy_as_stated(const FrameResult& r) {
  if (r.misfit <= options_.noise_allowance) return true;
  refusal_ = {"the measurements disagree, chi-square over its limit is [%]", static_cast<int>(100.0 * r.misfit),
              static_cast<int>(100.0 * options_.noise_allowance)};
  return false;
}

bool Tracker::proves(double wanted, double evidence) {
  if (evidence >= wanted) return true;
  refusal_ = {"too little speaks for the pose [nats]", static_cast<int>(evidence), static_cast<int>(wanted)};
  return false;
}

bool Tracker::as_expected(const Frame& frame) {
  const PosePrior& e = frame.expected;
  if (!e.known) return true;
  const SE3 apart = e.T_cam_map * frame.T_cam_world.inverse();
  const double sigmas = options_.most_expected_sigmas;
  const double places =
      apart.t.norm() / std::max(sigmas * e.place_sigma, options_.expected_depth_share * median_depth_);
  const double turns = so3_log(apart.R).norm() / std::max(sigmas * e.turn_sigma_rad, options_.expected_turn_rad);
  const double off = std::max(places, turns);
  if (off <= 1.0) return true;
  refusal_ = {"looks alike, but the camera cannot be there: of what is possible [%]",
              static_cast<int>(std::min(1e6, 100.0 * off)), 100};
  return false;
}

bool Tracker::told_between_movers(const Frame& frame) {
  const double by_motion = frame.goes_on ? frame.predicted.evidence(frame.T_cam_world) : 0.0;
  // At most half of it by how the camera moved: a mover that is followed goes on evenly, too.
  return proves(options_.told, vouched_ + std::min(0.5 * options_.told, by_motion));
}

bool Tracker::find_in_map(const FrameInput& in, Frame* frame, FrameResult* result) {
  // Where the camera should be, if anyone knows, in turns with what looks like a keyframe. Between movers, who spoil
  // that, points of the map near their places, in turns with keyframes and, where none resembles the picture, points
  // anywhere. First a rough pose, then all of the map around it.
  const bool expected = frame->expected.known;
  const bool there = expected && relocalise_attempt_ % 2 == 0;
  const int attempt = expected ? relocalise_attempt_++ / 2 : relocalise_attempt_++;
  // What an attempt before this one has seen is not told as this one's.
  refusal_ = {};
  frame->predicted = {};
  result->measurements = result->matches = result->shaded = result->trials = result->candidates = 0;
  const bool guessed = there              ? look_where_expected(frame->expected, frame, result)
                       : !frame->crowded  ? look_for_likeness(attempt, frame, result)
                       : attempt % 2 == 0 ? recognise_landmarks(attempt / 2, true, frame, result)
                                          : look_for_likeness(attempt / 2, frame, result) ||
                                                recognise_landmarks(attempt / 2, false, frame, result);
  if (!guessed || !measure(in, false, frame, result) || !measure(in, false, frame, result)) return false;
  if (!proves(options_.promising, evidence_) || !as_expected(*frame)) return false;
  frame->gathered = std::min(options_.most_evidence, evidence_);
  return true;
}

bool Tracker::find_beside(const FrameInput& in, Frame* frame, FrameResult* result) {
  const PosePrediction predicted = frame->predicted;
  if (find_in_map(in, frame, result) && proves(options_.told, vouched_)) return true;
  frame->predicted = predicted;
  return false;
}

FrameEvidence::Kind Tracker::found(const FrameResult& r) {
  // A second look at the same place would see what this one has: a pattern that repeats does so in both.
  const bool sure = r.measurements >= options_.health.min_measurements && evidence_ >= options_.most_evidence &&
                    proves(options_.told, vouched_);
  return sure ? FrameEvidence::Kind::kFound : FrameEvidence::Kind::kUnproved;
}

bool Tracker::look_near_last(const FrameInput& in, const SE3& guess, bool near, Frame* frame, FrameResult* result) {
  align_with_last(in, frame, guess, result);
  const SE3 T_aligned = frame->T_cam_world;
  const Vec6 aligned_velocity = frame->motion.velocity;
  const bool coarser = near && feature_count_ < options_.plenty;
  const bool held = measure(in, coarser, frame, result) && as_expected(*frame);
  if ((held && evidence_ >= options_.held) || !near || !last_.velocity_known) return held;
  // Where light changes from row to row the pictures may not be laid on each other at all, and where a mover fills them
  // they are laid on the mover. Points are found all the same, each with a gain of its own, from where the motion goes
  // on as it was; that is a guess, and must convince.
  frame->T_cam_world = guess * last_.T_cam_world;
  frame->motion.velocity = last_.motion.velocity;
  if (measure(in, coarser, frame, result) && proves(options_.sure, evidence_) && as_expected(*frame)) return true;
  if (!held) return false;
  frame->T_cam_world = T_aligned;
  frame->motion.velocity = aligned_velocity;
  return measure(in, coarser, frame, result) && as_expected(*frame);
}

FrameEvidence::Kind Tracker::locate(const FrameInput& in, Frame* frame, FrameResult* result) {
  using Kind = FrameEvidence::Kind;
  const rt::TimeNs gap = frame->t_capture_ns - last_.t_capture_ns;
  const bool beside = unproved_ == 0 && untold_ > 0 && untold_ % 2 == 0;
  if (last_.slot >= 0 && gap <= options_.last_frame_gap_ns) {
    // Constant velocity, over as much time as has passed; after a gap the camera may have done anything, unless someone
    // else has watched it.
    const bool near = gap <= options_.direct_gap_ns;
    if (near && unproved_ == 0) {
      frame->predicted = motion_.predict(last_.T_cam_world, rt::to_seconds(gap), median_depth_);
      frame->predicted.correlated = noise_.correlated();
    }
    SE3 guess;
    if (frame->predicted.known) {
      guess = frame->predicted.T_cam_world * last_.T_cam_world.inverse();
    } else if (last_.velocity_known && near && gap > 0) {
      guess = SE3::exp(last_.motion.velocity * rt::to_seconds(gap));
    } else if (frame->expected.known) {
      guess =
          frame->expected.T_cam_map * (last_.expected.known ? last_.expected.T_cam_map : last_.T_cam_world).inverse();
    }
    if (beside && find_beside(in, frame, result)) return found(*result);
    if (look_near_last(in, guess, near, frame, result)) {
      const bool followed = near && unproved_ == 0;
      const double before = near || unproved_ > 0 ? last_.gathered : 0.0;
      const double gathered = std::min(options_.most_evidence, before + std::max(evidence_, options_.worst_frame));
      // After a gap it takes a second look, unless the camera was expected here: then there are two witnesses.
      const bool first_look = !near && unproved_ == 0 && !frame->expected.known;
      if (!first_look && proves(followed || frame->expected.known ? options_.held : options_.sure, gathered)) {
        unproved_ = 0;
        frame->gathered = gathered;
        // A picture that is blurred or lit otherwise speaks against all its points alike, and is right; but between
        // movers what a pose agrees with may be one of them, whose motion is another.
        const bool enough = result->measurements >= options_.health.min_measurements;
        // Nor does what was mapped by poses that nothing vouched for prove more when the movers are gone.
        const bool vouching = frame->crowded || untold_ > 0;
        const bool told = enough && (!vouching || told_between_movers(*frame));
        untold_ = told || !vouching || vouched_ >= options_.told ? 0 : untold_ + 1;
        return told ? Kind::kPose : Kind::kWeak;
      }
      if (unproved_ < options_.unproved_frames && proves(options_.promising, gathered)) {
        frame->gathered = gathered;
        return found(*result);
      }
    }
    if (unproved_ > 0) go_back_to_followed();
  } else if (find_in_map(in, frame, result)) {
    return found(*result);
  }
  // One search a frame: it costs as much as ten poses that are followed.
  return !beside && find_in_map(in, frame, result) ? found(*result) : Kind::kNoPose;
}

}  // namespace godwit::vo
