#include "firmware_app/calibration/camera_imu.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <algorithm>
#include <cmath>
#include <fmt/format.h>
#include <limits>

#include "vo_core/geometry/geometry.h"

namespace godwit::app {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using vo::so3_exp;
using vo::so3_log;

constexpr std::size_t kLeastTurns = 60;
constexpr rt::TimeNs kMostGapNs = 30 * rt::kNsPerMs;
/// The second strongest axis that the camera turned about [rad/s RMS]: below it the rotation about the strongest is
/// anybody's guess.
constexpr double kLeastRate = 0.03;
/// What may be left, against what there was.
constexpr double kMostLeft = 0.3;
constexpr double kOutlier = 4;  ///< times the median

rt::TimeNs ns(double s) {
  return static_cast<rt::TimeNs>(std::llround(s * 1e9));
}

/// The gyroscope between any two times of a recording.
class Gyroscope {
 public:
  explicit Gyroscope(const std::vector<hal::ImuSample>& readings) : readings_(readings) {}

  /// False: readings are missing.
  bool turn(rt::TimeNs t0_ns, rt::TimeNs t1_ns, const Vector3d& bias, Matrix3d* R) const {
    const auto after = std::upper_bound(readings_.begin(), readings_.end(), t0_ns,
                                        [](rt::TimeNs t, const hal::ImuSample& s) { return t < s.t_ns; });
    if (after == readings_.begin() || readings_.back().t_ns < t1_ns) return false;
    *R = Matrix3d::Identity();
    for (auto b = after; b != readings_.end() && std::prev(b)->t_ns < t1_ns; ++b) {
      const hal::ImuSample& a = *std::prev(b);
      if (b->t_ns - a.t_ns > kMostGapNs) return false;
      const rt::TimeNs from = std::max(a.t_ns, t0_ns), to = std::min(b->t_ns, t1_ns);
      const double middle =
          (0.5 * static_cast<double>((from - a.t_ns) + (to - a.t_ns))) / static_cast<double>(b->t_ns - a.t_ns);
      const Vector3d rate = (1 - middle) * Vector3d(a.gyro_rad_s.data()) + middle * Vector3d(b->gyro_rad_s.data());
      *R *= so3_exp((rate - bias) * rt::to_seconds(to - from));
    }
    return true;
  }

 private:
  const std::vector<hal::ImuSample>& readings_;
};

using Vector7 = Eigen::Matrix<double, 7, 1>;
using Matrix7 = Eigen::Matrix<double, 7, 7>;

struct Unknowns {
  Matrix3d R_body_cam = Matrix3d::Identity();
  Vector3d bias = Vector3d::Zero();
  double offset_s = 0;

