#include "vo_core/geometry/fundamental.h"

#include <Eigen/LU>
#include <Eigen/SVD>

#include "vo_core/geometry/dlt.h"

namespace godwit::vo {

bool fundamental_from_points(std::span<const Vec2> a, std::span<const Vec2> b, std::span<const int> index, Mat3* F) {
  PointNormalisation na, nb;
  if (index.size() < 8 || !na.fit(a, index) || !nb.fit(b, index)) return false;
  const auto row = [&](int i) {
    const Vec2 p = na * a[i], q = nb * b[i];
    Row9 r;
    r << q.x() * p.x(), q.x() * p.y(), q.x(), q.y() * p.x(), q.y() * p.y(), q.y(), p.x(), p.y(), 1;
    return r;
  };
  Eigen::Matrix<double, 9, 1> f;
  if (index.size() == 8) {
    Eigen::Matrix<double, 8, 9> A;
    for (int k = 0; k < 8; ++k) A.row(k) = row(index[k]);
    if (!null_vector(&A, &f)) return false;
  } else {
    Eigen::Matrix<double, 9, 9> AtA = Eigen::Matrix<double, 9, 9>::Zero();
    for (int i : index) {
      const Row9 r = row(i);
      AtA += r.transpose() * r;
    }
    if (!smallest_eigenvector(AtA, &f)) return false;
  }
  Mat3 Fn;
  Fn << f(0), f(1), f(2), f(3), f(4), f(5), f(6), f(7), f(8);
  // The nearest matrix of rank 2: take away the part along the smallest singular value.
  const Eigen::SelfAdjointEigenSolver<Mat3> solver(Fn.transpose() * Fn);
  if (solver.info() != Eigen::Success || !(solver.eigenvalues()(1) > 1e-12)) return false;
  const Vec3 v = solver.eigenvectors().col(0);
  Fn -= Fn * v * v.transpose();
  *F = nb.matrix().transpose() * Fn * na.matrix();
  F->normalize();
  return true;
}

std::array<SE3, 4> decompose_essential(const Mat3& E) {
  const Eigen::JacobiSVD<Mat3> svd(E, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Mat3 U = svd.matrixU(), V = svd.matrixV();
  if (U.determinant() < 0) U.col(2) *= -1.0;
  if (V.determinant() < 0) V.col(2) *= -1.0;
  Mat3 W;
  W << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  const Mat3 R1 = U * W * V.transpose(), R2 = U * W.transpose() * V.transpose();
  const Vec3 t = U.col(2);
  return {SE3(R1, t), SE3(R1, -t), SE3(R2, t), SE3(R2, -t)};
}

}  // namespace godwit::vo
