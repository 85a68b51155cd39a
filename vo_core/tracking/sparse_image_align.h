// Sparse model-based image alignment (Forster et al. 2014, section IV-A; the paper, section 2.5): the motion between
// two frames that makes the small patches around known points agree, inverse compositional, coarse to fine. Each patch
// has a gain and an offset of its own.
#pragma once

#include <array>
#include <span>
#include <tuple>

#include "hal/rt/image.h"
#include "vo_core/geometry/camera_model.h"
#include "vo_core/geometry/geometry.h"
#include "vo_core/geometry/rolling_shutter.h"
#include "vo_core/map/map_exchange.h"

namespace godwit::vo {

struct SparseAlignOptions {
  int max_level = 4;
  int min_level = 2;
  int max_iterations = 8;
  float huber_px = 8.0f;  ///< patch residual [grey levels, rms] at which robust weights set in
};

/// A point with its place in the reference frame.
struct AlignPoint {
  Vec2f px;    ///< reference frame, level-0 px
  Vec3 p_ref;  ///< reference camera frame, map units
};

/// What is known of the rotation beforehand, from a gyroscope say.
struct RotationPrior {
  Mat3 R_cur_ref = Mat3::Identity();
  double sigma_rad = 0.0;  ///< 0: no prior
};

/// How a rolling shutter reads the two frames, which follow each other by `interval`: their motion goes on at the same
/// rate while the rows are read.
struct AlignShutter {
  double readout = 0.0;    ///< first to last row, over the time between the frames; 0: global shutter, or unknown
  double reference = 0.5;  ///< row, as a share of the height, that is read at the capture time
  const RowTurns* shake = nullptr;  ///< what the camera turned beside that while the current frame was read; none
};

struct SparseAlignResult {
  SE3 T_cur_ref;
  int patches = 0;   ///< patches that took part at the finest level
  float rms = 0.0f;  ///< robustly weighted residual there [grey levels]
};

/// Works in its own fixed buffers; run() does not allocate.
class SparseImageAlign {
 public:
  SparseImageAlign(const CameraModel& camera, const SparseAlignOptions& options) : camera_(camera), options_(options) {}

  /// Aligns cur to ref starting from T_init. At most kMaxFrameFeatures points are used.
  SparseAlignResult run(const rt::PyramidView& ref, const rt::PyramidView& cur, std::span<const AlignPoint> points,
                        const SE3& T_init, const RotationPrior& prior, const AlignShutter& shutter = {});

 private:
  using Vec6f = Eigen::Matrix<float, 6, 1>;
  using Mat6f = Eigen::Matrix<float, 6, 6>;

  struct Patch {
    // Grey levels less their mean; gradient in grey levels a level pixel.
    alignas(32) std::array<float, 16> value, gx, gy;
    /// d pixel / d twist of the reference point, at level 0 and at the level at hand, row by row with room for 8.
    alignas(32) std::array<float, 16> J_level_0, J;
    alignas(32) std::array<float, 40> H;  ///< 6 x 6, and zeros
    bool in_view;                         ///< of the camera
    bool visible;                         ///< whole, in the level at hand
  };

  using Row = std::array<float, CameraModel::row_room(kMaxFrameFeatures)>;

  /// Time at which a row is read, over the time between the frames, 0 at the capture time.
  double row_time(double row) const { return (row / camera_.height() - shutter_.reference) * shutter_.readout; }
  /// Where the points appear at this motion: u_, v_ and seen_.
  void warp(const SE3& T_cur_ref);
  void look_at(std::span<const AlignPoint> points);
  void prepare(const rt::ImageView& ref, int level, std::span<const AlignPoint> points);
  int accumulate(const rt::ImageView& cur, int level, const SE3& T_cur_ref, Mat6f* H, Vec6f* b, float* cost);
  /// Residuals of the patches against `cur`, where the last warp() has them: sums_, sum_v_ and used_.
  int compare(const rt::ImageView& cur, int level);
  /// What each patch weighs and pulls by, several at a time: information_ and pull_. Returns the cost.
  float weigh();

  const CameraModel& camera_;
  SparseAlignOptions options_;
  AlignShutter shutter_;
  int patch_count_ = 0;
  std::array<Patch, kMaxFrameFeatures> patches_;
  /// The points in the reference camera's frame; the rows where they were last seen [level-0 px].
  std::array<Row, 3> p_ref_{}, p_cur_{};
  Row row_{}, u_{}, v_{}, seen_{};
  // Of the patches: mean, sum of the squares, 1 over that and what holds the gain; sums of the gradient and of gradient
  // times value.
  Row mean_{}, vv_{}, per_value_{}, g1x_{}, g1y_{}, gvx_{}, gvy_{};
  // Of the picture at hand: 1 where the patch lies in it; sums of the residual's square, of it times the gradient, and
  // of itself, four a patch; and of it times the value.
  Row used_{}, sum_v_{};
  std::array<float, 4 * std::tuple_size_v<Row>> sums_{};
  Row information_{}, pull_x_{}, pull_y_{};
};

}  // namespace godwit::vo
