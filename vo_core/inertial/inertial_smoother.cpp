#include "vo_core/inertial/inertial_smoother.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {

using S = InertialState;

namespace {

// The normal equations of a moment lie in a block beside their right-hand side, in rows of whole registers. What is
// done with blocks is written out, a row at a time that stays in registers: for this size Eigen's own products take
// their blocked way, which may allocate, and its lazy ones take several times as long.
constexpr int kColumns = InertialSmoother::kColumns, kRhs = S::kSize;
static_assert(kColumns % 4 == 0);
using Block = InertialSmoother::Block;
template <int N>
using Rows = Eigen::Matrix<double, N, kColumns, Eigen::RowMajor>;
using Row = Rows<1>;

/// row + sign * the sum of rows first to last - 1 of `rows`, each times its weight. Weights are often zero.
template <int N, typename Weights>
Row plus_rows(Row row, double sign, const Weights& weights, const Rows<N>& rows, int first, int last) {
  for (int i = first; i < last; ++i)
    if (weights(i) != 0) row += sign * weights(i) * rows.row(i);
  return row;
}

/// out += sign A^T B, of which A's last column is none.
template <int N>
void add_product(const Rows<N>& A, const Rows<N>& B, double sign, Block* out) {
  for (int i = 0; i < S::kSize; ++i) out->row(i) = plus_rows(out->row(i), sign, A.col(i), B, 0, N);
}

/// A Jacobian beside its residual, as it goes into the normal equations.
template <int N, typename Jacobian, typename Residual>
Rows<N> with_rhs(const Jacobian& J, const Residual& r) {
  Rows<N> out;
  out.template leftCols<S::kSize>() = J;
  out.col(kRhs) = -r;
  return out;
}

/// Cholesky's U of H = U^T U in the upper half of its place, and U^-T b in that of b. False: H is not positive.
/// inverse: of U's diagonal.
bool factorise(Block* H, S::Error* inverse) {
  for (int k = 0; k < S::kSize; ++k) {
    const Row row = plus_rows(H->row(k), -1, H->col(k), *H, 0, k);
    if (!(row(k) > 0)) return false;
    (*inverse)(k) = 1 / std::sqrt(row(k));
    H->row(k) = (*inverse)(k)*row;
  }
  return true;
}

/// U^-T X in place of X.
void forward(const Block& U, const S::Error& inverse, Block* X) {
  for (int k = 0; k < S::kSize; ++k) X->row(k) = inverse(k) * plus_rows(X->row(k), -1, U.col(k), *X, 0, k);
}

/// U^-1 X in place of X.
void back(const Block& U, const S::Error& inverse, Block* X) {
  for (int k = S::kSize - 1; k >= 0; --k)
    X->row(k) = inverse(k) * plus_rows(X->row(k), -1, U.row(k), *X, k + 1, S::kSize);
}

/// U^-1 x
S::Error back(const Block& U, const S::Error& inverse, S::Error x) {
  for (int k = S::kSize - 1; k >= 0; --k) {
    for (int i = k + 1; i < S::kSize; ++i) x(k) -= U(k, i) * x(i);
    x(k) *= inverse(k);
  }
  return x;
}

/// Takes a moment into the one after it. H: its block; H_next: that with the one after, which becomes U^-T H_next
/// beside U^-T b; H_after: the block of that one. False: H is not positive.
bool eliminate(Block* H, S::Error* inverse, Block* H_next, Block* H_after) {
  H->diagonal().array() += 1e-9;  // what nothing ties yet
  if (!factorise(H, inverse)) return false;
  forward(*H, *inverse, H_next);
  H_next->col(kRhs) = H->col(kRhs);
  add_product(*H_next, *H_next, -1, H_after);
  return true;
}

}  // namespace

struct InertialSmoother::Work {
  std::array<Block, kNodes> H, H_next;  // blocks on the diagonal, and of each moment with the next
  std::array<S::Error, kNodes> inverse, dx;
  std::array<InertialState, kNodes> before;
};

InertialSmoother::InertialSmoother(const CameraMounting& mounting, const InertialModel& model)
    : mounting_(mounting), model_(model), work_(std::make_unique<Work>()) {}
InertialSmoother::~InertialSmoother() = default;

void InertialSmoother::clear() {
  first_ = count_ = 0;
  prior_H_.setZero();
  prior_b_.setZero();
}

void InertialSmoother::set_prior(const InertialPrior& p) {
  prior_at_ = state(0);
  prior_at_.bias = p.bias;
  prior_at_.mounting = p.mounting;
  prior_at_.time_offset_s = p.time_offset_s;
  prior_at_.course.setZero();
  prior_H_.setZero();
  prior_b_.setZero();
  const auto hold = [&](int index, int n, double sigma) {
    prior_H_.diagonal().segment(index, n).setConstant(1 / (sigma * sigma));
  };
  hold(S::kGyroBias, 3, p.gyro_bias_sigma);
  hold(S::kAccelBias, 3, p.accel_bias_sigma);
  hold(S::kMounting, 3, p.mounting_sigma);
  hold(S::kTime, 1, p.time_sigma);
  hold(S::kCourse, 3, p.course_sigma);
}

