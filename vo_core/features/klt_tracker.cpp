#include "vo_core/features/klt_tracker.h"

#include <algorithm>
#include <array>
#include <span>
#include <vector>

#include "hal/rt/count.h"
#include "vo_core/features/klt_patch.h"
#include "vo_core/features/picture_warp.h"
#include "vo_core/image/grey_noise.h"
#include "vo_core/image/levels.h"

namespace godwit::vo {
namespace {

/// A patch is cut anew when a step of one pixel in it ends so far from where it ended [px]: the fine patch's corners
/// are then a tenth of a pixel off, as much as noise moves a track.
constexpr float kStale = 0.01f;
/// The coarser ones only lead there: a third of a pixel of theirs.
constexpr float kStaleCoarse = 0.06f;
/// Nothing is followed to where it has grown or shrunk by more than this [areas].
constexpr float kMostGrown = 2.0f;
/// Of those that live at most so many are cut in one frame, the others in the next ones: all at once would take as long
/// as following them.
constexpr int kMostCut = KltTracker::kMaxTracks / 4;

bool differ(const Eigen::Matrix2f& a, const Eigen::Matrix2f& b, float by) {
  return (a - b).squaredNorm() > by * by;
}

}  // namespace

struct KltTracker::Impl {
  struct Patches {
    klt::Template<kFinePatch> fine;
    std::array<klt::Template<kCoarsePatch>, kLevels - 1> coarse;
    Eigen::Matrix2f coarse_warp;  ///< as they were cut
  };
  KltOptions options;
  rt::PyramidView reference;
  float grey_noise = 0;
  int count = 0;
  PictureWarp warp;  ///< from the reference picture to the latest
  std::vector<KltTrack> tracks = std::vector<KltTrack>(kMaxTracks);
  std::vector<Patches> patches = std::vector<Patches>(kMaxTracks);
  std::array<Vec2f, kMaxTracks> from, to;  ///< of those found in the latest picture at once
  std::array<int, kMaxTracks> lost;        ///< the others
  int next_refreshed = 0;

  explicit Impl(const KltOptions& o) : options(o) {}

  /// As a picture shows it to which track.warp leads; the coarse patches only where they have become stale. False if
  /// the fine one leaves the reference picture or has no texture.
  bool cut(const KltTrack& track, bool for_the_first_time, Patches* patch) const {
    // Between pixels a fourth of the noise is left, and of its gradients.
    const float least = options.min_eigenvalue * (for_the_first_time ? 1.0f : 0.25f);
    const auto cut_level = [&](int level, auto* out) {
      return klt::make_template(reference.level[level], to_level(track.px_ref, level), track.warp,
                                grey_noise_at(grey_noise, level), least, out);
    };
    if (!cut_level(track.level, &patch->fine)) return false;
    if (!for_the_first_time && !differ(track.warp, patch->coarse_warp, kStaleCoarse)) return true;
    patch->coarse_warp = track.warp;
    for (int level = 1; level < kLevels; ++level) {
      auto& t = patch->coarse[level - 1];
      t.valid = false;
      if (level < reference.levels) cut_level(level, &t);
    }
    return true;
  }

  /// Looks for the track near px [level-0 px].
  bool find(const rt::PyramidView& picture, const Patches& patch, Vec2f px, KltTrack* track) const {
    using klt::Outcome;
    const int finest = track->level;
    for (int level = std::min(picture.levels, kLevels) - 1; level > finest; --level) {
      const auto& t = patch.coarse[level - 1];
      if (!t.valid) continue;
      Vec2f p = to_level(px, level);
      const Vec2f before = p;
      // A coarse level that fails teaches nothing; the finer ones start from where it started.
      if (align(picture.level[level], t, options.max_iterations, 2 * options.converged_px, &p) != Outcome::kConverged ||
          (p - before).squaredNorm() > 36.0f)
        continue;
      px = from_level(p, level);
    }
    const rt::ImageView& image = picture.level[finest];
    Vec2f p = to_level(px, finest);
    if (align(image, patch.fine, options.max_iterations, options.converged_px, &p) != Outcome::kConverged) return false;
    px = from_level(p, finest);
    if ((px - track->px).squaredNorm() > options.max_jump_px * options.max_jump_px) return false;
    track->correlation = correlation(image, patch.fine, p);
    if (track->correlation < options.min_correlation * patch.fine.signal) return false;
    track->way = px - track->px;
    track->px = px;
    return true;
  }

