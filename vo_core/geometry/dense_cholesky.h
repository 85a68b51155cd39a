// Cholesky decomposition of matrices whose size is known only at run time, in storage of the caller: no allocation.
#pragma once

#include <Eigen/Core>
#include <cmath>

namespace godwit::vo {

/// In place, the lower triangle of the n x n matrix A (row stride ld) becomes L with A = L L^T. False: A is not
/// positive definite.
inline bool cholesky_factor(double* A, int n, int ld) {
  for (int j = 0; j < n; ++j) {
    double d = A[j * ld + j];
    for (int k = 0; k < j; ++k) d -= A[j * ld + k] * A[j * ld + k];
    if (!(d > 0.0)) return false;
    d = std::sqrt(d);
    A[j * ld + j] = d;
    const double inv = 1.0 / d;
    for (int i = j + 1; i < n; ++i) {
      using Row = Eigen::Map<const Eigen::VectorXd>;
      const double s = j > 0 ? Row(A + i * ld, j).dot(Row(A + j * ld, j)) : 0.0;
      A[i * ld + j] = (A[i * ld + j] - s) * inv;
    }
  }
  return true;
}

/// Solves L L^T x = b in place.
inline void cholesky_substitute(const double* L, int n, int ld, double* b) {
  for (int i = 0; i < n; ++i) {
    double s = b[i];
    for (int k = 0; k < i; ++k) s -= L[i * ld + k] * b[k];
    b[i] = s / L[i * ld + i];
  }
  for (int i = n - 1; i >= 0; --i) {
    double s = b[i];
    for (int k = i + 1; k < n; ++k) s -= L[k * ld + i] * b[k];
    b[i] = s / L[i * ld + i];
  }
}

/// In place, L becomes its inverse, lower triangular too.
inline void cholesky_invert_factor(double* L, int n, int ld) {
  for (int j = 0; j < n; ++j) {
    L[j * ld + j] = 1.0 / L[j * ld + j];
    for (int i = j + 1; i < n; ++i) {
      double s = 0.0;
      for (int k = j; k < i; ++k) s += L[i * ld + k] * L[k * ld + j];
      L[i * ld + j] = -s / L[i * ld + i];
    }
  }
}

/// Rows `row`, `row` + 1 .. and columns `column` .. of A^-1 = L^-T L^-1, from L^-1 as cholesky_invert_factor leaves it.
template <int kSize>
Eigen::Matrix<double, kSize, kSize> cholesky_inverse_block(const double* L_inv, int n, int ld, int row, int column) {
  Eigen::Matrix<double, kSize, kSize> out = Eigen::Matrix<double, kSize, kSize>::Zero();
  using Row = Eigen::Map<const Eigen::Matrix<double, kSize, 1>>;
  // Above the diagonal L^-1 is zero; its storage there holds something else, so the first rows are taken one by one.
  for (int k = row > column ? row : column; k < n; ++k) {
    Eigen::Matrix<double, kSize, 1> a = Row(L_inv + k * ld + row), b = Row(L_inv + k * ld + column);
    for (int i = 0; i < kSize; ++i) {
      if (row + i > k) a(i) = 0.0;
      if (column + i > k) b(i) = 0.0;
    }
    out.noalias() += a * b.transpose();
  }
  return out;
}

}  // namespace godwit::vo
