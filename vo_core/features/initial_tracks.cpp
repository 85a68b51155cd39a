#include "vo_core/features/initial_tracks.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {
namespace {

/// A view further than this from the optical axis cannot be written on the plane z = 1.
constexpr double kMinBearingZ = 0.2;

bool is_masked(const rt::MaskPyramidView& mask, const Vec2f& px) {
  if (mask.levels == 0) return false;
  const rt::ImageView& m = mask.level[0];
  const int x = static_cast<int>(std::lround(px.x())), y = static_cast<int>(std::lround(px.y()));
  return x < 0 || y < 0 || x >= m.width || y >= m.height || m.at(x, y) != 0;
}

FeatureDetectorOptions detector_options() {
  FeatureDetectorOptions o;
  o.levels = 3;
  o.border_px = KltTracker::kFinePatch / 2 + 4;
  o.edgelets = false;
  return o;
}

}  // namespace

InitialTracks::InitialTracks(const CameraModel& camera, double readout)
    : camera_(camera), readout_(readout), detector_(camera.width(), camera.height(), detector_options()) {
  features_.resize(kMaxTracks);
  starts_.resize(kMaxTracks);
  history_.resize(kHistory);
  ref_xy_.resize(kMaxTracks);
  cur_xy_.resize(kMaxTracks);
  ways_.resize(kMaxTracks);
  in_three_.resize(kMaxTracks);
}

bool InitialTracks::to_plane(const Vec2f& px, const ReadoutMotion& motion, Vec2* xy) const {
  const Vec3 bearing = motion.steadied(row_of(px) + 0.5, camera_.unproject(px.cast<double>()));
  if (!(bearing.z() > kMinBearingZ)) return false;
  *xy = bearing.head<2>() / bearing.z();
  return true;
}

void InitialTracks::see(std::size_t k, const Vec2f& px) {
  InThreeViews& seen = seen_[k];
  for (std::size_t i = 2; i > 0; --i) {
    seen.xy[i] = seen.xy[i - 1];
    seen.row[i] = seen.row[i - 1];
  }
  to_plane(px, {}, &seen.xy[0]);
  seen.row[0] = row_of(px) + 0.5;
}

// A track of a level further up is twice as uncertain, and the refinement weighs all alike: from the coarsest on they
// go, as long as enough are left.
void InitialTracks::drop_coarse(int enough, int* alive) {
  for (int level = KltTracker::kFineLevels - 1; level > 0; --level) {
    const auto is_coarse = [&](const KltTrack& t) { return t.alive && t.level == level; };
    const int coarse = static_cast<int>(std::count_if(tracker_.tracks().begin(), tracker_.tracks().end(), is_coarse));
    if (*alive - coarse < enough) return;
    for (int i = 0; i < std::ssize(tracker_.tracks()); ++i)
      if (is_coarse(tracker_.tracks()[i])) tracker_.drop(i);
    *alive -= coarse;
  }
}

int InitialTracks::start(const rt::PyramidView& frame, const rt::MaskPyramidView& mask, const ReadoutMotion& motion,
                         int wanted, int enough) {
  frames_ = history_count_ = count_ = 0;
  const int found = detector_.detect(frame, mask, {}, std::clamp(wanted, 1, kMaxTracks), features_);
  for (int i = 0; i < found; ++i) starts_[i] = features_[i].px;
  int alive = tracker_.set_reference(frame, std::span(starts_).first(found), detector_.noise());
  drop_coarse(enough, &alive);
  for (int k = 0; k < found; ++k) {
    const Vec2f place = px_ref(k);
    if (tracker_.tracks()[k].alive && !to_plane(place, motion, &first_.xy[k])) {
      tracker_.drop(k);
      --alive;
    }
    see(k, place);
    first_.row[k] = row_of(place);
    first_.velocity[k].setZero();
  }
  return alive;
}

// Velocities of the newest view and, now that one more is known, of the views before it: differences of second order.
void InitialTracks::differentiate(std::size_t k, View* newest) {
  const Vec2 x = newest->xy[k];
  View& last = history_count_ > 0 ? latest() : first_;
  if (frames_ == 1) {
    newest->velocity[k] = first_.velocity[k] = x - first_.xy[k];
  } else {
    newest->velocity[k] = 1.5 * x - 2.0 * previous_[k] + 0.5 * before_previous_[k];
    last.velocity[k] = 0.5 * (x - before_previous_[k]);
    if (frames_ == 2) first_.velocity[k] = -1.5 * first_.xy[k] + 2.0 * previous_[k] - 0.5 * x;
  }
  before_previous_[k] = frames_ == 1 ? first_.xy[k] : previous_[k];
  previous_[k] = x;
}

int InitialTracks::follow(const rt::PyramidView& frame, const rt::MaskPyramidView& mask, const ReadoutMotion& motion,
                          double* median_px) {
  tracker_.track(frame);
  if (history_count_ == kHistory) {
    for (int k = 0; 2 * k < kHistory; ++k) history_[k] = history_[2 * k + 1];
    history_count_ = kHistory / 2;
  }
  View& view = history_[history_count_];
  ++frames_;
  count_ = 0;
  for (int k = 0; k < std::ssize(tracker_.tracks()); ++k) {
    if (!tracker_.tracks()[k].alive) continue;
    const Vec2f place = px_cur(k);
    if (is_masked(mask, place) || !to_plane(place, motion, &view.xy[k])) {
      tracker_.drop(k);
      continue;
    }
    see(k, place);
    view.row[k] = row_of(place);
    differentiate(k, &view);
    const int n = count_++;
    track_of_[n] = k;
    ref_xy_[n] = first_.at_middle_row(k, readout_);
    cur_xy_[n] = view.at_middle_row(k, readout_);
    in_three_[n] = seen_[k];
    ways_[n] = static_cast<double>((place - px_ref(k)).norm());
  }
  ++history_count_;
  if (count_ > 0) {
    const auto middle = ways_.begin() + count_ / 2;
    std::nth_element(ways_.begin(), middle, ways_.begin() + count_);
    *median_px = *middle;
  }
  return count_;
}

Vec2f InitialTracks::px_ref(std::size_t track) const {
  const KltTrack& t = tracker_.tracks()[track];
  return t.px_ref + t.centre_ref;
}
Vec2f InitialTracks::px_cur(std::size_t track) const {
  const KltTrack& t = tracker_.tracks()[track];
  return t.px + t.centre;
}
int InitialTracks::level(std::size_t track) const {
  return std::max<int>(features_[track].level, tracker_.tracks()[track].level);
}

}  // namespace godwit::vo
