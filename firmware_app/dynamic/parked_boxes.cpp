#include "firmware_app/dynamic/parked_boxes.h"

#include <algorithm>
#include <utility>

namespace godwit::app {
namespace {

/// Intersection over union of two things with edges x0 y0 x1 y1.
template <typename A, typename B>
float overlap(const A& a, const B& b) {
  const float w = std::min(a.x1, b.x1) - std::max(a.x0, b.x0), h = std::min(a.y1, b.y1) - std::max(a.y0, b.y0);
  if (w <= 0.F || h <= 0.F) return 0.F;
  return w * h / ((a.x1 - a.x0) * (a.y1 - a.y0) + (b.x1 - b.x0) * (b.y1 - b.y0) - w * h);
}

}  // namespace

ParkedBoxes::ParkedBoxes(const vo::CameraModel& camera, std::vector<bool> may_park, const ParkedLimits& limits)
    : camera_(camera), may_park_(std::move(may_park)), limits_(limits), frames_(kFrames), tracks_(kTracks) {}

bool ParkedBoxes::parked(int track) const {
  for (const Track& t : tracks_)
    if (track >= 0 && t.id == track) return t.parked;
  return false;
}

ParkedBoxes::Frame* ParkedBoxes::frame_of(rt::TimeNs t_ns) {
  for (Frame& f : frames_)
    if (f.t_ns == t_ns) return &f;
  return nullptr;
}

ParkedBoxes::Track* ParkedBoxes::track_of(int id) {
  for (Track& t : tracks_)
    if (id >= 0 && t.id == id) return &t;
  return nullptr;
}

ParkedBoxes::Track* ParkedBoxes::new_track() {
  for (Track& t : tracks_) {
    if (t.id >= 0) continue;
    t.forget();
    t.id = next_id_;
    next_id_ = next_id_ == INT32_MAX ? 0 : next_id_ + 1;
    return &t;
  }
  return nullptr;
}

void ParkedBoxes::fill(std::span<const detector::Box> carried, Frame* frame) {
  frame->box_count = 0;
  for (const detector::Box& b : carried) {
    if (b.track < 0 || frame->box_count == kTracks) continue;
    frame->boxes[frame->box_count++] = {b.track, b.x0, b.y0, b.x1, b.y1};
  }
}

void ParkedBoxes::correct_boxes(rt::TimeNs t_capture_ns, std::span<const detector::Box> carried) {
  if (Frame* const frame = frame_of(t_capture_ns)) fill(carried, frame);
}

void ParkedBoxes::note_boxes(rt::TimeNs t_capture_ns, std::span<const detector::Box> carried) {
  Frame& frame = frames_[head_];
  head_ = (head_ + 1) % kFrames;
  frame.t_ns = t_capture_ns;
  frame.has_pose = false;
  frame.point_count = 0;
  fill(carried, &frame);
  for (Track& t : tracks_)
    if (t.count > 0 && t_capture_ns - t.t_sighting_ns > limits_.unseen_ns) t.forget();
}

void ParkedBoxes::note_tracked(const TrackedFrame& frame) {
  if (frame.map_id != map_id_) {
    // Poses of another world.
    for (Track& t : tracks_) t.forget();
    for (Frame& f : frames_) f.has_pose = false;
    map_id_ = frame.map_id;
  }
  Frame* const f = frame_of(frame.t_capture_ns);
  if (f == nullptr) return;
  f->has_pose = true;
  f->T_cam_world = frame.T_cam_world;
  f->point_count = static_cast<int>(std::min<std::size_t>(frame.points.size(), kPoints));
  std::copy_n(frame.points.begin(), f->point_count, f->points.begin());
}

/// By where its box was carried to; what one detection missed, by where it should be if it stands.
ParkedBoxes::Track* ParkedBoxes::match(const Frame& frame, const detector::Box& box,
                                       const std::array<bool, kTracks>& taken) {
  const auto free_to_take = [&](const Track* t) { return t != nullptr && !taken[t - tracks_.data()]; };
  Track* best = nullptr;
  float most = limits_.overlap;
  for (int i = 0; i < frame.box_count; ++i) {
    const TrackedBox& before = frame.boxes[i];
    const float o = overlap(before, box);
    if (o < most) continue;
    Track* const t = track_of(before.track);
    if (!free_to_take(t)) continue;
    best = t;
    most = o;
  }
  if (best != nullptr || !frame.has_pose) return best;
  for (Track& t : tracks_) {
    vo::Vec2 px;
    if (t.id < 0 || !t.placed || !free_to_take(&t)) continue;
    if (!camera_.project(t.point.seen_from(frame.T_cam_world), &px)) continue;
    const float x = static_cast<float>(px.x()) + 0.5F, y = static_cast<float>(px.y()) + 0.5F;
    const float o = overlap(
        TrackedBox{t.id, x - 0.5F * t.width_px, y - 0.5F * t.height_px, x + 0.5F * t.width_px, y + 0.5F * t.height_px},
        box);
    if (o < most) continue;
    best = &t;
    most = o;
  }
  return best;
}

void ParkedBoxes::take_detection(rt::TimeNs t_capture_ns, std::span<detector::Box> boxes) {
  for (detector::Box& b : boxes) b.track = -1;
  Frame* const frame = frame_of(t_capture_ns);
  if (frame == nullptr || t_capture_ns <= t_detection_ns_) return;
  t_detection_ns_ = t_capture_ns;
  for (Track& t : tracks_)
    if (t.id >= 0 && t_capture_ns - t.t_seen_ns > limits_.unseen_ns) t.id = -1;

  std::array<bool, kTracks> taken{};
  // Old tracks first: a new one could take the place of one that comes later in the list.
  for (const bool begin : {false, true}) {
    for (detector::Box& box : boxes) {
      const bool may = box.class_id >= 0 && box.class_id < std::ssize(may_park_) && may_park_[box.class_id];
      // What is held keeps its track; that it was not seen is no sighting.
      if (!may || box.track >= 0 || (begin && box.missed > 0)) continue;
      Track* const track = begin ? new_track() : match(*frame, box, taken);
      if (track == nullptr) continue;
      taken[track - tracks_.data()] = true;
      box.track = track->id;
      if (box.missed > 0) continue;
      track->t_seen_ns = t_capture_ns;
      if (!frame->has_pose || cut_off(box)) continue;
      track->width_px = box.width();
      track->height_px = box.height();
      add(sighting(*frame, box), track);
      judge(scene(*frame, box), track);
    }
  }
}

/// The middle of what is left of a thing is not its middle.
bool ParkedBoxes::cut_off(const detector::Box& box) const {
  const float x = 2.F + 0.03F * box.width(), y = 2.F + 0.03F * box.height();
  return box.x0 < x || box.y0 < y || box.x1 > static_cast<float>(camera_.width()) - x ||
         box.y1 > static_cast<float>(camera_.height()) - y;
}

Sighting ParkedBoxes::sighting(const Frame& frame, const detector::Box& box) const {
  // Edges lie between pixels, the camera model counts their centres.
  const double x0 = box.x0 - 0.5, y0 = box.y0 - 0.5, x1 = box.x1 - 0.5, y1 = box.y1 - 0.5;
  const double x = 0.5 * (x0 + x1), y = 0.5 * (y0 + y1);
  Sighting out;
  out.t_ns = frame.t_ns;
  out.T_cam_world = frame.T_cam_world;
  out.bearing = camera_.unproject({x, y});
  out.width_rad = vo::angle_between(camera_.unproject({x0, y}), camera_.unproject({x1, y}));
  out.height_rad = vo::angle_between(camera_.unproject({x, y0}), camera_.unproject({x, y1}));
  return out;
}

double ParkedBoxes::tolerance(const Sighting& s) const {
  return std::max(limits_.tolerance * s.side_rad(), limits_.least_tolerance_px * camera_.rad_per_px());
}

ParkedBoxes::Scene ParkedBoxes::scene(const Frame& frame, const detector::Box& box) {
  const auto median = [&](int n) {
    std::nth_element(distances_.begin(), distances_.begin() + n / 2, distances_.begin() + n);
    return static_cast<double>(distances_[n / 2]);
  };
  const float wide = std::max(limits_.ring_px, 0.5F * box.width()),
              high = std::max(limits_.ring_px, 0.5F * box.height());
  const auto inside = [&](const SeenPoint& p, float gx, float gy) {
    const float x = p.x + 0.5F, y = p.y + 0.5F;
    return x >= box.x0 - gx && x < box.x1 + gx && y >= box.y0 - gy && y < box.y1 + gy;
  };
  int n = 0;
  for (int i = 0; i < frame.point_count; ++i) {
    const SeenPoint& p = frame.points[i];
    if (p.distance > 0.F && inside(p, wide, high) && !inside(p, 0.F, 0.F)) distances_[n++] = p.distance;
  }
  Scene out;
  out.around = n >= limits_.points_around;
  if (!out.around) {
    n = 0;
    for (int i = 0; i < frame.point_count; ++i) {
      const SeenPoint& p = frame.points[i];
      if (p.distance > 0.F) distances_[n++] = p.distance;
    }
  }
  out.known = n >= limits_.points_around;
  if (out.known) out.inverse_depth = 1.0 / median(n);
  return out;
}

void ParkedBoxes::add(const Sighting& s, Track* track) const {
  // What has left its place starts anew from where it is: it may come to stand there.
  if (track->placed && track->point.off(s) > 2.0 * tolerance(s)) track->forget();
  track->t_sighting_ns = s.t_ns;
  auto& kept = track->sightings;
  if (track->count > 0 && s.t_ns - kept[track->count - 1].t_ns < limits_.apart_ns) return;
  int old = 0;
  while (old < track->count && s.t_ns - kept[old].t_ns > limits_.window_ns) ++old;
  if (track->count == kSightings) old = std::max(old, 1);
  track->drop_oldest(old);
  kept[track->count++] = s;
}

void ParkedBoxes::judge(const Scene& scene, Track* track) const {
  const auto view = track->view();
  // Nothing around to judge by: what is known stays known.
  if (view.size() < 3 || !scene.known) return;
  double side = view.front().side_rad();
  for (const Sighting& s : view) side = std::min(side, s.side_rad());
  Sighting smallest = view.front();
  smallest.width_rad = smallest.height_rad = side;
  const double tol = tolerance(smallest), loose = track->parked ? 2.0 : 1.0;

  const bool depth_shows = baseline_across(view) * scene.inverse_depth > tol;
  const Explanation e = depth_shows ? explain(view) : explain(view, scene.inverse_depth);
  track->point = e.point;
  track->placed = true;
  bool stands = e.worst_rad < loose * tol && e.swelling < loose * limits_.swelling;
  if (depth_shows && scene.around) {
    const double factor = limits_.depth_factor * (track->parked ? 1.3 : 1.0);
    stands = stands && e.inverse_depth < factor * scene.inverse_depth && e.inverse_depth * factor > scene.inverse_depth;
  } else if (depth_shows && !track->parked) {
    stands = false;
  }
  if (!stands && track->parked) {
    track->forget();
    return;
  }
  if (e.worst_rad > 2.0 * tol) {
    // It moved in the meantime; it may have come to stand since.
    track->drop_oldest(track->count / 2);
    return;
  }
  const rt::TimeNs watched = view.back().t_ns - view.front().t_ns;
  if (stands && watched >= limits_.watched_ns && track->count >= limits_.sightings) track->parked = true;
}

}  // namespace godwit::app
