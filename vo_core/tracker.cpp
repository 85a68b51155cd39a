#include "vo_core/tracker.h"

#include <algorithm>
#include <cmath>

#include "vo_core/pyramid.h"

namespace godwit::vo {
namespace {
ReprojectorOptions with_shutter(ReprojectorOptions options, const RollingShutter& shutter) {
  options.shutter = shutter;
  return options;
}
}  // namespace

const char* state_name(State s) {
  switch (s) {
    case State::kInitialising:
      return "INITIALISING";
    case State::kTracking:
      return "TRACKING";
    case State::kCoasting:
      return "COASTING";
    case State::kRelocalising:
      return "RELOCALISING";
    case State::kLost:
      return "LOST";
  }
  return "?";
}

Tracker::Tracker(const CameraModel& camera, const TrackerOptions& options, MapChannel* channel)
    : camera_(camera),
      options_(options),
      channel_(channel),
      map_(std::make_unique<Map>()),
      initializer_(camera_, options.initializer),
      align_(std::make_unique<SparseImageAlign>(camera_, options.align)),
      reprojector_(std::make_unique<Reprojector>(camera_, with_shutter(options.reprojector, options.shutter))) {}
Tracker::~Tracker() = default;

std::span<const FrameFeature> Tracker::features() const {
  return {features_.data(), static_cast<std::size_t>(feature_count_)};
}

void Tracker::release(int slot, int count) {
  if (slot >= 0 && release_count_ < static_cast<int>(releases_.size())) releases_[release_count_++] = {slot, count};
}

bool Tracker::take_release(SlotRelease* out) {
  if (release_count_ == 0) return false;
  *out = releases_[--release_count_];
  return true;
}

void Tracker::retire(Frame* frame) {
  if (frame->slot < 0) return;
  // A keyframe keeps the tracker's own reference until the keyframe is forgotten.
  const bool keyframe = [&] {
    for (int k = 0; k < kMaxKeyframes; ++k)
      if (map_->keyframe(k).id != 0 && map_->keyframe(k).slot == frame->slot) return true;
    return false;
  }();
  const int count = (keyframe ? 0 : 1) + (frame->holds_mapper_reference ? 1 : 0);
  if (count > 0) release(frame->slot, count);
  *frame = Frame{};
}

void Tracker::begin_map() {
  retire(&first_);
  retire(&last_);
  for (int k = 0; k < kMaxKeyframes; ++k)
    if (map_->keyframe(k).id != 0) release(map_->keyframe(k).slot, 1);
  map_->clear();
  initializer_.reset();
  ++epoch_;
  next_keyframe_id_ = 1;
  last_keyframe_id_ = 0;
  frames_since_keyframe_ = 0;
  feature_count_ = 0;
  have_velocity_ = false;
  lost_frames_ = 0;
  reset_pending_ = true;
  state_ = State::kInitialising;
}

void Tracker::apply_deltas(FrameResult* result) {
  while (const MapDelta* d = channel_->deltas.front()) {
    if (d->epoch == epoch_ && frame_counter_ < d->sequence + static_cast<std::uint32_t>(options_.delta_delay_frames))
      return;
    if (d->epoch == epoch_) {
      apply(*d);
      result->map_moved |= d->moved_keyframe_count > 0;
    }
    channel_->deltas.pop();
    // One delta a frame: the bound of DESIGN.md. In a sequential run all that are due.
    if (options_.delta_delay_frames == 0) return;
  }
}

void Tracker::apply(const MapDelta& d) {
  for (int i = 0; i < d.new_point_count; ++i) {
    const DeltaNewPoint& n = d.new_points[i];
    MapPoint& p = map_->point(n.point.index);
    if (p.active) map_->remove_point({n.point.index, p.generation});
    map_->activate_point(n.point, n.p_world);
  }
  for (int i = 0; i < d.new_feature_count; ++i) {
    const int place = map_->find_keyframe(d.new_features[i].keyframe_id);
    if (place >= 0) map_->append_feature(place, d.new_features[i].feature);
  }
  // The last frame moves with the keyframe it hangs on.
  const int anchor = map_->find_keyframe(last_keyframe_id_);
  const SE3 T_last_anchor = anchor >= 0 ? last_.T_cam_world * map_->keyframe(anchor).T_kf_world.inverse() : SE3();
  bool anchor_moved = false;
  for (int i = 0; i < d.moved_keyframe_count; ++i) {
    const int place = map_->find_keyframe(d.moved_keyframes[i].keyframe_id);
    if (place < 0) continue;
    map_->keyframe(place).T_kf_world = d.moved_keyframes[i].T_kf_world;
    anchor_moved |= place == anchor;
  }
  if (anchor_moved) last_.T_cam_world = T_last_anchor * map_->keyframe(anchor).T_kf_world;
  for (int i = 0; i < d.moved_point_count; ++i)
    if (MapPoint* p = map_->find(d.moved_points[i].point)) p->p_world = d.moved_points[i].p_world;
  for (int i = 0; i < d.removed_observation_count; ++i) {
    const int place = map_->find_keyframe(d.removed_observations[i].keyframe_id);
    if (place >= 0) map_->remove_observation(place, d.removed_observations[i].feature);
  }
  for (int i = 0; i < d.removed_point_count; ++i) map_->remove_point(d.removed_points[i]);
  for (int i = 0; i < d.removed_keyframe_count; ++i) {
    const int place = map_->find_keyframe(d.removed_keyframes[i]);
    if (place < 0) continue;
    const int slot = map_->keyframe(place).slot;
    map_->remove_keyframe(place);
    // The last frame may be this very keyframe: it then keeps the reference until it is retired.
    if (slot != last_.slot) release(slot, 1);
  }
}

void Tracker::free_of_rolling_shutter(FrameFeature* f, const Vec3& p_cam, const Vec6& velocity) const {
  f->px_global = f->px;
  if (options_.shutter.readout_s <= 0.0) return;
  Vec2 unused;
  Mat23 J;
  if (!camera_.project(p_cam, &unused, &J)) return;
  const Vec2 moved =
      rolling_displacement(options_.shutter, camera_.height(), p_cam, J, static_cast<double>(f->px.y()), velocity);
  f->px_global -= moved.cast<float>();
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

int Tracker::insert_keyframe(const Frame& frame, std::uint32_t id) {
  const int place = map_->free_keyframe_place();
  if (place < 0) return -1;
  Keyframe& kf = map_->insert_keyframe(place, id);
  kf.sequence = frame.sequence;
  kf.slot = frame.slot;
  kf.t_capture_ns = frame.t_capture_ns;
  kf.pyramid = frame.pyramid;
  kf.T_kf_world = frame.T_cam_world;
  kf.velocity = frame.velocity;
  kf.median_depth = median_depth_;
  for (int i = 0; i < feature_count_; ++i) {
    const FrameFeature& f = features_[i];
    KeyframeFeature out;
    out.px = f.px;
    out.px_global = f.px_global;
    out.gradient = f.gradient;
    out.bearing = camera_.unproject(f.px_global.cast<double>());
    out.point = f.point;
    out.level = f.level;
    out.type = f.type;
    map_->append_feature(place, out);
  }
  return place;
}

bool Tracker::send(MessageKind kind, Frame* frame, std::uint32_t keyframe_id, int place) {
  MapperMessage* m = channel_->messages.claim();
  if (!m) return false;
  m->kind = kind;
  m->epoch = epoch_;
  m->sequence = frame_counter_;
  m->slot = frame->slot;
  m->pyramid = frame->pyramid;
  m->t_capture_ns = frame->t_capture_ns;
  m->T_cam_world = frame->T_cam_world;
  m->velocity = frame->velocity;
  m->tracked_features = feature_count_;
  m->median_depth = median_depth_;
  m->min_depth = min_depth_;
  m->keyframe_id = keyframe_id;
  m->keyframe_place = place;
  m->initial = keyframe_id == 1 || keyframe_id == 2;
  m->feature_count = 0;
  m->weak_count = 0;
  if (kind == MessageKind::kKeyframe) {
    m->feature_count = feature_count_;
    std::copy_n(features_.begin(), feature_count_, m->features.begin());
    if (m->initial)
      for (int i = 0; i < feature_count_; ++i)
        m->initial_points[i] = map_->point(features_[i].point.index).p_world.cast<float>();
    // Points that are hardly ever found where they should be.
    for (int i = 0; i < map_->point_end() && m->weak_count < static_cast<int>(m->weak.size()); ++i) {
      const MapPoint& p = map_->point(i);
      if (p.active && p.missed > 12 && p.missed > 3 * p.found)
        m->weak[m->weak_count++] = {static_cast<std::uint16_t>(i), p.generation};
    }
  }
  frame->holds_mapper_reference = false;  // it travels with the message
  channel_->messages.commit();
  return true;
}

void Tracker::initialise(const FrameInput& in, const Frame& frame, FrameResult* result) {
  if (reset_pending_) {
    MapperMessage* m = channel_->messages.claim();
    if (!m) {
      result->reason = "mapper is still busy with the last map";
      Frame f = frame;
      retire(&f);
      return;
    }
    m->kind = MessageKind::kReset;
    m->epoch = epoch_;
    m->sequence = frame_counter_;
    m->slot = -1;
    channel_->messages.commit();
    reset_pending_ = false;
  }
  result->init = initializer_.add_frame(frame.pyramid, in.mask);
  Frame current = frame;
  switch (result->init.status) {
    case InitStatus::kFirstFrame:
      result->reason = "first view";
      break;
    case InitStatus::kTooFewFeatures:
      result->reason = "too few features in the first view";
      result->reason_value = result->init.tracks;
      result->reason_limit = options_.initializer.min_tracks;
      break;
    case InitStatus::kTracksLost:
      result->reason = "too few tracks left, new first view";
      result->reason_value = result->init.tracks;
      result->reason_limit = options_.initializer.min_tracks;
      break;
    case InitStatus::kNoMotion:
      result->reason = "disparity too small [px]";
      result->reason_value = static_cast<int>(result->init.median_disparity_px);
      result->reason_limit = static_cast<int>(options_.initializer.min_disparity_px);
      break;
    case InitStatus::kNoParallax:
      result->reason = "parallax too small [0.01 deg]";
      result->reason_value = static_cast<int>(100.0 * result->init.median_parallax_deg);
      result->reason_limit = static_cast<int>(100.0 * options_.initializer.min_parallax_deg);
      break;
    case InitStatus::kNoModel:
      result->reason = "neither homography nor fundamental matrix fits";
      result->reason_value = result->init.inliers;
      result->reason_limit = options_.initializer.min_points;
      break;
    case InitStatus::kAmbiguous:
      result->reason = "two motions explain the tracks alike [0.01]";
      result->reason_value = static_cast<int>(100.0 * result->init.ambiguity);
      result->reason_limit = static_cast<int>(100.0 * options_.initializer.max_ambiguity);
      break;
    case InitStatus::kDone:
      break;
  }
  if (result->init.status == InitStatus::kFirstFrame || result->init.status == InitStatus::kTracksLost ||
      result->init.status == InitStatus::kTooFewFeatures) {
    retire(&first_);
    first_ = current;
    return;
  }
  if (result->init.status != InitStatus::kDone) {
    retire(&current);
    return;
  }

  // Both keyframes must find room, or neither is sent.
  if (channel_->messages.free_items() < 2) {
    retire(&current);
    begin_map();
    result->reason = "mapper is still busy with the last map";
    return;
  }
  // Two keyframes and their common points. World frame: the first view's camera.
  const std::span<const InitPoint> points = initializer_.points();
  const int n = static_cast<int>(std::min<std::size_t>(points.size(), kMaxFrameFeatures - 20));
  first_.T_cam_world = SE3();
  current.T_cam_world = initializer_.T_cur_ref();
  median_depth_ = 1.0;
  feature_count_ = n;
  for (int i = 0; i < n; ++i) {
    // Evenly out of all, whatever their order.
    const InitPoint& p = points[static_cast<std::size_t>(i) * points.size() / static_cast<std::size_t>(n)];
    FrameFeature& f = features_[i];
    f = {};
    f.px = f.px_global = p.px_ref;
    f.level = p.level;
    f.point = {static_cast<std::uint16_t>(i), map_->point(i).generation};
    map_->activate_point(f.point, p.p_ref);
  }
  median_depth_ = scene_depth(first_.T_cam_world, &min_depth_);
  const int place1 = insert_keyframe(first_, 1);
  send(MessageKind::kKeyframe, &first_, 1, place1);
  for (int i = 0; i < n; ++i)
    features_[i].px = features_[i].px_global =
        points[static_cast<std::size_t>(i) * points.size() / static_cast<std::size_t>(n)].px_cur;
  median_depth_ = scene_depth(current.T_cam_world, &min_depth_);
  const int place2 = insert_keyframe(current, 2);
  send(MessageKind::kKeyframe, &current, 2, place2);
  next_keyframe_id_ = 3;
  last_keyframe_id_ = 2;
  frames_since_keyframe_ = 0;
  last_keyframe_features_ = n;
  retire(&first_);
  last_ = current;
  have_velocity_ = false;
  ++map_id_;
  state_ = State::kTracking;
  result->tracked = n >= options_.min_measurements;
  result->is_keyframe = true;
  result->measurements = result->matches = n;
  result->T_world_cam = current.T_cam_world.inverse();
  // The pose stands as the initialisation gave it; its covariance is that of its measurements against the first points.
  for (int i = 0; i < n; ++i) {
    PoseMeasurement& m = measurements_[i];
    m = {};
    m.px = features_[i].px_global.cast<double>();
    m.p_world = map_->point(features_[i].point.index).p_world;
    m.sigma_px = static_cast<double>(1 << features_[i].level);
  }
  SE3 refined = current.T_cam_world;
  const PoseOptimizerResult fit = optimize_pose(camera_, options_.pose, std::span(measurements_.data(), n), &refined);
  result->covariance = fit.ok ? fit.covariance : Mat6::Identity();
  result->rms_px = fit.rms_px;
  result->median_depth = median_depth_;
  result->reason =
      result->init.model == InitModel::kHomography ? "first map, homography" : "first map, fundamental matrix";
  result->reason_value = n;
  result->reason_limit = options_.min_measurements;
}

bool Tracker::estimate(const FrameInput& in, Frame* frame, const SE3& T_cur_last_guess, FrameResult* result) {
  rt::TimeNs t0 = now();
  int n = 0;
  for (int i = 0; i < feature_count_; ++i) {
    const MapPoint* p = map_->find(features_[i].point);
    if (!p) continue;
    align_points_[n++] = {features_[i].px, last_.T_cam_world * p->p_world};
  }
  SE3 T_cur_last = T_cur_last_guess;
  if (n >= 15) {
    const SparseAlignResult a =
        align_->run(last_.pyramid, frame->pyramid, std::span(align_points_.data(), n), T_cur_last_guess, in.rotation);
    T_cur_last = a.T_cur_ref;
  }
  frame->T_cam_world = T_cur_last * last_.T_cam_world;
  rt::TimeNs t1 = now();
  result->times.align += t1 - t0;

  std::array<FrameFeature, kMaxFrameFeatures>& found = features_scratch_;
  // Velocity over the interval since the last frame: what the readout of this one sees.
  const double dt = rt::to_seconds(frame->t_capture_ns - last_.t_capture_ns);
  frame->velocity = dt > 0.0 ? Vec6(T_cur_last.log() / dt) : Vec6::Zero();
  const int wanted = static_cast<int>(in.feature_share * options_.reprojector.max_features);
  const ReprojectionResult r =
      reprojector_->run(map_.get(), frame->pyramid, in.mask, frame->T_cam_world, frame->velocity, frame_counter_,
                        std::max(wanted, 2 * options_.min_measurements), found.data());
  result->matches = r.matches;
  result->candidates = r.candidates;
  t0 = now();
  result->times.reproject += t0 - t1;

  for (int i = 0; i < r.matches; ++i) {
    PoseMeasurement& m = measurements_[i];
    m.p_world = map_->point(found[i].point.index).p_world;
    free_of_rolling_shutter(&found[i], frame->T_cam_world * m.p_world, frame->velocity);
    m.px = found[i].px_global.cast<double>();
    m.gradient = found[i].gradient.cast<double>();
    m.type = found[i].type;
    m.sigma_px = static_cast<double>(1 << found[i].level);
  }
  const PoseOptimizerResult p =
      optimize_pose(camera_, options_.pose, std::span(measurements_.data(), r.matches), &frame->T_cam_world);
  t1 = now();
  result->times.pose += t1 - t0;
  result->measurements = p.ok ? p.inliers : 0;
  result->rms_px = p.rms_px;
  result->covariance = p.covariance;
  if (result->measurements < options_.min_measurements) return false;

  feature_count_ = 0;
  for (int i = 0; i < r.matches; ++i) {
    if (measurements_[i].inlier) {
      features_[feature_count_++] = found[i];
    } else {
      MapPoint& point = map_->point(found[i].point.index);
      if (point.found > 0) --point.found;
      if (point.missed < 0xffff) ++point.missed;
    }
  }
  return true;
}

void Tracker::consider_keyframe(Frame* frame, FrameResult* result) {
  const rt::TimeNs t0 = now();
  median_depth_ = scene_depth(frame->T_cam_world, &min_depth_);
  result->median_depth = median_depth_;
  ++frames_since_keyframe_;
  KeyframeFigures f;
  f.frames_since_last = frames_since_keyframe_;
  f.features = result->measurements;
  f.last_keyframe_features = last_keyframe_features_;
  f.nearest_distance = 1e9;
  const Vec3 position = -(frame->T_cam_world.R.transpose() * frame->T_cam_world.t);
  for (int k = 0; k < kMaxKeyframes; ++k) {
    const Keyframe& kf = map_->keyframe(k);
    if (kf.id == 0) continue;
    const double d = (kf.position() - position).norm() / median_depth_;
    const double c = kf.T_kf_world.R.row(2).dot(frame->T_cam_world.R.row(2));
    const double angle = std::acos(std::clamp(c, -1.0, 1.0));
    // Distance in the sense of the selector: a keyframe that looks elsewhere is no near one.
    if (angle < options_.keyframe.min_angle_rad && d < f.nearest_distance) {
      f.nearest_distance = d;
      f.nearest_angle_rad = angle;
    }
    if (kf.id == last_keyframe_id_) {
      f.last_distance = d;
      f.last_angle_rad = angle;
    }
  }
  const KeyframeReason why = select_keyframe(options_.keyframe, f);
  bool sent = false;
  if (why != KeyframeReason::kNone && channel_->messages.free_items() >= 1) {
    const std::uint32_t id = next_keyframe_id_;
    const int place = insert_keyframe(*frame, id);
    if (place >= 0) {
      sent = send(MessageKind::kKeyframe, frame, id, place);
      ++next_keyframe_id_;
      last_keyframe_id_ = id;
      frames_since_keyframe_ = 0;
      last_keyframe_features_ = result->measurements;
      result->is_keyframe = true;
    }
  }
  // Ordinary frames are sent only while there is room left for keyframes.
  if (!sent && channel_->messages.free_items() >= 4) send(MessageKind::kFrame, frame, 0, -1);
  result->times.keyframe = now() - t0;
}

FrameResult Tracker::track(const FrameInput& in) {
  FrameResult result;
  ++frame_counter_;
  rt::TimeNs t0 = now();
  Frame frame;
  frame.slot = in.slot;
  frame.holds_mapper_reference = true;
  frame.sequence = in.sequence;
  frame.t_capture_ns = in.t_capture_ns;
  frame.pyramid = build_pyramid(in.grey, rt::kPyramidLevels, in.pyramid_storage, in.pyramid_bytes);
  rt::TimeNs t1 = now();
  result.times.pyramid = t1 - t0;
  apply_deltas(&result);
  t0 = now();
  result.times.apply = t0 - t1;

  if (state_ == State::kInitialising) {
    initialise(in, frame, &result);
    result.times.initialise = now() - t0;
  } else {
    const SE3 guess = have_velocity_ && lost_frames_ == 0 ? T_last_before_ : SE3();
    if (estimate(in, &frame, guess, &result)) {
      result.tracked = true;
      state_ = State::kTracking;
      result.reason = "tracking";
      result.reason_value = result.measurements;
      result.reason_limit = options_.min_measurements;
      result.T_world_cam = frame.T_cam_world.inverse();
      T_last_before_ = frame.T_cam_world * last_.T_cam_world.inverse();
      have_velocity_ = lost_frames_ == 0;
      lost_frames_ = 0;
      consider_keyframe(&frame, &result);
      retire(&last_);
      last_ = frame;
    } else {
      state_ = State::kRelocalising;
      result.reason = "too few features";
      result.reason_value = result.measurements;
      result.reason_limit = options_.min_measurements;
      retire(&frame);
      if (++lost_frames_ > options_.lost_frames_reset) {
        begin_map();
        result.reason = "no pose for too long, new map";
        result.reason_value = options_.lost_frames_reset;
        result.reason_limit = options_.lost_frames_reset;
      }
    }
  }
  result.state = state_;
  result.map_id = state_ == State::kInitialising ? 0 : map_id_;
  return result;
}

}  // namespace godwit::vo
