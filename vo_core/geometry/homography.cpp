#include "vo_core/geometry/homography.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <cmath>

#include "vo_core/geometry/dlt.h"

namespace godwit::vo {

bool homography_from_points(std::span<const Vec2> a, std::span<const Vec2> b, std::span<const int> index, Mat3* H) {
  PointNormalisation na, nb;
  if (index.size() < 4 || !na.fit(a, index) || !nb.fit(b, index)) return false;
  const auto rows = [&](int i, Row9* first, Row9* second) {
    const Vec2 p = na * a[i], q = nb * b[i];
    *first << -p.x(), -p.y(), -1, 0, 0, 0, q.x() * p.x(), q.x() * p.y(), q.x();
    *second << 0, 0, 0, -p.x(), -p.y(), -1, q.y() * p.x(), q.y() * p.y(), q.y();
  };
  Row9 first, second;
  Eigen::Matrix<double, 9, 1> h;
  if (index.size() == 4) {
    Eigen::Matrix<double, 8, 9> A;
    for (int k = 0; k < 4; ++k) {
      rows(index[k], &first, &second);
      A.row(2 * k) = first;
      A.row(2 * k + 1) = second;
    }
    if (!null_vector(&A, &h)) return false;
  } else {
    Eigen::Matrix<double, 9, 9> AtA = Eigen::Matrix<double, 9, 9>::Zero();
    for (int i : index) {
      rows(i, &first, &second);
      AtA += first.transpose() * first + second.transpose() * second;
    }
    if (!smallest_eigenvector(AtA, &h)) return false;
  }
  Mat3 Hn;
  Hn << h(0), h(1), h(2), h(3), h(4), h(5), h(6), h(7), h(8);
  const double det = Hn.determinant();
  if (!(std::abs(det) > 1e-8)) return false;
  Mat3 nb_inverse;
  nb_inverse << 1 / nb.scale, 0, nb.centre.x(), 0, 1 / nb.scale, nb.centre.y(), 0, 0, 1;
  *H = nb_inverse * Hn * na.matrix();
  return true;
}

int decompose_homography(const Mat3& H, double min_translation, std::array<PlaneMotion, 4>* motions) {
  // Eigen decomposition of H^T H, largest first; the middle singular value is 1 for a plane's homography.
  const Eigen::SelfAdjointEigenSolver<Mat3> first(H.transpose() * H);
  const double middle = std::sqrt(std::max(first.eigenvalues()(1), 0.0));
  if (first.info() != Eigen::Success || !(middle > 1e-12)) return 0;
  const Mat3 Hn = H / middle;
  const double s1 = first.eigenvalues()(2) / (middle * middle), s3 = first.eigenvalues()(0) / (middle * middle);
  // sigma_1 - sigma_3 = |t| / distance.
  if (!(std::sqrt(s1) - std::sqrt(std::max(s3, 0.0)) > min_translation)) return 0;
  const Vec3 v1 = first.eigenvectors().col(2), v2 = first.eigenvectors().col(1), v3 = first.eigenvectors().col(0);
  const double c1 = std::sqrt(std::max(1.0 - s3, 0.0)), c3 = std::sqrt(std::max(s1 - 1.0, 0.0));
  const double norm = std::sqrt(s1 - s3);
  int count = 0;
  for (double sign : {1.0, -1.0}) {
    const Vec3 u = (c1 * v1 + sign * c3 * v3) / norm;
    Mat3 U, W;
    U << v2, u, v2.cross(u);
    const Vec3 hv = Hn * v2, hu = Hn * u;
    W << hv, hu, hv.cross(hu);
    Mat3 R = W * U.transpose();
    const Vec3 normal = v2.cross(u);
    const Vec3 t = (Hn - R) * normal;
    R = Eigen::Quaterniond(R).normalized().toRotationMatrix();
    for (double side : {1.0, -1.0}) {
      (*motions)[count] = {SE3(R, side * t), side * normal};
      ++count;
    }
  }
  return count;
}

bool other_motion_of_plane(const SE3& T_b_a, const Vec3& plane, SE3* other) {
  std::array<PlaneMotion, 4> motions;
  const double distance = 1.0 / plane.norm();
  const int count = decompose_homography(T_b_a.R + T_b_a.t * plane.transpose(), 1e-4, &motions);
  double farthest = -1.0;
  for (int k = 0; k < count; ++k) {
    const PlaneMotion& motion = motions[k];
    if (!(motion.normal.z() * plane.z() > 0)) continue;
    const double apart = (motion.T_b_a.R - T_b_a.R).norm();
    if (apart < farthest) continue;
    farthest = apart;
    *other = SE3(motion.T_b_a.R, motion.T_b_a.t * distance);
  }
  return farthest >= 0;
}

}  // namespace godwit::vo
