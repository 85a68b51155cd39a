// Derivatives by central differences, against which those that are written out are held.
#pragma once

#include <Eigen/Core>
#include <gtest/gtest.h>

namespace godwit::vo::test {

/// Of f: a vector of kCols doubles -> a vector of fixed size, at zero.
template <int kCols, typename F>
auto numeric_jacobian(const F& f, double step = 1e-6) {
  using X = Eigen::Matrix<double, kCols, 1>;
  constexpr int kRows = decltype(f(X()))::RowsAtCompileTime;
  Eigen::Matrix<double, kRows, kCols> J;
  for (int k = 0; k < kCols; ++k) {
    X x = X::Zero();
    x(k) = step;
    J.col(k) = (f(x) - f(-x)) / (2.0 * step);
  }
  return J;
}

/// Every element agrees to `tolerance` of the largest one.
template <typename A, typename B>
testing::AssertionResult agrees(const A& written, const B& numeric, double tolerance = 1e-6) {
  const double off = (written - numeric).cwiseAbs().maxCoeff();
  if (off <= tolerance * (1e-6 + numeric.cwiseAbs().maxCoeff())) return testing::AssertionSuccess();
  return testing::AssertionFailure() << "off by " << off << "; written\n" << written << "\nnumeric\n" << numeric;
}

}  // namespace godwit::vo::test
