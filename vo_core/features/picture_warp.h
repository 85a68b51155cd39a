// How most of a picture moves, grows and turns from one view to another: a homography through its tracks, movers among
// them. It says where a place is to be looked for, and how its patch has changed; it is no model of the world.
#pragma once

#include <span>

#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

class PictureWarp {
 public:
  /// Fewer tracks say nothing.
  static constexpr int kMinTracks = 20;

  PictureWarp() = default;
  /// The identity, for pictures of this size [px].
  PictureWarp(int width, int height);

  /// from, to: the same places in both views [px]. Least squares from the identity on, weighed again by what is left
  /// (Geman and McClure). With fewer than kMinTracks, or where nothing can be solved, it stays what it was: false.
  bool fit(std::span<const Vec2f> from, std::span<const Vec2f> to);

  /// Where the place is in the second view [px].
  Vec2f operator()(const Vec2f& px) const;
  /// What a step beside it becomes there.
  Eigen::Matrix2f derivative(const Vec2f& px) const;

 private:
  Vec2 place(const Vec2f& px) const { return (px.cast<double>() - middle_) / width_; }
  bool solve(std::span<const Vec2f> from, std::span<const Vec2f> to, double scale);
  double left_over(const Vec2f& from, const Vec2f& to) const;

  Vec2 middle_ = Vec2::Zero();
  double width_ = 1;
  Mat3 H_ = Mat3::Identity();  ///< of places from the picture's middle, in its widths
};

}  // namespace godwit::vo