void InertialSmoother::add_vertical(const KnownVertical& vertical) {
  const InertialState& x = state(0);
  // The prior counts from prior_at_, residuals from here.
  const auto count = [&](const auto& J, const auto& r) {
    prior_H_ += J.transpose().lazyProduct(J);
    prior_b_ += J.transpose().lazyProduct(J.lazyProduct(x.minus(prior_at_)) - r);
  };
  // R_body_map up - (what was known + what the bias makes of it), by rotation, up and bias.
  const Vec3 up_body = x.R_map_body.transpose() * x.up;
  Eigen::Matrix<double, 3, S::kSize> J = Eigen::Matrix<double, 3, S::kSize>::Zero();
  J.block<3, 3>(0, S::kRotation) = skew(up_body);
  J.block<3, 2>(0, S::kUp) = x.R_map_body.transpose() * x.up_basis();
  J.block<3, 3>(0, S::kAccelBias) = -vertical.by_bias;
  J /= vertical.sigma;
  count(J, Vec3((up_body - vertical.up - vertical.by_bias * x.bias.accel) / vertical.sigma));
  const double velocity_sigma = vertical.whole_velocity_sigma();
  if (!(velocity_sigma > 0)) return;
  // The same of the velocity, by rotation, velocity and bias.
  const Vec3 v_body = x.R_map_body.transpose() * x.velocity;
  J.setZero();
  J.block<3, 3>(0, S::kRotation) = skew(v_body);
  J.block<3, 3>(0, S::kVelocity) = x.R_map_body.transpose();
  J.block<3, 3>(0, S::kAccelBias) = -vertical.velocity_by_bias;
  J /= velocity_sigma;
  count(J, Vec3((v_body - vertical.velocity - vertical.velocity_by_bias * x.bias.accel) / velocity_sigma));
  // And of the bias along gravity.
  const double weight = 1 / vertical.beyond_gravity_sigma;
  Eigen::Matrix<double, 1, S::kSize> along = Eigen::Matrix<double, 1, S::kSize>::Zero();
  along.segment<3>(S::kAccelBias) = weight * vertical.up_at_rest.transpose();
  count(along, Eigen::Matrix<double, 1, 1>(weight * (vertical.up_at_rest.dot(x.bias.accel) - vertical.beyond_gravity)));
}

void InertialSmoother::add(const InertialNode& node) {
  if (count_ == kNodes) drop_oldest();
  InertialState x;
  if (count_ > 0) {
    const InertialState& last = newest();
    const Preintegration& d = node.since_last;
    x = last;
    const Vec3 g = -model_.gravity_m_s2 * last.up;
    x.R_map_body = last.R_map_body * d.dR(last.bias.gyro);
    x.velocity = last.velocity + g * d.dt_s() + last.R_map_body * d.dv(last.bias);
  }
  // Vision knows better where it is; the inertial sensor how it moves.
  x.R_map_body = node.sight.R_map_cam * (mounting_.R_body_cam * so3_exp(x.mounting)).transpose();
  x.camera = node.sight.camera;
  x.picture.setZero();
  ++count_;
  nodes_[at(count_ - 1)] = node;
  states_[at(count_ - 1)] = x;
}

double InertialSmoother::add_sight(int i, Block* H) const {
  SightJacobian J;
  Vec6 r = sight_residual(state(i), node(i).sight, mounting_, &J);
  const VisionSight& sight = node(i).sight;
  const double position_sigma = std::hypot(model_.position_sigma * sight.depth, model_.in_map * sight.position_in_map);
  const double rotation_sigma = std::hypot(model_.rotation_sigma, model_.in_map * sight.rotation_in_map);
  r.head<3>() /= rotation_sigma;
  J.topRows<3>() /= rotation_sigma;
  r.tail<3>() /= position_sigma;
  J.bottomRows<3>() /= position_sigma;
  const Rows<6> rows = with_rhs<6>(J, r);
  add_product(rows, rows, 1, H);
  if (!sight.shakes()) {
    H->diagonal().segment<6>(S::kPicture).array() += 1;  // nothing asks for it, and it stays zero
    return r.squaredNorm();
  }
  const Vec6 own = sight.own_information * state(i).picture;
  H->block<6, 6>(S::kPicture, S::kPicture) += sight.own_information;
  H->col(kRhs).segment<6>(S::kPicture) -= own;
  return r.squaredNorm() + state(i).picture.dot(own);
}

double InertialSmoother::add_pair(int i, Block* H_ii, Block* H_ij, Block* H_jj) const {
  PairJacobian J_i, J_j;
  const Preintegration& between = node(i + 1).since_last;
  PairResidual r =
      pair_residual(state(i), state(i + 1), between, node(i).sight, node(i + 1).sight, mounting_, model_, &J_i, &J_j);
  whiten_pair(between, node(i).sight, node(i + 1).sight, model_, &r, &J_i, &J_j);
  const auto rows_i = with_rhs<kPairRows>(J_i, r), rows_j = with_rhs<kPairRows>(J_j, r);
  add_product(rows_i, rows_i, 1, H_ii);
  H_ij->setZero();
  add_product(rows_i, rows_j, 1, H_ij);
  add_product(rows_j, rows_j, 1, H_jj);
  return r.squaredNorm();
}

