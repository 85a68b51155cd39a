#include "vo_core/inertial/inertial_smoother.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {

using S = InertialState;
using Matrix = InertialSmoother::Matrix;

namespace {

using Rows = Eigen::Matrix<double, S::kSize, S::kSize, Eigen::RowMajor>;

/// Cholesky's factor of one block. Written out, and products below are lazy ones: for this size Eigen's own take their
/// blocked way, which may allocate.
class Factor {
 public:
  explicit Factor(const Matrix& H) : L_(H) {
    for (int j = 0; j < S::kSize; ++j) {
      for (int k = 0; k < j; ++k) {
        const double x = L_(j, k);
        for (int i = j; i < S::kSize; ++i) L_(i, j) -= x * L_(i, k);
      }
      ok_ = ok_ && L_(j, j) > 0;
      const double root = std::sqrt(L_(j, j));
      for (int i = j; i < S::kSize; ++i) L_(i, j) /= root;
    }
  }
  /// False: the block was not positive.
  bool ok() const { return ok_; }
  /// H^-1 times *X, in place.
  template <typename Block>
  void solve(Block* X) const {
    for (int j = 0; j < S::kSize; ++j) {
      X->row(j) /= L_(j, j);
      for (int i = j + 1; i < S::kSize; ++i) X->row(i) -= L_(i, j) * X->row(j);
    }
    for (int j = S::kSize - 1; j >= 0; --j) {
      X->row(j) /= L_(j, j);
      for (int i = 0; i < j; ++i) X->row(i) -= L_(j, i) * X->row(j);
    }
  }

 private:
  Matrix L_;
  bool ok_ = true;
};

}  // namespace

