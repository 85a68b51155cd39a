// A sliding window of moments tied by inertial measurements and by what vision saw: poses, velocities, biases, the
// map's scale, vertical and course, the camera's mounting and time offset, with their covariance.
#pragma once

#include <array>
#include <memory>

#include "vo_core/inertial/inertial_factors.h"
#include "vo_core/inertial/map_correction.h"
#include "vo_core/inertial/rest_vertical.h"

namespace godwit::vo {

/// One moment.
struct InertialNode {
  rt::TimeNs t_ns = 0;
  VisionSight sight;
  Preintegration since_last;  ///< from the moment before to this one
};

/// How sure one is before anything was measured. One sigma each.
struct InertialPrior {
  ImuBias bias;
  double gyro_bias_sigma = 0.1;    ///< [rad/s]
  double accel_bias_sigma = 0.15;  ///< [m/s^2]
  double mounting_sigma = 0.02;    ///< [rad]
  double time_sigma = 3e-3;        ///< [s]
  double course_sigma = 0.03;      ///< [rad], an axis
  Vec3 mounting = Vec3::Zero();
  double time_offset_s = 0;
};

/// Gauss-Newton over a chain: only neighbours are tied, so that elimination from the oldest moment to the newest solves
/// it, and what the first step of that leaves is the prior when the oldest moment goes (its first estimates stay: it is
/// linearised once). One thread. No allocation after the constructor; time in proportion to the moments.
class InertialSmoother {
 public:
  static constexpr int kNodes = 48;
  using Matrix = Eigen::Matrix<double, InertialState::kSize, InertialState::kSize>;
  /// Of the normal equations: a moment's square block and, in the last column, its right-hand side.
  static constexpr int kColumns = InertialState::kSize + 1;
  using Block = Eigen::Matrix<double, InertialState::kSize, kColumns, Eigen::RowMajor>;

  explicit InertialSmoother(const CameraMounting& mounting, const InertialModel& model = {});
  ~InertialSmoother();

  /// Forgets all moments.
  void clear();
  /// A later moment. Attitude and place of its state are what vision saw, velocity what the inertial sensor makes of
  /// the moment before; the first stands still. The oldest makes room where the window is full.
  void add(const InertialNode& node);
  /// The oldest moment leaves; what it knew stays as a prior of the next. At least two moments.
  void drop_oldest();

  int size() const { return count_; }
  const InertialNode& node(int i) const { return nodes_[at(i)]; }
  const InertialState& state(int i) const { return states_[at(i)]; }
  InertialState& state(int i) { return states_[at(i)]; }
  const InertialState& newest() const { return state(count_ - 1); }

  /// The prior of the oldest moment: biases, mounting, time, course; nothing of scale, vertical and velocity.
  void set_prior(const InertialPrior& prior);
  /// Adds to that what is known of the vertical at the oldest moment, and of the velocity, if it is.
  void add_vertical(const KnownVertical& vertical);

  /// What others say of the logarithm of the newest moment's scale, one sigma; 0: nobody does. It counts in each
  /// solution and in no prior that a moment leaves, so that the same knowledge is never counted twice.
  void hint_scale(double log_scale, double sigma) {
    hint_ = log_scale;
    hint_weight_ = sigma > 0 ? 1 / (sigma * sigma) : 0;
  }

  struct Report {
    bool ok = false;
    int iterations = 0;
    double chi2 = 0;  ///< of all residuals but the prior's
    int rows = 0;     ///< residuals
    double step = 0;  ///< largest of the last step, in sigmas of the newest moment
  };
  /// Minimises, at most so many steps. Not ok: the system was singular, or something was not finite; the states are
  /// then as they were.
  Report solve(int max_iterations);
  /// Of the newest moment's error, as of the last solve.
  const Matrix& covariance() const { return covariance_; }
  const InertialModel& model() const { return model_; }
  const CameraMounting& mounting() const { return mounting_; }

  /// The map was corrected. Moments within that time move and turn by their share of it, with what they know of the
  /// vertical; those before stay, so that the ways between them become those of the corrected map. Moved as one, they
  /// would keep what vision had strayed by: in the survey it flies 1 % too far between corrections, and each takes it
  /// back.
  void correct_map(const MapCorrection& correction);

 private:
  struct Work;
  std::size_t at(int i) const { return (first_ + i) % kNodes; }
  /// Adds what vision saw at moment i, absolutely, to its block; returns the squared residual.
  double add_sight(int i, Block* H) const;
  double add_pair(int i, Block* H_ii, Block* H_ij, Block* H_jj) const;
  void add_prior(Block* H) const;

  const CameraMounting mounting_;
  const InertialModel model_;
  std::array<InertialNode, kNodes> nodes_;
  std::array<InertialState, kNodes> states_;
  int first_ = 0, count_ = 0;
  // Prior of the oldest: (x - prior_at)^T H (x - prior_at) / 2 - b^T (x - prior_at).
  Matrix prior_H_ = Matrix::Zero();
  InertialState::Error prior_b_ = InertialState::Error::Zero();
  InertialState prior_at_;
  double hint_ = 0, hint_weight_ = 0;
  Matrix covariance_ = Matrix::Identity();
  std::unique_ptr<Work> work_;
};

}  // namespace godwit::vo
