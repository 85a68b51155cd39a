// The tracker's side of the map: what it takes from the mapper, what it sends, and which frame slots it holds.
#include <algorithm>
#include <array>

#include "vo_core/tracking/tracker.h"

namespace godwit::vo {

bool Tracker::take_release(SlotRelease* out) {
  return releases_.take(out);
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
  if (count > 0) releases_.add(frame->slot, count);
  *frame = Frame{};
}

void Tracker::keep_followed() {
  retire(&followed_);
  std::swap(followed_, last_);
  followed_count_ = feature_count_;
  std::copy_n(features_.begin(), feature_count_, followed_features_.begin());
}

void Tracker::go_back_to_followed() {
  unproved_ = 0;
  retire(&last_);
  std::swap(last_, followed_);
  feature_count_ = last_.slot >= 0 ? followed_count_ : 0;
  std::copy_n(followed_features_.begin(), feature_count_, features_.begin());
}

void Tracker::begin_map() {
  forget_first_view();
  drop_map();
}

void Tracker::forget_first_view() {
  retire(&first_);
  initializer_.reset();
}

void Tracker::drop_map() {
  retire(&last_);
  retire(&followed_);
  releases_.add_all(*map_);
  map_->clear();
  landmarks_->forget();
  certainty_.clear();
  noise_.reset();
  motion_.forget();
  ++epoch_;
  next_keyframe_id_ = 1;
  last_keyframe_id_ = 0;
  frames_since_keyframe_ = 0;
  feature_count_ = 0;
  unproved_ = untold_ = 0;
  seen_ = {};
  relocalise_attempt_ = 0;
  reset_pending_ = true;
}

void Tracker::apply_deltas(FrameResult* result) {
  order_.deltas = 0;
  const bool told = expected_.deltas >= 0;
  while (const MapDelta* d = order_.deltas == expected_.deltas ? nullptr : channel_->deltas.front()) {
    if (!told && d->epoch == epoch_ &&
        frame_counter_ < d->sequence + static_cast<std::uint32_t>(options_.delta_delay_frames))
      return;
    if (d->epoch == epoch_) {
      const SE3 before = last_.T_cam_world.inverse();
      apply(*d);
      result->map_moved |= d->moved_keyframe_count > 0;
      const SE3 after = last_.T_cam_world.inverse();
      result->moved_by += after.t - before.t;
      result->turned_by += so3_log(after.R * before.R.transpose());
    }
    channel_->deltas.pop();
    ++order_.deltas;
    // One delta a frame: the bound of docs/architecture.md. In a sequential run all that are due.
    if (!told && options_.delta_delay_frames == 0) return;
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
  // The last frame moves with the keyframe it hangs on, and so do keyframes that the mapper did not have yet.
  const int anchor = map_->find_keyframe(last_keyframe_id_);
  const SE3 T_world_anchor = anchor >= 0 ? map_->keyframe(anchor).T_kf_world.inverse() : SE3();
  const std::array hanging{&last_.T_cam_world, &followed_.T_cam_world, &seen_.T_cam_world};
  std::array<SE3, hanging.size()> T_hanging_anchor;
  for (std::size_t i = 0; i < hanging.size(); ++i) T_hanging_anchor[i] = *hanging[i] * T_world_anchor;
  std::array<SE3, kMaxKeyframes> T_next_previous;
  std::array<int, kMaxKeyframes> next_place, previous_place;
  int unknown = 0;
  for (std::uint32_t id = d.newest_keyframe_id + 1; id <= last_keyframe_id_ && unknown < kMaxKeyframes; ++id) {
    const int next = map_->find_keyframe(id), previous = map_->find_keyframe(id - 1);
    if (next < 0 || previous < 0) continue;
    next_place[unknown] = next;
    previous_place[unknown] = previous;
    T_next_previous[unknown++] = map_->keyframe(next).T_kf_world * map_->keyframe(previous).T_kf_world.inverse();
  }
  for (int i = 0; i < d.moved_keyframe_count; ++i) {
    const int place = map_->find_keyframe(d.moved_keyframes[i].keyframe_id);
    if (place < 0) continue;
    map_->keyframe(place).T_kf_world = d.moved_keyframes[i].T_kf_world;
  }
  if (d.moved_keyframe_count > 0) {
    for (int i = 0; i < unknown; ++i)
      map_->keyframe(next_place[i]).T_kf_world = T_next_previous[i] * map_->keyframe(previous_place[i]).T_kf_world;
    for (std::size_t i = 0; anchor >= 0 && i < hanging.size(); ++i)
      *hanging[i] = T_hanging_anchor[i] * map_->keyframe(anchor).T_kf_world;
  }
  if (d.shares.centre != 0) certainty_.take(d.shares);
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
    // The last frames may be this very keyframe: they then keep the reference until they are retired.
    if (slot != last_.slot && slot != followed_.slot) releases_.add(slot, 1);
  }
}

int Tracker::insert_keyframe(const Frame& frame, std::uint32_t id) {
  const int place = map_->free_keyframe_place();
  if (place < 0) return -1;
  map_->insert_keyframe(
      place, id,
      {frame.sequence, frame.slot, frame.t_capture_ns, frame.pyramid, frame.T_cam_world, frame.motion, median_depth_});
  relocaliser_->add_keyframe(place, id, frame.pyramid, frame.mask);
  for (int i = 0; i < map_feature_count_; ++i) map_->append_feature(place, keyframe_feature(camera_, features_[i]));
  return place;
}

bool Tracker::late_mask(rt::TimeNs t_capture_ns, const rt::MaskPyramidView& mask) {
  for (int k = 0; k < kMaxKeyframes; ++k) {
    const Keyframe& kf = map_->keyframe(k);
    if (kf.id == 0 || kf.t_capture_ns != t_capture_ns) continue;
    // Keyframes come first: what is left is theirs.
    if (room() < 3) return false;
    MapperMessage* m = channel_->messages.claim();
    m->kind = MessageKind::kLateMask;
    m->epoch = epoch_;
    m->sequence = frame_counter_;
    m->slot = -1;
    m->t_capture_ns = t_capture_ns;
    m->keyframe_id = kf.id;
    m->keyframe_place = k;
    m->mask.assign(mask);
    commit_message();
    // Nor do movers belong into what the place is recognised by.
    relocaliser_->add_keyframe(k, kf.id, kf.pyramid, mask);
    if (kf.id == last_keyframe_id_) keyframe_mask_.add(mask);
    return true;
  }
  return true;
}

bool Tracker::send_reset() {
  MapperMessage* m = room() > 0 ? channel_->messages.claim() : nullptr;
  if (!m) return false;
  m->kind = MessageKind::kReset;
  m->epoch = epoch_;
  m->sequence = frame_counter_;
  m->slot = -1;
  commit_message();
  reset_pending_ = false;
  return true;
}

bool Tracker::send(MessageKind kind, Frame* frame, std::uint32_t keyframe_id, int place) {
  MapperMessage* m = room() > 0 ? channel_->messages.claim() : nullptr;
  if (!m) return false;
  m->kind = kind;
  m->epoch = epoch_;
  m->sequence = frame_counter_;
  m->slot = frame->slot;
  m->pyramid = frame->pyramid;
  m->t_capture_ns = frame->t_capture_ns;
  // The newest keyframe that has been sent before this message. The mapper never forgets the newest ones.
  std::uint32_t anchor_id = kind == MessageKind::kKeyframe ? keyframe_id - 1 : last_keyframe_id_;
  const int anchor = map_->find_keyframe(anchor_id);
  m->anchor_id = anchor >= 0 ? anchor_id : 0;
  m->T_cam_anchor = anchor >= 0 ? frame->T_cam_world * map_->keyframe(anchor).T_kf_world.inverse() : frame->T_cam_world;
  m->motion = frame->motion;
  m->tracked_features = feature_count_;
  m->median_depth = median_depth_;
  m->min_depth = min_depth_;
  if (frame == &first_) {
    m->mask.assign(first_mask_);
  } else {
    m->mask.assign(frame->mask);
  }
  m->keyframe_id = keyframe_id;
  m->keyframe_place = place;
  m->initial = keyframe_id == 1 || keyframe_id == 2;
  m->feature_count = 0;
  m->weak_count = 0;
  if (kind == MessageKind::kKeyframe) {
    m->feature_count = map_feature_count_;
    std::copy_n(features_.begin(), map_feature_count_, m->features.begin());
    if (m->initial)
      for (int i = 0; i < map_feature_count_; ++i)
        m->initial_points[i] = map_->point(features_[i].point.index).p_world.cast<float>();
    // Points that are hardly ever found where they should be.
    for (int i = 0; i < map_->point_end() && m->weak_count < static_cast<int>(m->weak.size()); ++i) {
      const MapPoint& p = map_->point(i);
      if (p.active && p.missed > 12 && p.missed > 3 * p.found)
        m->weak[m->weak_count++] = {static_cast<std::uint16_t>(i), p.generation};
    }
  }
  frame->holds_mapper_reference = false;  // it travels with the message
  commit_message();
  return true;
}

}  // namespace godwit::vo