struct InertialSmoother::Work {
  std::array<Matrix, kNodes> H, H_next;  // blocks on the diagonal, and of each moment with the next
  std::array<S::Error, kNodes> b, dx;
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
  if (!(vertical.velocity_sigma > 0)) return;
  // The same of the velocity, by rotation, velocity and bias.
  const Vec3 v_body = x.R_map_body.transpose() * x.velocity;
  J.setZero();
  J.block<3, 3>(0, S::kRotation) = skew(v_body);
  J.block<3, 3>(0, S::kVelocity) = x.R_map_body.transpose();
  J.block<3, 3>(0, S::kAccelBias) = -vertical.velocity_by_bias;
  J /= vertical.velocity_sigma;
  count(J, Vec3((v_body - vertical.velocity - vertical.velocity_by_bias * x.bias.accel) / vertical.velocity_sigma));
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

double InertialSmoother::add_sight(int i, Matrix* H, S::Error* b) const {
  SightJacobian J;
  Vec6 r = sight_residual(state(i), node(i).sight, mounting_, &J);
  const VisionSight& sight = node(i).sight;
  const double position_sigma = std::hypot(model_.position_sigma * sight.depth, model_.in_map * sight.position_in_map);
  const double rotation_sigma = std::hypot(model_.rotation_sigma, model_.in_map * sight.rotation_in_map);
  r.head<3>() /= rotation_sigma;
  J.topRows<3>() /= rotation_sigma;
  r.tail<3>() /= position_sigma;
  J.bottomRows<3>() /= position_sigma;
  H->noalias() += J.transpose().lazyProduct(J);
  b->noalias() -= J.transpose().lazyProduct(r);
  if (!sight.shakes()) {
    H->diagonal().segment<6>(S::kPicture).array() += 1;  // nothing asks for it, and it stays zero
    return r.squaredNorm();
  }
  const Vec6 own = sight.own_information * state(i).picture;
  H->block<6, 6>(S::kPicture, S::kPicture) += sight.own_information;
  b->segment<6>(S::kPicture) -= own;
  return r.squaredNorm() + state(i).picture.dot(own);
}

double InertialSmoother::add_pair(int i, Matrix* H_ii, Matrix* H_ij, Matrix* H_jj, S::Error* b_i, S::Error* b_j) const {
  PairJacobian J_i, J_j;
  const Preintegration& between = node(i + 1).since_last;
  PairResidual r =
      pair_residual(state(i), state(i + 1), between, node(i).sight, node(i + 1).sight, mounting_, model_, &J_i, &J_j);
  whiten_pair(between, node(i).sight, node(i + 1).sight, model_, &r, &J_i, &J_j);
  H_ii->noalias() += J_i.transpose().lazyProduct(J_i);
  H_ij->noalias() = J_i.transpose().lazyProduct(J_j);
  H_jj->noalias() += J_j.transpose().lazyProduct(J_j);
  b_i->noalias() -= J_i.transpose().lazyProduct(r);
  b_j->noalias() -= J_j.transpose().lazyProduct(r);
  return r.squaredNorm();
}

void InertialSmoother::add_prior(Matrix* H, S::Error* b) const {
  *H += prior_H_;
  *b += prior_b_ - prior_H_.lazyProduct(state(0).minus(prior_at_));
}

void InertialSmoother::drop_oldest() {
  Matrix H_0 = Matrix::Zero(), H_01, H_1 = Matrix::Zero();
  S::Error b_0 = S::Error::Zero(), b_1 = S::Error::Zero();
  add_prior(&H_0, &b_0);
  add_sight(0, &H_0, &b_0);
  add_pair(0, &H_0, &H_01, &H_1, &b_0, &b_1);
  H_0.diagonal().array() += 1e-9;  // what nothing ties yet
  Rows K = H_01;
  Factor(H_0).solve(&K);
  const Matrix K_columns = K;
  prior_H_ = H_1;
  prior_H_.noalias() -= H_01.transpose().lazyProduct(K_columns);
  prior_H_ = (0.5 * (prior_H_ + prior_H_.transpose())).eval();
  prior_b_ = b_1 - K_columns.transpose().lazyProduct(b_0);
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
    for (int i = 0; i < count_; ++i) {
      w.H[i].setZero();
      w.b[i].setZero();
    }
    add_prior(&w.H[0], &w.b[0]);
    report.chi2 = 0;
    for (int i = 0; i < count_; ++i) {
      report.chi2 += add_sight(i, &w.H[i], &w.b[i]);
      if (i + 1 < count_) report.chi2 += add_pair(i, &w.H[i], &w.H_next[i], &w.H[i + 1], &w.b[i], &w.b[i + 1]);
    }
    const int last_node = count_ - 1;
    w.H[last_node](S::kScale, S::kScale) += hint_weight_;
    w.b[last_node](S::kScale) += hint_weight_ * (hint_ - newest().log_scale);
    // A picture's own error is a residual and an unknown.
    report.rows = 6 * count_ + kPairRows * (count_ - 1) - S::kPicture * count_;
    // Elimination from the oldest; H[k] then holds the moment's block with all before it taken in.
    for (int k = 0; k < count_; ++k) {
      w.H[k].diagonal().array() += 1e-9;
      const Factor factor(w.H[k]);
      if (!factor.ok()) return give_up();
      w.dx[k] = w.b[k];
      factor.solve(&w.dx[k]);
      if (k + 1 == count_) {
        Rows inverse = Rows::Identity();
        factor.solve(&inverse);
        covariance_ = inverse;
        break;
      }
      Rows K = w.H_next[k];
      factor.solve(&K);
      const Matrix K_columns = K;
      w.H[k + 1].noalias() -= w.H_next[k].transpose().lazyProduct(K_columns);
      w.b[k + 1].noalias() -= K_columns.transpose().lazyProduct(w.b[k]);
      w.H_next[k] = K;
    }
    for (int i = count_ - 2; i >= 0; --i) {
      w.dx[i].noalias() -= w.H_next[i].lazyProduct(w.dx[i + 1]);
    }
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
