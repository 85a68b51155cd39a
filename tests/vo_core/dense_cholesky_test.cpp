#include "vo_core/geometry/dense_cholesky.h"

#include <Eigen/Dense>
#include <gtest/gtest.h>

namespace godwit::vo {
namespace dense_cholesky_test {

constexpr int kSize = 18, kStride = 24;
using Padded = Eigen::Matrix<double, kStride, kStride, Eigen::RowMajor>;

Eigen::MatrixXd some_matrix() {
  std::srand(3);
  const Eigen::MatrixXd B = Eigen::MatrixXd::Random(kSize, kSize);
  return B * B.transpose() + 0.1 * Eigen::MatrixXd::Identity(kSize, kSize);
}

TEST(DenseCholesky, SolvesAndInverts) {
  const Eigen::MatrixXd A = some_matrix();
  Padded S = Padded::Constant(1e30);  // what lies beside must not count
  S.topLeftCorner<kSize, kSize>() = A;
  ASSERT_TRUE(cholesky_factor(S.data(), kSize, kStride));
  const Eigen::VectorXd b = Eigen::VectorXd::Random(kSize);
  Eigen::VectorXd x = b;
  cholesky_substitute(S.data(), kSize, kStride, x.data());
  EXPECT_LT((A * x - b).norm(), 1e-9);
  cholesky_invert_factor(S.data(), kSize, kStride);
  const Eigen::MatrixXd inverse = A.inverse();
  for (int row = 0; row < kSize; row += 6)
    for (int column = 0; column < kSize; column += 6)
      EXPECT_LT(
          (cholesky_inverse_block<6>(S.data(), kSize, kStride, row, column) - inverse.block<6, 6>(row, column)).norm(),
          1e-9 * inverse.norm())
          << row << " " << column;
}

TEST(DenseCholesky, AMatrixThatIsNotPositiveIsRefused) {
  Eigen::MatrixXd A = some_matrix();
  A(5, 5) = -1.0;
  Padded S = Padded::Zero();
  S.topLeftCorner<kSize, kSize>() = A;
  EXPECT_FALSE(cholesky_factor(S.data(), kSize, kStride));
}

}  // namespace dense_cholesky_test
}  // namespace godwit::vo
