#include "vo_core/inertial/inertial_alignment.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>

#include "vo_core/geometry/dense_cholesky.h"

namespace godwit::vo {
namespace {

/// Least error of a place for which the accelerometer's bias is weighed against its prior [m], and that prior [m/s^2].
constexpr double kPlaceSigma = 3e-3, kBiasSigma = 0.15;

Mat3 body(const InertialNode& n, const CameraMounting& m) {
  return n.sight.R_map_cam * m.R_body_cam.transpose();
}

/// The weight of a hint among rows in metres with this error.
double weight_of(const ScaleHint& hint, double place_sigma_m = kPlaceSigma) {
  if (!(hint.sigma > 0)) return 0;
  const double share = place_sigma_m / (hint.sigma * std::exp(hint.log_scale));
  return share * share;
}

/// The g of length `length` that minimises g^T H g / 2 - b^T g: (H + mu) g = b (the secular equation). False: H is not
/// positive.
bool constrained_gravity(const Mat3& H, const Vec3& b, double length, Vec3* g) {
  Eigen::SelfAdjointEigenSolver<Mat3> eigen;
  eigen.computeDirect(H);
  const Vec3 values = eigen.eigenvalues(), q = eigen.eigenvectors().transpose() * b;
  if (!(values[0] > 0) || !(q.norm() > 0)) return false;
  const auto length_at = [&](double mu) { return (q.array() / (values.array() + mu)).matrix().norm(); };
  // The length falls with mu from infinity at -values[0].
  double low = -values[0], high = q.norm() / length;
  for (int i = 0; i < 200 && high - low > 1e-14 * std::abs(high); ++i) {
    const double middle = 0.5 * (low + high);
    (length_at(middle) > length ? low : high) = middle;
  }
  *g = eigen.eigenvectors() * (q.array() / (values.array() + high)).matrix();
  return g->allFinite() && std::abs(g->norm() - length) < 1e-3 * length;
}

/// At most ten unknowns, gravity the last three. The sizes are known at run time alone: Eigen's decompositions of three
/// sizes took the compiler half a minute.
constexpr int kMostUnknowns = 10;
using Unknowns = Eigen::Matrix<double, kMostUnknowns, 1>;
using Normal = Eigen::Matrix<double, kMostUnknowns, kMostUnknowns>;

/// Normal equations of `rest` unknowns and gravity: solves for gravity under its constraint, then for the rest.
bool solve_with_gravity(const Normal& H, const Unknowns& b, int rest, double gravity, Unknowns* solved, Vec3* g,
                        double* free_gravity) {
  double L[kMostUnknowns * kMostUnknowns];
  for (int i = 0; i < rest; ++i)
    for (int j = 0; j < rest; ++j) L[i * rest + j] = H(i, j);
  if (!cholesky_factor(L, rest, rest)) return false;
  double K[3][kMostUnknowns], x[kMostUnknowns];
  for (int i = 0; i < rest; ++i) {
    x[i] = b[i];
    for (int axis = 0; axis < 3; ++axis) K[axis][i] = H(i, rest + axis);
  }
  cholesky_substitute(L, rest, rest, x);
  for (auto& column : K) cholesky_substitute(L, rest, rest, column);
  Mat3 S;
  Vec3 q;
  for (int i = 0; i < 3; ++i) {
    q[i] = b[rest + i];
    for (int j = 0; j < 3; ++j) S(i, j) = H(rest + i, rest + j);
    for (int k = 0; k < rest; ++k) {
      q[i] -= K[i][k] * b[k];
      for (int j = 0; j < 3; ++j) S(i, j) -= H(rest + i, k) * K[j][k];
    }
  }
  *free_gravity = (S.inverse() * q).norm();
  if (!constrained_gravity(S, q, gravity, g)) return false;
  bool finite = true;
  for (int i = 0; i < rest; ++i) {
    (*solved)[i] = x[i] - K[0][i] * (*g)[0] - K[1][i] * (*g)[1] - K[2][i] * (*g)[2];
    finite &= std::isfinite((*solved)[i]);
  }
  return finite;
}

/// Unknowns: velocities of all moments (eliminated one after the other), then scale and gravity.
Alignment stepwise(std::span<const InertialNode> nodes, const CameraMounting& m, const ImuBias& bias, double gravity,
                   const ScaleHint& hint) {
  using Mat4 = Eigen::Matrix4d;
  using Mat34 = Eigen::Matrix<double, 3, 4>;
  Alignment out;
  // Chain of velocities; each step couples two of them with (scale, gravity). Eliminating v_k leaves terms on v_k+1 and
  // on the four.
  Mat3 H_vv = Mat3::Zero();
  Mat34 H_vg = Mat34::Zero();
  Vec3 b_v = Vec3::Zero();
  Mat4 H_g = Mat4::Zero();
  Eigen::Vector4d b_g = Eigen::Vector4d::Zero();
  struct Eliminated {
    Mat3 to_next;
    Mat34 to_g;
    Vec3 constant;
  };
  Eliminated gone[InertialSmoother::kNodes];
  std::size_t steps = 0;
  for (std::size_t k = 0; k + 1 < nodes.size(); ++k) {
    const InertialNode &i = nodes[k], &j = nodes[k + 1];
    const Preintegration& d = j.since_last;
    const double dt = d.dt_s();
    const Mat3 R_i = body(i, m), R_j = body(j, m);
    // Rows: way, speed. s (c_j - c_i) - v_i dt - g dt^2 / 2 = R_i dp + (R_j - R_i) t;  v_j - v_i - g dt = R_i dv.
    Eigen::Matrix<double, 6, 3> A_i, A_j;
    Eigen::Matrix<double, 6, 4> A_g = Eigen::Matrix<double, 6, 4>::Zero();
    A_i << -dt * Mat3::Identity(), -Mat3::Identity();
    A_j << Mat3::Zero(), Mat3::Identity();
    A_g.block<3, 1>(0, 0) = j.sight.camera - i.sight.camera;
    A_g.block<3, 3>(0, 1) = -0.5 * dt * dt * Mat3::Identity();
    A_g.block<3, 3>(3, 1) = -dt * Mat3::Identity();
    Vec6 y;
    y << R_i * d.dp(bias) + (R_j - R_i) * m.t_body_cam_m, R_i * d.dv(bias);
    H_vv += A_i.transpose() * A_i;
    H_vg += A_i.transpose() * A_g;
    b_v += A_i.transpose() * y;
    const Mat3 H_next = A_i.transpose() * A_j;
    const Mat3 inverse = H_vv.inverse();
    Eliminated& e = gone[steps++];
    e = {inverse * H_next, inverse * H_vg, inverse * b_v};
    H_g += A_g.transpose() * A_g - H_vg.transpose() * e.to_g;
    b_g += A_g.transpose() * y - H_vg.transpose() * e.constant;
    const Mat34 next_vg = A_j.transpose() * A_g - H_next.transpose() * e.to_g;
    const Vec3 next_b = A_j.transpose() * y - H_next.transpose() * e.constant;
    H_vv = A_j.transpose() * A_j - H_next.transpose() * e.to_next;
    H_vg = next_vg;
    b_v = next_b;
  }
  const Mat3 inverse = H_vv.inverse();
  H_g -= H_vg.transpose() * inverse * H_vg;
  b_g -= H_vg.transpose() * inverse * b_v;
  H_g(0, 0) += weight_of(hint);
  b_g(0) += weight_of(hint) * std::exp(hint.log_scale);
  Normal H = Normal::Zero();
  Unknowns b = Unknowns::Zero(), scale = Unknowns::Zero();
  H.topLeftCorner<4, 4>() = H_g;
  b.head<4>() = b_g;
  Vec3 g;
  if (!solve_with_gravity(H, b, 1, gravity, &scale, &g, &out.free_gravity_m_s2) || !(scale[0] > 0)) return out;
  Eigen::Vector4d four;
  four << scale[0], g;
  Vec3 v = inverse * (b_v - H_vg * four);
  while (steps > 0) {
    const Eliminated& e = gone[--steps];
    v = e.constant - e.to_next * v - e.to_g * four;
  }
  out.ok = v.allFinite();
  out.log_scale = std::log(scale[0]);
  out.up = -g / gravity;
  out.velocity = v;
  out.bias = bias;
  return out;
}

/// Unknowns: the first velocity, scale, the accelerometer's bias against `bias`, then gravity. place_sigma_m: error of
/// a place.
Alignment whole(std::span<const InertialNode> nodes, const CameraMounting& m, const ImuBias& bias, double gravity,
                const ScaleHint& hint, double place_sigma_m) {
  Alignment out;
  Normal H = Normal::Zero();
  Unknowns b = Unknowns::Zero();
  Vec3 V = Vec3::Zero(), P = Vec3::Zero();
  Mat3 dV = Mat3::Zero(), dP = Mat3::Zero();
  double t = 0;
  const Mat3 R_0 = body(nodes[0], m);
  for (std::size_t k = 0; k + 1 < nodes.size(); ++k) {
    const Preintegration& d = nodes[k + 1].since_last;
    const Mat3 R_k = body(nodes[k], m), R_next = body(nodes[k + 1], m);
    const double dt = d.dt_s();
    P += V * dt + R_k * d.dp(bias);
    V += R_k * d.dv(bias);
    dP += dV * dt + R_k * d.dp_dba();
    dV += R_k * d.dv_dba();
    t += dt;
    Eigen::Matrix<double, 3, 10> A;
    A << -t * Mat3::Identity(), nodes[k + 1].sight.camera - nodes[0].sight.camera, -dP, -0.5 * t * t * Mat3::Identity();
    const Vec3 y = P + (R_next - R_0) * m.t_body_cam_m;
    for (int i = 0; i < kMostUnknowns; ++i) {
      b[i] += A.col(i).dot(y);
      for (int j = 0; j < kMostUnknowns; ++j) H(i, j) += A.col(i).dot(A.col(j));
    }
  }
  H.block<3, 3>(4, 4).diagonal().array() += (place_sigma_m / kBiasSigma) * (place_sigma_m / kBiasSigma);
  H(3, 3) += weight_of(hint, place_sigma_m);
  b(3) += weight_of(hint, place_sigma_m) * std::exp(hint.log_scale);
  Unknowns rest = Unknowns::Zero();
  Vec3 g;
  if (!solve_with_gravity(H, b, 7, gravity, &rest, &g, &out.free_gravity_m_s2) || !(rest[3] > 0)) return out;
  out.ok = true;
  out.log_scale = std::log(rest[3]);
  out.up = -g / gravity;
  out.velocity = rest.head<3>();
  out.bias.gyro = bias.gyro;
  out.bias.accel = bias.accel + rest.segment<3>(4);
  return out;
}

}  // namespace

Vec3 align_gyro_bias(std::span<const InertialNode> nodes, const CameraMounting& m, const ImuBias& start,
                     double sigma_rad_s, double turn_sigma_rad) {
  const double weight = turn_sigma_rad * turn_sigma_rad / (sigma_rad_s * sigma_rad_s);
  Vec3 bias = start.gyro;
  for (int iteration = 0; iteration < 3; ++iteration) {
    Mat3 H = weight * Mat3::Identity();
    Vec3 b = weight * (start.gyro - bias);
    for (std::size_t k = 0; k + 1 < nodes.size(); ++k) {
      const Preintegration& d = nodes[k + 1].since_last;
      const Mat3 turned = body(nodes[k], m).transpose() * body(nodes[k + 1], m);
      const Vec3 r = so3_log(d.dR(bias).transpose() * turned);
      H += d.dR_dbg().transpose() * d.dR_dbg();
      b += d.dR_dbg().transpose() * r;
    }
    bias += H.inverse() * b;
  }
  return bias;
}

TurnAgreement agreement_of_turns(std::span<const InertialNode> nodes, const CameraMounting& m, const ImuBias& bias) {
  const auto by_vision = [&](std::size_t k) { return so3_log(body(nodes[k], m).transpose() * body(nodes[k + 1], m)); };
  const auto by_gyroscope = [&](std::size_t k) { return so3_log(nodes[k + 1].since_last.dR(bias.gyro)); };
  Vec3 steady_seen = Vec3::Zero(), steady_felt = Vec3::Zero();
  double all_s = 0;
  for (std::size_t k = 0; k + 1 < nodes.size(); ++k) {
    steady_seen += by_vision(k);
    steady_felt += by_gyroscope(k);
    all_s += nodes[k + 1].since_last.dt_s();
  }
  if (!(all_s > 0)) return {};
  Mat3 both = Mat3::Zero();
  double seen2 = 0, felt2 = 0;
  for (std::size_t k = 0; k + 1 < nodes.size(); ++k) {
    const double share = nodes[k + 1].since_last.dt_s() / all_s;
    const Vec3 seen = by_vision(k) - share * steady_seen, felt = by_gyroscope(k) - share * steady_felt;
    both += seen * felt.transpose();
    seen2 += seen.squaredNorm();
    felt2 += felt.squaredNorm();
  }
  const double norms = std::sqrt(seen2 * felt2);
  if (!(norms > 0)) return {};
  // The singular values: roots of the eigenvalues of both^T both.
  Eigen::SelfAdjointEigenSolver<Mat3> eigen;
  eigen.computeDirect(both.transpose() * both, Eigen::EigenvaluesOnly);
  return {both.trace() / norms, eigen.eigenvalues().cwiseMax(0).cwiseSqrt().sum() / norms};
}

Alignment align(std::span<const InertialNode> nodes, const CameraMounting& mounting, const ImuBias& bias,
                double gravity, AlignmentMethod method, const ScaleHint& hint) {
  if (nodes.size() < 4 || nodes.size() > InertialSmoother::kNodes) return {};
  if (method == AlignmentMethod::kStepwise) return stepwise(nodes, mounting, bias, gravity, hint);
  const Alignment found = whole(nodes, mounting, bias, gravity, hint, kPlaceSigma);
  const VisionSight& last = nodes.back().sight;
  if (!found.ok || !last.shakes()) return found;
  // Places that shake are worse than that, and would pass for a bias.
  const double place_sigma_m = std::hypot(kPlaceSigma, std::exp(found.log_scale) * last.own_position);
  return whole(nodes, mounting, bias, gravity, hint, place_sigma_m);
}

}  // namespace godwit::vo
