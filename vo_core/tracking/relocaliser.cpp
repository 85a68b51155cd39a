#include "vo_core/tracking/relocaliser.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace godwit::vo {

void Relocaliser::add_keyframe(int place, std::uint32_t id, const rt::PyramidView& pyramid,
                               const rt::MaskPyramidView& mask) {
  entries_[place] = {id, make_thumbnail(pyramid, mask, 0.0)};
}

RelocalisationGuess Relocaliser::guess(const Map& map, const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask,
                                       int attempt) const {
  // Of four attempts three are upright: the best, one of the others in turns, the best again. The fourth is turned by
  // +1, -1, +2, -2, .. steps, until the circle is full.
  const int round = attempt / 4;
  double roll = 0.0;
  int rank = attempt % 4 == 1 ? 1 + round % (options_.ranks - 1) : 0;
  if (attempt % 4 == 3) {
    const int steps = std::max(1, static_cast<int>(2.0 * std::numbers::pi / options_.roll_step_rad));
    const int k = round % steps;
    roll = (k % 2 == 0 ? 1.0 : -1.0) * (k / 2 + 1) * options_.roll_step_rad;
  }
  const Thumbnail now = make_thumbnail(pyramid, mask, roll);

  std::array<std::pair<ThumbnailMatch, int>, kMaxKeyframes> ranked;
  int n = 0;
  for (int k = 0; k < kMaxKeyframes; ++k) {
    const Keyframe& kf = map.keyframe(k);
    const Entry& entry = entries_[k];
    if (kf.id == 0 || entry.keyframe_id != kf.id) continue;
    const ThumbnailMatch m = match_thumbnails(entry.thumbnail, now);
    if (m.correlation >= options_.min_correlation) ranked[n++] = {m, k};
  }
  if (n == 0) return {};
  rank = rank % n;
  // Ties are broken by place, so that two runs rank alike.
  std::partial_sort(ranked.begin(), ranked.begin() + rank + 1, ranked.begin() + n, [](const auto& a, const auto& b) {
    return a.first.correlation > b.first.correlation ||
           (a.first.correlation == b.first.correlation && a.second < b.second);
  });
  const auto& [match, place] = ranked[rank];

  RelocalisationGuess out;
  out.place = place;
  out.correlation = match.correlation;
  // The ray through the picture's centre goes to where the shift puts it, then about the optical axis.
  const Vec2 centre(0.5 * (camera_.width() - 1), 0.5 * (camera_.height() - 1));
  const Vec2 shifted = centre + Vec2(static_cast<double>(match.dx * camera_.width()) / Thumbnail::kWidth,
                                     static_cast<double>(match.dy * camera_.height()) / Thumbnail::kHeight);
  const Mat3 shift =
      Eigen::Quaterniond::FromTwoVectors(camera_.unproject(centre), camera_.unproject(shifted)).toRotationMatrix();
  out.T_cur_kf.R = Eigen::AngleAxisd(roll, Vec3::UnitZ()).toRotationMatrix() * shift;
  return out;
}

RelocalisationGuess Relocaliser::expect(const Map& map, const SE3& T_cam_world) const {
  RelocalisationGuess out;
  int most = 0;
  for (int k = 0; k < kMaxKeyframes; ++k) {
    const Keyframe& kf = map.keyframe(k);
    if (kf.id == 0) continue;
    int seen = 0;
    for (int i = 0; i < kf.feature_count; ++i) {
      const MapPoint* p = map.find(kf.features[i].point);
      Vec2 px;
      seen += p != nullptr && camera_.project(T_cam_world * p->p_world, &px) && camera_.in_image(px, 0);
    }
    if (seen <= most) continue;
    most = seen;
    out.place = k;
    out.T_cur_kf = T_cam_world * kf.T_kf_world.inverse();
  }
  return out;
}

}  // namespace godwit::vo
