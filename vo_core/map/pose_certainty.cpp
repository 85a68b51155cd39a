#include "vo_core/map/pose_certainty.h"

#include <algorithm>

namespace godwit::vo {

void PoseCertainty::clear() {
  shares_.centre = 0;
  shares_.count = 0;
  in_map_.fill(Mat6::Zero());
}

const MapShare* PoseCertainty::find_share(std::uint32_t keyframe_id) const {
  for (int i = 0; i < shares_.count; ++i)
    if (shares_.share[i].keyframe_id == keyframe_id) return &shares_.share[i];
  return nullptr;
}

// The share as the frame has it, which looks from elsewhere than the centre.
Mat6 PoseCertainty::carried(const MapShare& share, const SE3& T_cam_centre) const {
  constexpr double kFarthest = 0.5;  // median depths: farther away an even change says little
  Vec3 way = T_cam_centre.centre();
  way *= std::min(1.0, kFarthest * shares_.median_depth / std::max(way.norm(), 1e-12));
  Mat6_18 along;
  along << way.x() * Mat6::Identity(), way.y() * Mat6::Identity(), way.z() * Mat6::Identity();
  // Products of this size would be cut into blocks, for which Eigen may ask the heap.
  const Mat6 mixed = share.with_change.lazyProduct(along.transpose());
  const Mat6_18 changed = along.lazyProduct(shares_.change);
  const Mat6 there = share.covariance + mixed + mixed.transpose() + Mat6(changed.lazyProduct(along.transpose()));
  const Mat6 ad = adjoint(T_cam_centre);
  return ad * there * ad.transpose();
}

RelativePose PoseCertainty::relative(const Map& map, const SE3& T_cam_world, rt::TimeNs t_capture_ns, const Mat6& own,
                                     const Mat6& strayed) const {
  // The newest keyframe that is old enough; where all are younger, the oldest. Those with a known share come first.
  // Looked up once a keyframe: a share is large, and so is the way from one to the next.
  int best = -1;
  bool best_known = false, best_old = false;
  for (int k = 0; k < kMaxKeyframes; ++k) {
    const Keyframe& kf = map.keyframe(k);
    if (kf.id == 0 || kf.t_capture_ns >= t_capture_ns) continue;
    const bool known = find_share(kf.id) != nullptr;
    const bool old = t_capture_ns - kf.t_capture_ns >= options_.reference_age_ns;
    const bool better = best < 0              ? true
                        : known != best_known ? known
                        : old != best_old     ? old
                        : old                 ? kf.id > map.keyframe(best).id
                                              : kf.id < map.keyframe(best).id;
    if (!better) continue;
    best = k;
    best_known = known;
    best_old = old;
  }
  RelativePose out;
  if (best < 0) return out;
  const Keyframe& ref = map.keyframe(best);
  const SE3 T_cam_ref = T_cam_world * ref.T_kf_world.inverse();
  out.keyframe_id = ref.id;
  out.t_keyframe_ns = ref.t_capture_ns;
  out.T_ref_cam = T_cam_ref.inverse();
  const MapShare* share = find_share(ref.id);
  const int centre = map.find_keyframe(shares_.centre);
  if (share != nullptr && centre >= 0) {
    out.covariance = own + carried(*share, T_cam_world * map.keyframe(centre).T_kf_world.inverse());
  } else {
    // Before the first adjustment: the keyframe hangs on the points as the frame does.
    const Mat6 ad_ref = adjoint(T_cam_ref);
    out.covariance = own + ad_ref * own * ad_ref.transpose();
  }
  const Mat6 ad = adjoint(T_cam_ref);
  out.covariance += strayed + ad * strayed * ad.transpose();
  return out;
}

Mat6 PoseCertainty::in_map(const Map& map, const RelativePose& relative) const {
  const int place = map.find_keyframe(relative.keyframe_id);
  if (place < 0) return relative.covariance;
  const Mat6 ad = adjoint(relative.T_ref_cam.inverse());
  return relative.covariance + ad * in_map_[place] * ad.transpose();
}

}  // namespace godwit::vo
