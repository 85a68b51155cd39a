// What the direct linear transforms share: Hartley's normalisation and the null vector of a linear system.
#pragma once

#include <Eigen/Eigenvalues>
#include <array>
#include <cmath>
#include <span>
#include <utility>

#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

using Row9 = Eigen::Matrix<double, 1, 9>;

/// Similarity that moves the chosen points' centroid to the origin and their mean distance to sqrt(2) (Hartley, TPAMI
/// 1997): apply as s * (p - c). False if the points coincide.
struct PointNormalisation {
  Vec2 centre = Vec2::Zero();
  double scale = 1.0;

  bool fit(std::span<const Vec2> points, std::span<const int> index) {
    const double n = static_cast<double>(index.size());
    centre.setZero();
    for (int i : index) centre += points[i] / n;
    double mean = 0;
    for (int i : index) mean += (points[i] - centre).norm() / n;
    if (!(mean > 1e-9)) return false;
    scale = std::sqrt(2.0) / mean;
    return true;
  }
  Vec2 operator*(const Vec2& p) const { return scale * (p - centre); }
  Mat3 matrix() const {
    Mat3 m;
    m << scale, 0, -scale * centre.x(), 0, scale, -scale * centre.y(), 0, 0, 1;
    return m;
  }
};

/// x with A x = 0, |x| = 1, for a system of rank 8, by Gauss-Jordan elimination with full pivoting. Destroys A. False
/// if the rank is lower (degenerate sample).
inline bool null_vector(Eigen::Matrix<double, 8, 9>* A, Eigen::Matrix<double, 9, 1>* x) {
  Eigen::Matrix<double, 8, 9>& a = *A;
  std::array<int, 9> column{0, 1, 2, 3, 4, 5, 6, 7, 8};
  for (int k = 0; k < 8; ++k) {
    int pr = k, pc = k;
    double best = 0;
    for (int r = k; r < 8; ++r) {
      for (int c = k; c < 9; ++c) {
        if (std::abs(a(r, c)) > best) {
          best = std::abs(a(r, c));
          pr = r;
          pc = c;
        }
      }
    }
    if (!(best > 1e-9)) return false;
    if (pr != k) a.row(k).swap(a.row(pr));
    if (pc != k) {
      a.col(k).swap(a.col(pc));
      std::swap(column[k], column[pc]);
    }
    a.row(k) /= a(k, k);
    for (int r = 0; r < 8; ++r)
      if (r != k) a.row(r) -= a(r, k) * a.row(k);
  }
  for (int k = 0; k < 8; ++k) (*x)(column[k]) = -a(k, 8);
  (*x)(column[8]) = 1.0;
  x->normalize();
  return true;
}

/// Unit vector that minimises |A x|, from A^T A: the eigenvector of the smallest eigenvalue.
inline bool smallest_eigenvector(const Eigen::Matrix<double, 9, 9>& AtA, Eigen::Matrix<double, 9, 1>* x) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, 9, 9>> solver(AtA);
  if (solver.info() != Eigen::Success) return false;
  *x = solver.eigenvectors().col(0);
  return true;
}

}  // namespace godwit::vo
