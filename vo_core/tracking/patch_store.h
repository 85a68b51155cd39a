// Patches of map points as the last pictures showed them. From picture to picture a patch hardly turns or grows: it is
// cut from its keyframe anew, and its Hessian built, only where that would move its rim by a noticeable part of a
// pixel.
#pragma once

#include <array>
#include <cstdint>
#include <memory>

#include "vo_core/geometry/camera_model.h"
#include "vo_core/map/map.h"
#include "vo_core/map/matcher.h"

namespace godwit::vo {

/// Only the constructor allocates. What is kept hangs on the calls so far alone.
class PatchStore {
 public:
  PatchStore() : storage_(std::make_unique<Storage>()) {}

  /// Asks for what prepared() looks at, of a point seen in that keyframe's feature: what is kept or, if that is of
  /// another view, the keyframe's pixels.
  void prefetch(const Keyframe& keyframe, int feature, PointHandle point) const;

  /// The point's patch, from that feature of the keyframe at this depth along its bearing, on the level of its own
  /// scale. Null when it cannot be seen or cut. Valid until the next call.
  const PreparedPatch* prepared(const CameraModel& camera, const Keyframe& keyframe, int feature, PointHandle point,
                                double depth, const SE3& T_cur_kf, int max_level);

 private:
  /// Two points that fall on one place take turns: rare where those in view were found one after the other.
  static constexpr int kPlaces = 512;
  /// Which view is kept. Side by side, apart from what is large: these are looked at before that is asked for.
  struct View {
    std::uint32_t keyframe_id = 0;  ///< 0: nothing
    PointHandle point;
    std::uint16_t feature = 0;
    bool cut = false;  ///< there is a patch
    bool operator==(const View&) const = default;
  };
  struct Kept {
    PreparedPatch patch;
    Mat32 turned;  ///< bearing_by_pixel() of the feature
  };
  struct Storage {
    std::array<View, kPlaces> view;
    std::array<Kept, kPlaces> kept;
  };

  std::unique_ptr<Storage> storage_;
};

}  // namespace godwit::vo
