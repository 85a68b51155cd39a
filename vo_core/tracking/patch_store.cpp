#include "vo_core/tracking/patch_store.h"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <hwy/cache_control.h>

namespace godwit::vo {
namespace {
// Of the patch's rim: half of what a match is uncertain by, and about the patch's centre it goes both ways. Measured on
// 13 starts of tum_fr1_xyz and of euroc_mh01: ATE 3.61 and 3.75 mm in the mean, with a fourth of it 3.59 and 3.73,
// which costs a twelfth of tracking more (godwit-yardstick, tum_fr1_xyz).
constexpr float kMostMovedPx = 0.24f;

// By how much a patch that is cut for one view is off at its rim in another [px of its level].
float rim_moved(const Eigen::Matrix2f& A_cut, const Eigen::Matrix2f& A_now) {
  const Eigen::Matrix2f off = A_now * A_cut.inverse() - Eigen::Matrix2f::Identity();
  return kPatchHalf * off.cwiseAbs().rowwise().sum().maxCoeff();
}
}  // namespace

void PatchStore::prefetch(const Keyframe& keyframe, int feature, PointHandle point) const {
  const int place = point.index % kPlaces;
  if (storage_->view[place] != View{keyframe.id, point, static_cast<std::uint16_t>(feature), true}) {
    prefetch_patch(keyframe.pyramid, keyframe.features[feature]);
    return;
  }
  constexpr int kLine = 64;
  const auto* const bytes = reinterpret_cast<const std::uint8_t*>(&storage_->kept[place]);
  for (std::size_t at = 0; at < sizeof(Kept); at += kLine) hwy::Prefetch(bytes + at);
}

const PreparedPatch* PatchStore::prepared(const CameraModel& camera, const Keyframe& keyframe, int feature,
                                          PointHandle point, double depth, const SE3& T_cur_kf, int max_level) {
  const KeyframeFeature& f = keyframe.features[feature];
  const int place = point.index % kPlaces;
  View& view = storage_->view[place];
  Kept& kept = storage_->kept[place];
  const View now{keyframe.id, point, static_cast<std::uint16_t>(feature), view.cut};
  if (view != now) {
    view = {};
    if (!bearing_by_pixel(camera, f, &kept.turned)) return nullptr;
    view = now;
    view.cut = false;
  }
  const PatchSource source{&keyframe.pyramid, &f, depth};
  Eigen::Matrix2f A;
  if (!warp_matrix(camera, source, kept.turned, T_cur_kf, &A)) return nullptr;
  const int level = search_level(A, f.level, max_level);
  // What is no number is cut anew.
  if (view.cut && level == kept.patch.level && rim_moved(kept.patch.A_cur_ref, A) < kMostMovedPx) return &kept.patch;
  view.cut = prepare_patch(source, A, level, &kept.patch);
  return view.cut ? &kept.patch : nullptr;
}

}  // namespace godwit::vo
