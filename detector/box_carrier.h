// Between two detections a box goes with the thing in it: by the motion of the features inside, else by the camera's
// own.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "detector/box.h"

namespace godwit::detector {

/// A feature in the previous picture and in this one, pixels of level 0.
struct FeatureMotion {
  float x_before = 0.F, y_before = 0.F;
  float x = 0.F, y = 0.F;
};

/// What the camera's own rotation does to far points: row-major homography, pixels of the previous picture to this one
/// (K R K^-1). Identity where nothing is known.
struct CameraMotion {
  std::array<float, 9> far_homography = {1.F, 0.F, 0.F, 0.F, 1.F, 0.F, 0.F, 0.F, 1.F};
};

struct CarrierLimits {
  std::int64_t max_age_ns = 1'000'000'000;  ///< a box that no detection has confirmed for longer is gone
  float growth_per_s = 0.5F;                ///< of its side, spread over both edges: uncertainty of what was carried
  float max_growth_share = 0.5F;            ///< of its side
  int fewest_features = 3;                  ///< in the box, to move it by its features
  /// A box whose edge the detection put this near to the picture's [share of the picture's side] is cut off there:
  /// as its object comes in, that edge stays at the picture's.
  float cut_off_share = 0.01F;
};

/// Holds the boxes of the newest detection and brings them to each new picture. Pure logic; after construction no
/// allocation. One thread.
class BoxCarrier {
 public:
  /// Pictures back to which a late detection can be carried forward.
  static constexpr int kHistory = 32;
  /// Most features of one picture that are looked at; those beyond are left out.
  static constexpr int kMaxFeatures = 512;

  /// Precondition: sizes are positive.
  BoxCarrier(int width, int height, const CarrierLimits& limits = {});

  /// One picture on: moves all boxes and drops those too old or out of the picture. `t_capture_ns` must rise from call
  /// to call; a picture that is not newer than the last is left out, and false returned.
  bool advance(std::int64_t t_capture_ns, std::span<const FeatureMotion> features, const CameraMotion& camera);

  /// Takes a detection made on the picture of `t_capture_ns` in place of all boxes, and brings it to the newest picture
  /// by the motions that were kept. False, and nothing changed, where it is older than what is held or than the
  /// history.
  bool replace(std::int64_t t_capture_ns, std::span<const Box> boxes);

  /// Boxes in the newest picture, grown with their age and clipped to it.
  std::span<const Box> boxes() const { return shown_.view(); }
  /// Boxes in the picture of `t_capture_ns`, which lies back, by the newest detection if it was made on that picture or
  /// an earlier one; without growth, not clipped. False: that picture is not known any more, or no detection reaches
  /// it. Valid until the next advance() or replace().
  bool boxes_at(std::int64_t t_capture_ns, std::span<const Box>* boxes) const;
  /// The same as they were detected and moved, neither grown nor stretched nor clipped: what to look for their motion
  /// in.
  std::span<const Box> followed() const { return std::as_const(carried_).view(); }
  /// Time between the detection and the newest picture; INT64_MAX before the first detection.
  std::int64_t age_ns() const { return seen_ns_ == INT64_MIN ? INT64_MAX : now_ns_ - seen_ns_; }

 private:
  struct Step {
    std::int64_t t_ns = 0;
    CameraMotion camera;
    int count = 0;
    std::array<FeatureMotion, kMaxFeatures> features;
    BoxList boxes;  ///< in this picture, of the newest detection if that reaches it
  };
  /// Edges of a box at which the picture cuts its object off.
  struct Edges {
    bool left = false, top = false, right = false, bottom = false;
  };
  void move_all(const Step& step);
  bool move_box(const Step& step, Box* box);
  Edges cut_off(const Box& box) const;
  void show();
  void remember(Step* step) const;
  Box to_the_edge(int i) const;

  int width_, height_;
  CarrierLimits limits_;
  std::vector<Step> history_;  // a ring; head_ is the next to be written
  int head_ = 0, held_ = 0;
  std::int64_t now_ns_ = INT64_MIN, seen_ns_ = INT64_MIN;
  BoxList carried_;  // as detected and moved: growth would compound, and what is stretched no longer fits what moves
  std::array<Edges, kMaxBoxes> cut_{};  // of carried_
  BoxList shown_;
  std::array<float, kMaxFeatures> dx_{}, dy_{}, ratio_{};
};

}  // namespace godwit::detector