  /// By rotation (on the right), bias, offset.
  Unknowns plus(const Vector7& e) const {
    return {R_body_cam * so3_exp(e.head<3>()), bias + e.segment<3>(3), offset_s + e[6]};
  }
};

/// What vision's turn has beyond the gyroscope's, along the camera's axes. False: readings are missing.
bool left_of(const SeenTurn& turn, const Gyroscope& gyroscope, const Unknowns& x, Vector3d* left) {
  const rt::TimeNs shift = ns(x.offset_s);
  Matrix3d body;
  if (!gyroscope.turn(turn.t_from_ns + shift, turn.t_to_ns + shift, x.bias, &body)) return false;
  *left = so3_log((x.R_body_cam.transpose() * body * x.R_body_cam).transpose() * turn.R_from_to);
  return true;
}

/// The rotation and bias that fit the rates best at one offset (Kabsch), and what they leave; infinite: readings are
/// missing.
double best_rotation(const std::vector<SeenTurn>& turns, const Gyroscope& gyroscope, Unknowns* x) {
  std::vector<Vector3d> cam, body;
  const rt::TimeNs shift = ns(x->offset_s);
  for (const SeenTurn& t : turns) {
    Matrix3d R;
    if (!gyroscope.turn(t.t_from_ns + shift, t.t_to_ns + shift, Vector3d::Zero(), &R)) continue;
    const double dt_s = rt::to_seconds(t.t_to_ns - t.t_from_ns);
    cam.emplace_back(so3_log(t.R_from_to) / dt_s);
    body.emplace_back(so3_log(R) / dt_s);
  }
  if (cam.size() < kLeastTurns) return std::numeric_limits<double>::infinity();
  const auto n = static_cast<double>(cam.size());
  Vector3d cam_mean = Vector3d::Zero(), body_mean = Vector3d::Zero();
  for (std::size_t i = 0; i < cam.size(); ++i) {
    cam_mean += cam[i] / n;
    body_mean += body[i] / n;
  }
  Matrix3d H = Matrix3d::Zero();
  for (std::size_t i = 0; i < cam.size(); ++i) H += (body[i] - body_mean) * (cam[i] - cam_mean).transpose();
  const Eigen::JacobiSVD<Matrix3d> svd(H, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Matrix3d same_hand = Matrix3d::Identity();
  same_hand(2, 2) = (svd.matrixU() * svd.matrixV().transpose()).determinant();
  x->R_body_cam = svd.matrixU() * same_hand * svd.matrixV().transpose();
  x->bias = body_mean - x->R_body_cam * cam_mean;
  double sum = 0;
  for (std::size_t i = 0; i < cam.size(); ++i) {
    sum += (body[i] - x->bias - x->R_body_cam * cam[i]).squaredNorm();
  }
  return sum / n;
}

/// The second strongest axis of the seen rates, RMS [rad/s].
double second_axis(const std::vector<SeenTurn>& turns) {
  Matrix3d power = Matrix3d::Zero();
  for (const SeenTurn& t : turns) {
    const Vector3d rate = so3_log(t.R_from_to) / rt::to_seconds(t.t_to_ns - t.t_from_ns);
    power += rate * rate.transpose() / static_cast<double>(turns.size());
  }
  return std::sqrt(Eigen::JacobiSVD<Matrix3d>(power).singularValues()[1]);
}

/// What a turn says of the unknowns, J^T times what is left of it, and what that is.
struct Score {
  Vector7 score;
  Vector3d left;
};

/// How many turns on two residuals still err together, by how alike neighbours are: Andrews, Econometrica 1991,
/// equations 6.2 and 6.4, for a weight that falls linearly.
std::size_t common_turns(const std::vector<Score>& scores) {
  double product = 0, square = 0;
  for (std::size_t i = 0; i < scores.size(); ++i) {
    square += scores[i].left.squaredNorm();
    if (i > 0) product += scores[i].left.dot(scores[i - 1].left);
  }
  const double alike = std::min(0.95, std::abs(product) / std::max(square, 1e-30)), apart = 1 - alike * alike;
  const double alpha = 4 * alike * alike / (apart * apart);
  return 1 + static_cast<std::size_t>(1.1447 * std::cbrt(alpha * static_cast<double>(scores.size())));
}

/// Covariance of what is fitted. Turns share pictures, and neighbouring pictures map points: they err together, and
/// more where the camera moves fast, so that as many independent ones would know it better (Newey and West,
/// Econometrica 1987). A_inverse: that of the normal matrix.
Matrix7 covariance(const Matrix7& A_inverse, const std::vector<Score>& scores) {
  const std::size_t common = common_turns(scores);
  Matrix7 sum = Matrix7::Zero();
  for (std::size_t i = 0; i < scores.size(); ++i) {
    for (std::size_t k = 0; k < common && k <= i; ++k) {
      const double weight = 1 - static_cast<double>(k) / static_cast<double>(common);
      const Matrix7 product = weight * scores[i].score * scores[i - k].score.transpose();
      sum += k == 0 ? product : Matrix7(product + product.transpose());
    }
  }
  const auto n = static_cast<double>(3 * scores.size());
  return n / (n - 7) * A_inverse * sum * A_inverse;
}

/// One step of Gauss and Newton over those of the turns that count; the fit's figures are those before the step.
/// Nothing: it is singular.
bool step(const std::vector<SeenTurn>& turns, const Gyroscope& gyroscope, Unknowns* x, CameraImuFit* fit) {
  std::vector<Vector3d> left(turns.size());
  std::vector<char> there(turns.size());
  std::vector<double> sizes;
  for (std::size_t i = 0; i < turns.size(); ++i) {
    there[i] = left_of(turns[i], gyroscope, *x, &left[i]) ? 1 : 0;
    if (there[i] != 0) sizes.push_back(left[i].norm());
  }
  if (sizes.size() < kLeastTurns) return false;
  const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
  std::nth_element(sizes.begin(), middle, sizes.end());
  const double most = kOutlier * *middle;
  constexpr double kTurn = 1e-5, kRate = 1e-5, kTime = 1e-4;
  Matrix7 A = Matrix7::Zero();
  Vector7 b = Vector7::Zero();
  double sum = 0;
  std::vector<Score> scores;
  for (std::size_t i = 0; i < turns.size(); ++i) {
    if (there[i] == 0 || left[i].norm() > most) continue;
    Eigen::Matrix<double, 3, 7> J;
    bool whole = true;
    for (int k = 0; k < 7; ++k) {
      const double small = k < 3 ? kTurn : k < 6 ? kRate : kTime;
      Vector7 e = Vector7::Zero();
      Vector3d more, less;
      e[k] = small;
      whole =
          whole && left_of(turns[i], gyroscope, x->plus(e), &more) && left_of(turns[i], gyroscope, x->plus(-e), &less);
      if (whole) J.col(k) = (more - less) / (2 * small);
    }
    if (!whole) continue;
    A += J.transpose() * J;
    scores.push_back({J.transpose() * left[i], left[i]});
    b -= scores.back().score;
    sum += left[i].squaredNorm();
  }
  const std::size_t used = scores.size();
  if (used < kLeastTurns) return false;
  const Eigen::LDLT<Matrix7> solver(A);
  if (solver.info() != Eigen::Success || !solver.isPositive()) return false;
  const Matrix7 C = covariance(solver.solve(Matrix7::Identity()), scores);
  fit->turn_sigma_rad = std::sqrt(C.diagonal().head<3>().maxCoeff());
  fit->time_sigma_s = std::sqrt(C(6, 6));
  fit->rms_rad = std::sqrt(sum / static_cast<double>(3 * used));
  fit->turns = used;
  fit->turns_left_out = turns.size() - used;
  *x = x->plus(solver.solve(b));
  return true;
}

}  // namespace

rt::Result<CameraImuFit> fit_camera_imu(const std::vector<SeenTurn>& turns,
                                        const std::vector<hal::ImuSample>& readings) {
  if (turns.size() < kLeastTurns) {
    return rt::Error{
        fmt::format("vision saw {} turns of the camera; {} at least are needed", turns.size(), kLeastTurns)};
  }
  const double second = second_axis(turns);
  if (second < kLeastRate) {
    return rt::Error{
        fmt::format("the camera turned about one axis at most (about a second one by {:.3f} rad/s RMS, {} "
                    "at least are needed): turn it about all three",
                    second, kLeastRate)};
  }
  const Gyroscope gyroscope(readings);
  Unknowns best;
  double least = std::numeric_limits<double>::infinity(), most = 0;
  constexpr int kOffsets = 20;
  for (int i = -kOffsets; i <= kOffsets; ++i) {
    Unknowns x;
    x.offset_s = kMostTimeOffsetS * i / kOffsets;
    const double cost = best_rotation(turns, gyroscope, &x);
    if (cost < least) {
      least = cost;
      best = x;
    }
  }
  for (const SeenTurn& t : turns) {
    most += (so3_log(t.R_from_to) / rt::to_seconds(t.t_to_ns - t.t_from_ns)).squaredNorm() /
            static_cast<double>(turns.size());
  }
  if (!std::isfinite(least)) return rt::Error{"the inertial sensor's readings do not cover the camera's turns"};
  if (least > kMostLeft * most) {
    return rt::Error{"the gyroscope's turns are not those that vision saw: another flight's, or other units"};
  }
  CameraImuFit fit;
  // The last round is for its figures.
  for (int round = 0; round < 8; ++round) {
    if (!step(turns, gyroscope, &best, &fit)) return rt::Error{"rotation and time offset cannot be told apart here"};
  }
  if (std::abs(best.offset_s) > kMostTimeOffsetS) {
    return rt::Error{fmt::format("no time offset up to {} s fits", kMostTimeOffsetS)};
  }
  fit.R_body_cam = Eigen::Quaterniond(best.R_body_cam).normalized().toRotationMatrix();
  fit.gyro_bias_rad_s = best.bias;
  fit.time_offset_s = best.offset_s;
  return fit;
}

}  // namespace godwit::app
