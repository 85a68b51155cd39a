#include "firmware_app/pipeline/mask_exchange.h"

namespace godwit::app {

void MaskExchange::note_keyframe(rt::TimeNs t_capture_ns) {
  const auto note = [&](rt::TimeNs t) {
    waiting_[next_waiting_] = {t, kNoTime};
    next_waiting_ = (next_waiting_ + 1) % waiting_.size();
  };
  note(t_capture_ns);
  const vo::Map& map = tracker_->map();
  if (map.keyframe_count() != 2) return;
  // A new map has two at once: the first view is a frame of long ago.
  for (int k = 0; k < vo::kMaxKeyframes; ++k)
    if (map.keyframe(k).id == 1) note(map.keyframe(k).t_capture_ns);
}

void MaskExchange::purge_movers(rt::TimeNs now_ns) {
  for (WaitingKeyframe& k : waiting_) {
    if (k.t_ns == kNoTime) continue;
    if (now_ns - k.t_ns > kLateMaskNs) {
      k.t_ns = kNoTime;
      continue;
    }
    rt::MaskPyramidView mask;
    const rt::TimeNs t_detection_ns = source_->late_mask(k.t_ns, k.t_known_ns, &mask);
    if (t_detection_ns == k.t_known_ns) continue;
    if (tracker_->late_mask(k.t_ns, mask)) k.t_known_ns = t_detection_ns;
    if (k.t_known_ns == k.t_ns) k.t_ns = kNoTime;
    return;
  }
}

void MaskExchange::frame_done(rt::TimeNs t_capture_ns, const vo::FrameResult& result) {
  if (result.tracked) tell(t_capture_ns, result);
  if (result.is_keyframe) note_keyframe(t_capture_ns);
}

void MaskExchange::tell(rt::TimeNs t_capture_ns, const vo::FrameResult& result) {
  TrackedFrame told;
  told.t_capture_ns = t_capture_ns;
  told.map_id = result.map_id;
  told.T_cam_world = result.T_world_cam.inverse();
  std::size_t n = 0;
  for (const vo::FrameFeature& f : tracker_->features()) {
    const vo::MapPoint* const point = f.shaded ? nullptr : tracker_->map().find(f.point);
    if (point == nullptr || n == seen_points_.size()) continue;
    seen_points_[n++] = {f.px.x(), f.px.y(), static_cast<float>((told.T_cam_world * point->p_world).norm())};
  }
  told.points = std::span(seen_points_).first(n);
  source_->frame_tracked(told);
}

}  // namespace godwit::app
