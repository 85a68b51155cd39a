#include "vo_core/features/picture_warp.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>

namespace godwit::vo {
namespace {

/// Tracks that are asked, evenly out of all: more cost time and change nothing that a patch would feel.
constexpr int kAsked = 128;
constexpr int kPasses = 4;
/// Noise of a track, and how far an element of H may lie from the identity's before a track has spoken [widths]: where
/// tracks crowd in one corner, the rest of the picture neither grows nor turns.
constexpr double kNoise = 5e-4, kPrior = 0.2;

}  // namespace

PictureWarp::PictureWarp(int width, int height) : middle_(0.5 * width, 0.5 * height), width_(width) {}

Vec2f PictureWarp::operator()(const Vec2f& px) const {
  const Vec3 q = H_ * place(px).homogeneous();
  return (middle_ + width_ * q.hnormalized()).cast<float>();
}

Eigen::Matrix2f PictureWarp::derivative(const Vec2f& px) const {
  const Vec3 q = H_ * place(px).homogeneous();
  const Eigen::Matrix2d J = (H_.topLeftCorner<2, 2>() - q.hnormalized() * H_.bottomLeftCorner<1, 2>()) / q.z();
  return J.cast<float>();
}

double PictureWarp::left_over(const Vec2f& from, const Vec2f& to) const {
  return ((H_ * place(from).homogeneous()).hnormalized() - place(to)).norm();
}

// H p ~ q, in which H's last element is 1, is linear in the others: q = (h0 p, h1 p) - q (h2 p). scale: what a track
// may be off by before it counts for less [widths]; 0: all count alike.
bool PictureWarp::solve(std::span<const Vec2f> from, std::span<const Vec2f> to, double scale) {
  using Mat8 = Eigen::Matrix<double, 8, 8>;
  using Vec8 = Eigen::Matrix<double, 8, 1>;
  Mat8 A = Mat8::Identity() * (kNoise * kNoise / (kPrior * kPrior));
  Vec8 identity, b;
  identity << 1, 0, 0, 0, 1, 0, 0, 0;
  b = A * identity;
  for (std::size_t i = 0; i < from.size(); ++i) {
    const Vec3 p = place(from[i]).homogeneous();
    const Vec2 q = place(to[i]), xy = p.head<2>();
    double weight = 1;
    if (scale > 0) {
      const double r = left_over(from[i], to[i]) / scale;
      weight = 1.0 / ((1.0 + r * r) * (1.0 + r * r));
    }
    for (int axis = 0; axis < 2; ++axis) {
      A.block<3, 3>(3 * axis, 3 * axis).noalias() += weight * p * p.transpose();
      A.block<3, 2>(3 * axis, 6).noalias() -= weight * q[axis] * p * xy.transpose();
      b.segment<3>(3 * axis) += weight * q[axis] * p;
    }
    A.block<2, 2>(6, 6).noalias() += weight * q.squaredNorm() * xy * xy.transpose();
    b.tail<2>() -= weight * q.squaredNorm() * xy;
  }
  A.bottomLeftCorner<2, 6>() = A.topRightCorner<6, 2>().transpose();
  const Vec8 h = A.ldlt().solve(b);
  if (!h.allFinite()) return false;
  H_ << h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0;
  return true;
}

bool PictureWarp::fit(std::span<const Vec2f> from, std::span<const Vec2f> to) {
  const std::size_t n = from.size();
  if (n < kMinTracks) return false;
  const std::size_t asked = std::min<std::size_t>(n, kAsked);
  std::array<Vec2f, kAsked> a, b;
  for (std::size_t i = 0; i < asked; ++i) {
    a[i] = from[i * n / asked];
    b[i] = to[i * n / asked];
  }
  const Mat3 before = H_;
  double scale = 0;
  std::array<double, kAsked> off;
  for (int pass = 0; pass < kPasses; ++pass) {
    if (!solve({a.data(), asked}, {b.data(), asked}, scale)) {
      H_ = before;
      return false;
    }
    for (std::size_t i = 0; i < asked; ++i) off[i] = left_over(a[i], b[i]);
    std::nth_element(off.begin(), off.begin() + asked / 2, off.begin() + asked);
    scale = std::max(2.0 * off[asked / 2], kNoise);
  }
  return true;
}

}  // namespace godwit::vo