  /// A patch that the picture has outgrown is cut anew; where that fails the track ends. Whether it was tried.
  bool refresh(KltTrack* track, Patches* patch) const {
    const Eigen::Matrix2f grown = warp.derivative(track->px_ref);
    if (!differ(grown, track->warp, kStale)) return false;
    track->warp = grown;
    const float area = grown.determinant();
    track->alive = area > 1.0f / kMostGrown && area < kMostGrown && cut(*track, false, patch);
    track->px += track->centre;  // the place was found with the patch as it was
    track->centre = grown * track->centre_ref;
    track->px -= track->centre;
    return true;
  }
};

KltTracker::KltTracker(const KltOptions& options) : impl_(std::make_unique<Impl>(options)) {}
KltTracker::~KltTracker() = default;

int KltTracker::set_reference(const rt::PyramidView& reference, std::span<const Vec2f> px, float grey_noise) {
  Impl& m = *impl_;
  m.count = std::min(rt::count_of(px), kMaxTracks);
  m.reference = reference;
  m.grey_noise = grey_noise;
  m.next_refreshed = 0;
  m.warp = PictureWarp(reference.level[0].width, reference.level[0].height);
  int alive = 0;
  for (int i = 0; i < m.count; ++i) {
    KltTrack& track = m.tracks[i];
    for (int level = 0; level < std::min(kFineLevels, reference.levels); ++level) {
      track = KltTrack{.px_ref = px[i], .px = px[i], .level = level};
      track.alive = m.cut(track, true, &m.patches[i]);
      if (track.alive) break;
    }
    if (!track.alive) continue;
    track.centre_ref = track.centre = m.patches[i].fine.centre * level_scale(track.level);
    ++alive;
  }
  return alive;
}

int KltTracker::track(const rt::PyramidView& picture) {
  Impl& m = *impl_;
  int alive = 0, lost = 0;
  for (int i = 0; i < m.count; ++i) {
    KltTrack& track = m.tracks[i];
    if (!track.alive) continue;
    track.alive = m.find(picture, m.patches[i], track.px + track.way, &track);
    if (!track.alive) {
      m.lost[lost++] = i;
      continue;
    }
    m.from[alive] = track.px_ref + track.centre_ref;
    m.to[alive] = track.px + track.centre;
    ++alive;
  }
  const PictureWarp before = m.warp;
  if (!m.warp.fit(std::span(m.from).first(alive), std::span(m.to).first(alive))) return alive;
  for (const int i : std::span(m.lost).first(lost)) {
    KltTrack& track = m.tracks[i];
    const Vec2f way = m.warp(track.px_ref) - before(track.px_ref);
    track.alive = true;
    m.refresh(&track, &m.patches[i]);
    track.alive = track.alive && m.find(picture, m.patches[i], track.px + way, &track);
    alive += track.alive ? 1 : 0;
  }
  int cut = 0;
  for (int k = 0; k < m.count && cut < kMostCut; ++k) {
    m.next_refreshed = (m.next_refreshed + 1) % m.count;
    const int i = m.next_refreshed;
    if (!m.tracks[i].alive) continue;
    cut += m.refresh(&m.tracks[i], &m.patches[i]) ? 1 : 0;
    alive -= m.tracks[i].alive ? 0 : 1;
  }
  return alive;
}

std::span<const KltTrack> KltTracker::tracks() const {
  return std::span(impl_->tracks).first(impl_->count);
}

void KltTracker::drop(int index) {
  impl_->tracks[index].alive = false;
}

}  // namespace godwit::vo
