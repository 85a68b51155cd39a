#include "vo_core/tracking/tracker.h"

#include <algorithm>
#include <cstring>

#include "vo_core/image/pyramid.h"

namespace godwit::vo {
namespace {
ReprojectorOptions with_shutter(ReprojectorOptions options, const RollingShutter& shutter) {
  options.shutter = shutter;
  return options;
}
}  // namespace

Tracker::Tracker(const CameraModel& camera, const TrackerOptions& options, MapChannel* channel)
    : camera_(camera),
      options_(options),
      channel_(channel),
      map_(std::make_unique<Map>()),
      initializer_(camera_, options.initializer),
      align_(std::make_unique<SparseImageAlign>(camera_, options.align)),
      reprojector_(std::make_unique<Reprojector>(camera_, with_shutter(options.reprojector, options.shutter))),
      relocaliser_(std::make_unique<Relocaliser>(camera_, options.relocaliser)),
      landmarks_(std::make_unique<LandmarkFinder>(camera_, options.landmarks)),
      gate_(camera.width(), camera.height(), options.gate),
      noise_(options.shutter.readout_s > 0.0),
      motion_(options.motion),
      certainty_(options.certainty),
      health_(options.health) {}
Tracker::~Tracker() = default;

std::span<const FrameFeature> Tracker::features() const {
  return std::span(features_).first(feature_count_);
}

double Tracker::scene_depth(const SE3& T_cam_world, double* min_depth) {
  std::array<float, kMaxFrameFeatures> depth;
  int n = 0;
  for (int i = 0; i < feature_count_; ++i) {
    const MapPoint* p = map_->find(features_[i].point);
    if (p) depth[n++] = static_cast<float>((T_cam_world * p->p_world).norm());
  }
  if (n == 0) return median_depth_;
  const auto mid = depth.begin() + n / 2;
  std::nth_element(depth.begin(), mid, depth.begin() + n);
  const float median = *mid;
  *min_depth = 0.7 * static_cast<double>(*std::min_element(depth.begin(), depth.begin() + n));
  return static_cast<double>(median);
}

void Tracker::take_points(SeenPoints* points) const {
  points->count = 0;
  const int step = std::max(1, (feature_count_ + SeenPoints::kMost - 1) / SeenPoints::kMost);
  for (int i = 0; i < feature_count_; i += step) {
    const MapPoint* const p = map_->find(features_[i].point);
    if (p != nullptr) points->at[points->count++] = p->p_world.cast<float>();
  }
}

void Tracker::adopt_features() {
  reprojector_->keep_score(map_.get());
  feature_count_ = map_feature_count_ = 0;
  for (int i = 0; i < match_count_; ++i) {
    if (measurements_[i].inlier) {
      features_[feature_count_++] = features_scratch_[i];
      // Those inside the mask come last.
      if (!features_scratch_[i].shaded) map_feature_count_ = feature_count_;
    } else if (!features_scratch_[i].shaded) {
      MapPoint& point = map_->point(features_scratch_[i].point.index);
      if (point.found > 0) --point.found;
      if (point.missed < 0xffff) ++point.missed;
    }
  }
  for (int i = match_count_; i < match_count_ + rejected_count_; ++i) {
    // Inside the mask a point is hidden rather than moving.
    if (features_scratch_[i].shaded) continue;
    MapPoint& point = map_->point(features_scratch_[i].point.index);
    point.missed = static_cast<std::uint16_t>(std::min(point.missed + options_.gate.strikes, 0xffff));
  }
}

void Tracker::vouch() {
  for (int i = 0; i < match_count_; ++i)
    if (measurements_[i].inlier) map_->point(features_scratch_[i].point.index).vouched = true;
}

void Tracker::consider_keyframe(Frame* frame, FrameResult* result) {
  const rt::TimeNs t0 = now();
  ++frames_since_keyframe_;
  KeyframeFigures f;
  f.frames_since_last = frames_since_keyframe_;
  f.features = result->measurements;
  f.last_keyframe_features = last_keyframe_features_;
  f.uncovered = keyframe_mask_.uncovered(frame->mask);
  compare_with_keyframes(options_.keyframe, *map_, frame->T_cam_world, median_depth_, last_keyframe_id_, &f);
  KeyframeReason why = select_keyframe(options_.keyframe, f);
  // A keyframe that hardly hangs on the map would move as it likes in the bundle adjustment.
  if (!result->tracked && map_feature_count_ < options_.mapped_beside) why = KeyframeReason::kNone;
  // Between movers nothing is mapped by a pose that the vouched points speak against as clearly as others speak for
  // one.
  const bool contradicted = untold_ > 0 && vouched_ < -options_.promising;
  if (contradicted) why = KeyframeReason::kNone;
  result->keyframe_reason = why;
  bool sent = false;
  if (why != KeyframeReason::kNone && room() >= 1) {
    const std::uint32_t id = next_keyframe_id_;
    const int place = insert_keyframe(*frame, id);
    if (place >= 0) {
      sent = send(MessageKind::kKeyframe, frame, id, place);
      certainty_.keyframe(place, result->covariance);
      ++next_keyframe_id_;
      last_keyframe_id_ = id;
      frames_since_keyframe_ = 0;
      last_keyframe_features_ = result->measurements;
      keyframe_mask_.assign(frame->mask);
      result->is_keyframe = true;
    }
  }
  // Ordinary frames are sent only while there is room left for keyframes.
  if (!sent && !contradicted && room() >= 4) send(MessageKind::kFrame, frame, 0, -1);
  result->times.keyframe = now() - t0;
}

bool Tracker::same_picture(const rt::ImageView& picture) {
  // Every eighth row, eight bytes at a time: a sensor's noise changes some of them in any two pictures. Four sums
  // beside each other, since each waits for its last product.
  constexpr int kSums = 4, kStep = 8 * kSums;
  std::array<std::uint64_t, kSums> sums{1, 2, 3, 4};
  const auto mix = [](std::uint64_t sum, std::uint64_t eight) {
    sum = (sum ^ eight) * 0x9e3779b97f4a7c15ULL;
    return sum ^ (sum >> 29);
  };
  for (int y = 0; y < picture.height; y += 8) {
    const std::uint8_t* row = picture.row(y);
    int x = 0;
    for (; x + kStep <= picture.width; x += kStep) {
      std::array<std::uint64_t, kSums> eight;
      std::memcpy(eight.data(), row + x, kStep);
      for (int k = 0; k < kSums; ++k) sums[k] = mix(sums[k], eight[k]);
    }
    for (; x + 8 <= picture.width; x += 8) {
      std::uint64_t eight;
      std::memcpy(&eight, row + x, 8);
      sums[0] = mix(sums[0], eight);
    }
  }
  std::uint64_t hash = 0xcbf29ce484222325ULL;
  for (const std::uint64_t sum : sums) hash = mix(hash, sum);
  const bool same = have_picture_hash_ && hash == picture_hash_;
  picture_hash_ = hash;
  have_picture_hash_ = true;
  return same;
}

FrameResult Tracker::track(const FrameInput& in) {
  FrameResult result;
  ++frame_counter_;
  rt::TimeNs t0 = now();
  Frame frame;
  frame.slot = in.slot;
  frame.holds_mapper_reference = true;
  frame.sequence = in.sequence;
  frame.counter = frame_counter_;
  frame.t_capture_ns = in.t_capture_ns;
  frame.mask = in.mask;
  frame.crowded = covered_share(in.mask) > options_.crowded;
  if (expects(in)) frame.expected = in.expected;
  shake_.fill(in.shake, &frame.motion);
  frame.pyramid = build_pyramid(in.grey, rt::kPyramidLevels, in.pyramid_storage, in.pyramid_bytes);
  // The half-size picture is in the cache already, and a fourth as large.
  const bool same = same_picture(frame.pyramid.level[1]);
  rt::TimeNs t1 = now();
  result.times.pyramid = t1 - t0;
  room();
  apply_deltas(&result);
  t0 = now();
  result.times.apply = t0 - t1;

  FrameEvidence evidence;
  evidence.t_capture_ns = in.t_capture_ns;
  if (same) {
    evidence.kind = FrameEvidence::Kind::kSamePicture;
    result.repeated = true;
    retire(&frame);
  } else if (!have_map()) {
    evidence.kind = initialise(in, frame, true, &result) ? FrameEvidence::Kind::kFirstMap : FrameEvidence::Kind::kNoMap;
    result.times.initialise = now() - t0;
  } else {
    // Given up, the map is searched for in every second frame only, and in the others it is tried to begin another.
    const bool searched = health_.state() != State::kLost || unproved_ > 0 || frame_counter_ % 2 == 0;
    evidence.kind = searched ? locate(in, &frame, &result) : FrameEvidence::Kind::kNoPose;
    evidence.expected = frame.expected.known;
    if (evidence.kind == FrameEvidence::Kind::kNoPose) {
      evidence.shows_nothing = shows_nothing(frame.pyramid);
      // What is not found at once may be gone: another map begins beside the search for this one.
      t0 = now();
      if (in.t_capture_ns - seen_.t_capture_ns <= options_.direct_gap_ns) {
        retire(&frame);
      } else if (initialise(in, frame, health_.state() == State::kLost && !searched, &result)) {
        evidence.kind = FrameEvidence::Kind::kFirstMap;
      }
      result.times.initialise = now() - t0;
    } else {
      if (evidence.kind == FrameEvidence::Kind::kPose) forget_first_view();
      take_pose(evidence.kind, in, &frame, &result);
    }
  }
  evidence.measurements = result.measurements;
  evidence.refusal = refusal_;
  const State before = health_.state();
  result.state = health_.step(evidence);
  // An initialisation that failed has told why itself.
  const bool told = evidence.kind == FrameEvidence::Kind::kNoMap ||
                    (evidence.kind == FrameEvidence::Kind::kNoPose && before == State::kLost);
  if (!told) {
    const Reason& reason = health_.reason();
    result.reason = reason.text;
    result.reason_value = reason.value;
    result.reason_limit = reason.limit;
  }
  if (result.tracked && 2 * result.shaded > result.matches) {
    result.reason = "tracking, mostly by proved points inside the mask";
    result.reason_value = result.shaded;
    result.reason_limit = result.matches;
  }
  result.map_id = result.state == State::kInitialising || result.state == State::kLost ? 0 : map_id_;
  result.order = order_;
  expected_ = order_ = {};
  room_ = -1;
  return result;
}

void Tracker::take_pose(FrameEvidence::Kind kind, const FrameInput& in, Frame* frame, FrameResult* result) {
  if (kind != FrameEvidence::Kind::kUnproved) {
    retire(&followed_);
  } else if (unproved_ == 0) {
    keep_followed();
  }
  adopt_features();
  if (frame->crowded) landmarks_->learn(*map_, options_.landmarks.described_a_tracked_frame);
  using Kind = FrameEvidence::Kind;
  if (kind != Kind::kUnproved) {
    result->tracked = kind == Kind::kPose || kind == Kind::kFound;
    // All that was looked for must agree as well: where one who had stood still walks off, half of it goes on.
    if (result->tracked && vouched_ >= options_.held && evidence_ >= options_.most_evidence) vouch();
    result->T_world_cam = frame->T_cam_world.inverse();
    const FrameCovariance own =
        noise_.covariance(camera_, std::span(measurements_).first(match_count_), frame->T_cam_world, weight_scale_);
    if (result->tracked)
      shake_.learn(camera_, std::span(measurements_).first(match_count_), frame->T_cam_world, weight_scale_,
                   noise_.correlated(), in.shake, frame->motion);
    result->own_covariance = own.noise + own.strayed;
    result->relative = certainty_.relative(*map_, frame->T_cam_world, frame->t_capture_ns, own.noise, own.strayed);
    result->covariance = certainty_.in_map(*map_, result->relative);
    median_depth_ = scene_depth(frame->T_cam_world, &min_depth_);
    result->median_depth = median_depth_;
    take_points(&result->points);
  }
  if (kind == Kind::kPose || kind == Kind::kWeak) {
    const double dt = rt::to_seconds(frame->t_capture_ns - last_.t_capture_ns);
    // Of the poses as measured, not as aligned.
    if (dt > 0.0) frame->motion.velocity = (frame->T_cam_world * last_.T_cam_world.inverse()).log() / dt;
    frame->velocity_known = dt > 0.0;
    if (frame->goes_on) {
      motion_.measured(frame->predicted, frame->T_cam_world, with_prior_);
    } else {
      motion_.begin(frame->motion.velocity, with_prior_, median_depth_);
    }
    consider_keyframe(frame, result);
    relocalise_attempt_ = 0;
    if (kind == Kind::kPose) seen_ = {frame->T_cam_world, frame->t_capture_ns, true};
  } else {
    // How fast the camera moves is known from where it was seen last, too roughly for a rolling shutter's keyframe,
    // well enough to look there in the next picture where light changes from row to row (locate()).
    const rt::TimeNs gap = frame->t_capture_ns - seen_.t_capture_ns;
    frame->velocity_known = seen_.known && gap > 0 && gap <= options_.last_frame_gap_ns;
    if (frame->velocity_known)
      frame->motion.velocity = (frame->T_cam_world * seen_.T_cam_world.inverse()).log() / rt::to_seconds(gap);
    ++unproved_;
  }
  retire(&last_);
  last_ = *frame;
  last_.mask = {};
}

}  // namespace godwit::vo
