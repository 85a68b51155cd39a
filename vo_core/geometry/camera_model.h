// Camera models: pinhole with radial-tangential distortion, and Kannala-Brandt with four coefficients.
#pragma once

#include <array>

#include "hal/rt/result.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// A calibrated camera. Plain value, no allocation, any thread.
///
/// Camera frame: x right, y down, z forward. Pixels: (0, 0) is the centre of the top-left pixel.
/// Pinhole: u = f * d(x/z, y/z) + c with radial k1 k2 k3 and tangential p1 p2 distortion d, as OpenCV's projectPoints.
/// Kannala-Brandt: u = f * theta_d * (x, y)/r + c, theta_d = theta(1 + k1 theta^2 + .. + k4 theta^8), as OpenCV's
/// fisheye module (Kannala and Brandt, TPAMI 2006).
class CameraModel {
 public:
  enum class Kind { kPinholeRadTan, kKannalaBrandt4 };

  /// Distortion in OpenCV's order k1 k2 p1 p2 k3. Error: size, focal length, centre or coefficient that is not finite
  /// or absurd (a focal length of zero or less, a centre outside the picture, distortion that folds inside the
  /// picture).
  static rt::Result<CameraModel> pinhole_radtan(int width, int height, double fx, double fy, double cx, double cy,
                                                const std::array<double, 5>& distortion);
  /// Distortion k1..k4. Errors as above.
  static rt::Result<CameraModel> kannala_brandt(int width, int height, double fx, double fy, double cx, double cy,
                                                const std::array<double, 4>& distortion);

  Kind kind() const { return kind_; }
  int width() const { return width_; }
  int height() const { return height_; }
  double fx() const { return fx_; }
  double fy() const { return fy_; }
  double cx() const { return cx_; }
  double cy() const { return cy_; }
  /// Radians that one pixel spans at the centre.
  double rad_per_px() const { return 2.0 / (fx_ + fy_); }

  /// Pixel of a point in the camera frame. False, and *px untouched, if the point cannot be seen (z <= 0 for pinhole,
  /// or beyond the angle up to which the distortion is monotonic). Pixels outside the picture are returned as they are.
  /// J, if given: d pixel / d p_cam (2x3).
  bool project(const Vec3& p_cam, Vec2* px, Mat23* J = nullptr) const;

  /// The same for many points at once, coordinate by coordinate: the arrays hold `count` and are as long as the next
  /// multiple of kRowLanes, whatever stands there. seen: 1 where project() is true, else 0, and then pixel and Jacobian
  /// are those of a point on the axis. J, if given: six arrays, the Jacobian row by row. In float the pixel is off by
  /// 1e-4 px.
  static constexpr int kRowLanes = 8;
  static constexpr int row_room(int count) { return (count + kRowLanes - 1) / kRowLanes * kRowLanes; }
  template <typename Real>
  struct Rows {
    const Real *x, *y, *z;  ///< camera frame
    Real *u, *v, *seen;
    Real* const* J = nullptr;
  };
  void project(int count, const Rows<float>& rows) const;
  void project(int count, const Rows<double>& rows) const;

  /// Unit-length bearing of a pixel, camera frame. Iterative; exact to 1e-9 rad inside the picture.
  Vec3 unproject(const Vec2& px) const;

  /// The pixel lies in the picture and at least border px from its edge.
  bool in_image(const Vec2& px, double border) const {
    return px.x() >= border && px.y() >= border && px.x() < width_ - 1 - border && px.y() < height_ - 1 - border;
  }

 private:
  CameraModel() = default;
  /// Error if some pixel of the picture has no bearing that projects back onto it.
  rt::Result<void> check_picture() const;
  template <typename Real>
  void project_rows(int count, const Rows<Real>& rows) const;
  Kind kind_ = Kind::kPinholeRadTan;
  int width_ = 0, height_ = 0;
  double fx_ = 0, fy_ = 0, cx_ = 0, cy_ = 0;
  std::array<double, 5> k_{};
  /// Largest undistorted radius (pinhole) or angle (Kannala-Brandt) at which the distortion is still monotonic.
  double max_r_ = 0;
};

}  // namespace godwit::vo