void InertialSmoother::add_prior(Block* H) const {
  H->leftCols<S::kSize>() += prior_H_;
  H->col(kRhs) += prior_b_ - prior_H_.lazyProduct(state(0).minus(prior_at_));
}

void InertialSmoother::drop_oldest() {
  Block H_0 = Block::Zero(), H_01, H_1 = Block::Zero();
  add_prior(&H_0);
  add_sight(0, &H_0);
  add_pair(0, &H_0, &H_01, &H_1);
  S::Error inverse;
  // Where it is not positive nothing of it goes on: the rest would be held to it as if it were known.
  if (!eliminate(&H_0, &inverse, &H_01, &H_1)) H_1.setZero();
  prior_H_ = H_1.leftCols<S::kSize>().selfadjointView<Eigen::Upper>();  // symmetric to the bit
  prior_b_ = H_1.col(kRhs);
  prior_at_ = state(1);
  first_ = (first_ + 1) % kNodes;
  --count_;
}

InertialSmoother::Report InertialSmoother::solve(int max_iterations) {
  Report report;
  if (count_ < 2) return report;
  Work& w = *work_;
  for (int i = 0; i < count_; ++i) w.before[i] = state(i);
  const auto give_up = [&] {
    for (int i = 0; i < count_; ++i) state(i) = w.before[i];
    report.ok = false;
    return report;
  };
  for (report.iterations = 0; report.iterations < max_iterations; ++report.iterations) {
    for (int i = 0; i < count_; ++i) w.H[i].setZero();
    add_prior(&w.H[0]);
    report.chi2 = 0;
    for (int i = 0; i < count_; ++i) {
      report.chi2 += add_sight(i, &w.H[i]);
      if (i + 1 < count_) report.chi2 += add_pair(i, &w.H[i], &w.H_next[i], &w.H[i + 1]);
    }
    const int last_node = count_ - 1;
    Block& H_last = w.H[last_node];
    H_last(S::kScale, S::kScale) += hint_weight_;
    H_last(S::kScale, kRhs) += hint_weight_ * (hint_ - newest().log_scale);
    // A picture's own error is a residual and an unknown.
    report.rows = 6 * count_ + kPairRows * (count_ - 1) - S::kPicture * count_;
    // From the oldest; H[k] then holds what is left of the moment's block with all before it taken in.
    for (int k = 0; k < last_node; ++k)
      if (!eliminate(&w.H[k], &w.inverse[k], &w.H_next[k], &w.H[k + 1])) return give_up();
    H_last.diagonal().array() += 1e-9;
    if (!factorise(&H_last, &w.inverse[last_node])) return give_up();
    Block covariance = Block::Identity();
    forward(H_last, w.inverse[last_node], &covariance);
    back(H_last, w.inverse[last_node], &covariance);
    covariance_ = covariance.leftCols<S::kSize>();
    w.dx[last_node] = back(H_last, w.inverse[last_node], H_last.col(kRhs));
    for (int k = last_node - 1; k >= 0; --k)
      w.dx[k] =
          back(w.H[k], w.inverse[k], w.H_next[k].col(kRhs) - w.H_next[k].leftCols<S::kSize>().lazyProduct(w.dx[k + 1]));
    const S::Error& last = w.dx[count_ - 1];
    if (!last.allFinite() || !w.dx[0].allFinite()) return give_up();
    for (int i = 0; i < count_; ++i) state(i) = state(i).plus(w.dx[i]);
    report.step = last.cwiseQuotient(covariance_.diagonal().cwiseMax(1e-18).cwiseSqrt()).cwiseAbs().maxCoeff();
    if (report.step < 0.02) {
      ++report.iterations;
      break;
    }
  }
  report.ok = covariance_.allFinite();
  return report.ok ? report : give_up();
}

void InertialSmoother::correct_map(const MapCorrection& c) {
  const auto move_state = [&](rt::TimeNs t_ns, InertialState* x) {
    const Mat3 turn = c.turn(t_ns);
    x->R_map_body = turn * x->R_map_body;
    x->camera = c.moved(t_ns, x->camera);
    x->velocity = turn * x->velocity;
    x->up = turn * x->up;
    x->course = turn * x->course;
    x->picture << turn * x->picture.head<3>(), turn * x->picture.tail<3>();
  };
  if (count_ > 0) move_state(node(0).t_ns, &prior_at_);
  for (int i = 0; i < count_; ++i) {
    move_state(node(i).t_ns, &state(i));
    VisionSight& sight = nodes_[at(i)].sight;
    sight.R_map_cam = c.turn(node(i).t_ns) * sight.R_map_cam;
    sight.camera = c.moved(node(i).t_ns, sight.camera);
    if (c.strayed_at(node(i).t_ns)) {
      sight.rotation_rate = std::max(sight.rotation_rate, c.rate(c.turned_by));
      sight.position_rate = std::max(sight.position_rate, c.rate(c.moved_by));
    }
  }
}

}  // namespace godwit::vo
