#include "vo_core/map/multi_view_refine.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <hwy/highway.h>
#include <limits>
#include <vector>

#include "vo_core/map/inverse_depth_rows.h"

namespace godwit::vo {
namespace {
namespace hn = hwy::HWY_NAMESPACE;

constexpr int kMaxViews = MultiViewState::kMaxViews;
constexpr int kRoom = MultiViewState::kMaxPoints;
constexpr int kMaxDim = 6 * kMaxViews;
/// Width of the Cauchy weight in sigmas: 95 % efficiency under Gaussian noise.
constexpr double kCauchy = 2.385;
/// Median length of a two-dimensional Gaussian vector in sigmas.
constexpr double kMedianRayleigh = 1.1774;
/// Cost of a measurement behind a view [sigma^2]: that of a 100 sigma outlier.
const double kBehindCost = kCauchy * kCauchy * std::log1p(1e4 / (kCauchy * kCauchy));
/// Weight of the residual |t_last| - 1 [px^2]; a free direction otherwise, so any large value serves.
constexpr double kScaleWeight = 1e6;

/// A step that gains less than this share of the cost is the last. With 1e-4 a climb's first map stopped in its flat
/// valley: take-off-and-land, seed 2, 0.31 m instead of 0.06.
constexpr double kConverged = 1e-5;

/// Lower Cholesky factor in place. False if not positive definite. Plain loops: Eigen's blocked one may allocate.
bool cholesky(std::vector<double>* matrix, int n) {
  double* a = matrix->data();
  for (int j = 0; j < n; ++j) {
    double d = a[j * kMaxDim + j];
    for (int k = 0; k < j; ++k) d -= a[j * kMaxDim + k] * a[j * kMaxDim + k];
    if (!(d > 1e-12)) return false;
    d = std::sqrt(d);
    a[j * kMaxDim + j] = d;
    for (int i = j + 1; i < n; ++i) {
      double s = a[i * kMaxDim + j];
      for (int k = 0; k < j; ++k) s -= a[i * kMaxDim + k] * a[j * kMaxDim + k];
      a[i * kMaxDim + j] = s / d;
    }
  }
  return true;
}

/// x = L^-1 x.
void solve_lower(const std::vector<double>& l, int n, double* x) {
  for (int i = 0; i < n; ++i) {
    double s = x[i];
    for (int k = 0; k < i; ++k) s -= l[i * kMaxDim + k] * x[k];
    x[i] = s / l[i * kMaxDim + i];
  }
}

/// x = L^-T x.
void solve_upper(const std::vector<double>& l, int n, double* x) {
  for (int i = n - 1; i >= 0; --i) {
    double s = x[i];
    for (int k = i + 1; k < n; ++k) s -= l[k * kMaxDim + i] * x[k];
    x[i] = s / l[i * kMaxDim + i];
  }
}

/// Normal equations at one state, points kept apart from views.
struct Normal {
  std::array<Mat6, kMaxViews> A;
  std::array<Vec6, kMaxViews> b;
  std::vector<double> W = std::vector<double>(kMaxDim * kRoom);  // column a point
  std::array<double, kRoom> C{}, d{};
  double cost = 0;
};

}  // namespace

struct MultiViewRefiner::Impl {
  int points = 0, views = 0;
  double focal_px = 1, min_sigma_px = 0.1;
  std::array<double, kRoom> ray_x{}, ray_y{}, odds{}, per_C{};
  std::array<std::array<double, kRoom>, 2> scaled{};
  std::vector<double> measured_x = std::vector<double>(kMaxViews * kRoom), measured_y = measured_x;
  std::array<Normal, 2> normal;
  std::vector<double> S = std::vector<double>(kMaxDim * kMaxDim);
  std::vector<double> scratch = std::vector<double>(kMaxViews * kRoom);
  MultiViewState trial;

  /// Of one point in one view, squared [px^2]; negative behind it.
  double squared_error(const MultiViewState& state, int view, int p) const {
    const SE3& T = state.T_view_ref[view];
    const double x = ray_x[p], y = ray_y[p], rho = state.inverse_depth[p];
    const double z = T.R(2, 0) * x + T.R(2, 1) * y + T.R(2, 2) + rho * T.t.z();
    if (!(z > 1e-3)) return -1.0;
    const double u = (T.R(0, 0) * x + T.R(0, 1) * y + T.R(0, 2) + rho * T.t.x()) / z - measured_x[view * kRoom + p];
    const double v = (T.R(1, 0) * x + T.R(1, 1) * y + T.R(1, 2) + rho * T.t.y()) / z - measured_y[view * kRoom + p];
    return focal_px * focal_px * (u * u + v * v);
  }
  InverseDepthRows rows(int view, const MultiViewState& state) const {
    return {ray_x.data(),
            ray_y.data(),
            state.inverse_depth.data(),
            measured_x.data() + view * kRoom,
            measured_y.data() + view * kRoom,
            points,
            focal_px};
  }

  void build(const MultiViewState& state, double sigma_px, Normal* n) {
    const double width2 = kCauchy * kCauchy * sigma_px * sigma_px;
    n->C.fill(0.0);
    n->d.fill(0.0);
    odds.fill(1.0);
    int behind = 0;
    for (int k = 0; k < views; ++k) {
      InverseDepthPoints out{n->C.data(), n->d.data(), odds.data(), {}};
      for (int r = 0; r < 6; ++r) out.cross[r] = n->W.data() + (6 * k + r) * kRoom;
      behind += build_rows(state.T_view_ref[k], rows(k, state), width2, &n->A[k], &n->b[k], &out);
    }
    // Of a point's views the logarithms' sum is that of their product.
    double logarithms = 0.0;
    for (int p = 0; p < points; ++p) logarithms += std::log(odds[p]);
    n->cost = behind * kBehindCost + kCauchy * kCauchy * logarithms;
  }

  /// Reduced system of the views, damped, factored in S. False if it is not positive definite.
  bool reduce(const MultiViewState& state, const Normal& n, double damping, double* g) {
    const int dim = 6 * views;
    std::fill(S.begin(), S.end(), 0.0);
    for (int k = 0; k < views; ++k) {
      for (int r = 0; r < 6; ++r) {
        for (int c = 0; c <= r; ++c) S[(6 * k + r) * kMaxDim + 6 * k + c] = n.A[k](r, c);
        S[(6 * k + r) * kMaxDim + 6 * k + r] *= 1.0 + damping;
        g[6 * k + r] = n.b[k](r);
      }
    }
    const Vec3& t = state.T_view_ref[views - 1].t;  // length 1
    for (int r = 0; r < 3; ++r)
      for (int c = 0; c <= r; ++c) S[(dim - 6 + r) * kMaxDim + dim - 6 + c] += kScaleWeight * t(r) * t(c);
    per_C.fill(0.0);
    for (int p = 0; p < points; ++p) per_C[p] = point_inverse(n, p, damping);
    for (int r = 0; r < dim; r += 2) subtract_points(n, r, g);
    return cholesky(&S, dim);
  }

  /// W C^-1 W^T and W C^-1 d, rows r and r + 1 of them, in blocks of 2 x 4: what is loaded serves twice and more. Right
  /// of the diagonal they may write what nobody reads.
  void subtract_points(const Normal& n, int r, double* g) {
    const hn::CappedTag<double, 4> lanes;
    const int step = static_cast<int>(hn::Lanes(lanes)), end = (points + 3) / 4 * 4;
    for (int i = 0; i < 2; ++i)
      for (int p = 0; p < end; ++p) scaled[i][p] = per_C[p] * n.W[(r + i) * kRoom + p];
    for (int c = 0; c <= r + 1; c += 4) {
      const double* const w = &n.W[c * kRoom];
      std::array<hn::Vec<decltype(lanes)>, 8> sum;
      sum.fill(hn::Zero(lanes));
      for (int p = 0; p < end; p += step) {
        const auto a = hn::LoadU(lanes, &scaled[0][p]), b = hn::LoadU(lanes, &scaled[1][p]);
        for (int k = 0; k < 4; ++k) {
          const auto column = hn::LoadU(lanes, w + k * kRoom + p);
          sum[k] = hn::MulAdd(a, column, sum[k]);
          sum[4 + k] = hn::MulAdd(b, column, sum[4 + k]);
        }
      }
      for (int i = 0; i < 2; ++i)
        for (int k = 0; k < 4; ++k) S[(r + i) * kMaxDim + c + k] -= hn::GetLane(hn::SumOfLanes(lanes, sum[4 * i + k]));
    }
    for (int i = 0; i < 2; ++i)
      for (int p = 0; p < points; ++p) g[r + i] -= scaled[i][p] * n.d[p];
  }

  /// 1 / C, 0 where the point has no parallax at all and so must not move.
  static double point_inverse(const Normal& n, int p, double damping) {
    const double c = n.C[p] * (1.0 + damping);
    return c > 1e-6 ? 1.0 / c : 0.0;
  }

  bool step(const MultiViewState& state, const Normal& n, double damping, MultiViewState* next) {
    std::array<double, kMaxDim> x{};
    if (!reduce(state, n, damping, x.data())) return false;
    const int dim = 6 * views;
    solve_lower(S, dim, x.data());
    solve_upper(S, dim, x.data());
    for (int k = 0; k < views; ++k) {
      const Eigen::Map<const Vec6> dx(x.data() + 6 * k);
      const SE3& T = state.T_view_ref[k];
      next->T_view_ref[k] = {so3_exp(-dx.tail<3>()) * T.R, T.t - dx.head<3>()};
    }
    std::array<double, kRoom>& left = scaled[0];
    std::copy_n(n.d.begin(), points, left.begin());
    for (int r = 0; r < dim; ++r)
      for (int p = 0; p < points; ++p) left[p] -= n.W[r * kRoom + p] * x[r];
    for (int p = 0; p < points; ++p)
      next->inverse_depth[p] = state.inverse_depth[p] - point_inverse(n, p, damping) * left[p];
    const double length = next->T_view_ref[views - 1].t.norm();
    if (!(length > 1e-3 && length < 1e3)) return false;
    for (int k = 0; k < views; ++k) {
      next->T_view_ref[k].t /= length;
      next->T_view_ref[k].normalize();
    }
    for (int i = 0; i < points; ++i) next->inverse_depth[i] *= length;
    return true;
  }
};

MultiViewRefiner::MultiViewRefiner() : impl_(std::make_unique<Impl>()) {}
MultiViewRefiner::~MultiViewRefiner() = default;

void MultiViewRefiner::begin(std::span<const Vec2> rays, double focal_px, double min_sigma_px) {
  Impl& m = *impl_;
  m.points = static_cast<int>(std::min<std::size_t>(rays.size(), kRoom));
  m.views = 0;
  m.focal_px = focal_px;
  m.min_sigma_px = min_sigma_px;
  for (int p = 0; p < m.points; ++p) {
    m.ray_x[p] = rays[p].x();
    m.ray_y[p] = rays[p].y();
  }
}

void MultiViewRefiner::add_view(std::span<const Vec2> measured) {
  Impl& m = *impl_;
  if (m.views == kMaxViews || std::ssize(measured) < m.points) return;
  for (int p = 0; p < m.points; ++p) {
    m.measured_x[m.views * kRoom + p] = measured[p].x();
    m.measured_y[m.views * kRoom + p] = measured[p].y();
  }
  ++m.views;
}

void MultiViewRefiner::refine_pose(int view, int iterations, MultiViewState* state) const {
  const Impl& m = *impl_;
  SE3& T = state->T_view_ref[view];
  for (int iteration = 0; iteration < iterations; ++iteration) {
    Mat6 A;
    Vec6 b;
    // The start may be several pixels off: a wide weight that narrows as the steps go on.
    const double width = std::max(kCauchy * m.min_sigma_px, 8.0 / (1 << std::min(iteration, 5)));
    build_rows(T, m.rows(view, *state), width * width, &A, &b, nullptr);
    A.diagonal() *= 1.0 + 1e-6;
    const Vec6 dx = A.ldlt().solve(b);
    if (!dx.allFinite()) return;
    T = {so3_exp(-dx.tail<3>()) * T.R, T.t - dx.head<3>()};
    T.normalize();
  }
}

double MultiViewRefiner::refine(int iterations, MultiViewState* state) {
  Impl& m = *impl_;
  const double sigma_px = sigma(*state);
  Normal* current = &m.normal[0];
  Normal* next = &m.normal[1];
  m.build(*state, sigma_px, current);
  const double at_first = current->cost;
  double damping = 1e-4;
  for (int iteration = 0; iteration < iterations; ++iteration) {
    if (!m.step(*state, *current, damping, &m.trial)) {
      damping = std::max(1e-3, damping * 10.0);
      continue;
    }
    m.build(m.trial, sigma_px, next);
    if (next->cost < current->cost) {
      const bool converged = current->cost - next->cost < kConverged * current->cost;
      *state = m.trial;
      std::swap(current, next);
      damping *= 0.1;
      if (converged) break;
    } else {
      damping = std::max(1e-3, damping * 10.0);
    }
  }
  return at_first > 0.0 ? 1.0 - current->cost / at_first : 0.0;
}

double MultiViewRefiner::cost(const MultiViewState& state, double sigma_px) const {
  const Impl& m = *impl_;
  const double width2 = kCauchy * kCauchy * sigma_px * sigma_px;
  double sum = 0;
  for (int p = 0; p < m.points; ++p) {
    double odds = 1.0;  // the logarithms' sum is that of their product
    for (int k = 0; k < m.views; ++k) {
      const double error = m.squared_error(state, k, p);
      if (error < 0.0) sum += kBehindCost;
      odds *= 1.0 + std::max(error, 0.0) / width2;
    }
    sum += kCauchy * kCauchy * std::log(odds);
  }
  return sum;
}

double MultiViewRefiner::sigma(const MultiViewState& state) {
  Impl& m = *impl_;
  std::ptrdiff_t count = 0;
  for (int k = 0; k < m.views; ++k) {
    for (int p = 0; p < m.points; ++p) {
      const double error = m.squared_error(state, k, p);
      m.scratch[count++] = error < 0.0 ? std::numeric_limits<double>::max() : error;
    }
  }
  if (count == 0) return m.min_sigma_px;
  const auto middle = m.scratch.begin() + count / 2;
  std::nth_element(m.scratch.begin(), middle, m.scratch.begin() + count);
  // Each point's own depth takes one of its 2 x views degrees of freedom.
  const double freedom = std::sqrt(2.0 * m.views / (2.0 * m.views - 1.0));
  return std::max(m.min_sigma_px, std::min(std::sqrt(*middle) / kMedianRayleigh * freedom, 1e3));
}

double MultiViewRefiner::point_rms(const MultiViewState& state, int point) const {
  const Impl& m = *impl_;
  double sum = 0;
  for (int k = 0; k < m.views; ++k) {
    const double error = m.squared_error(state, k, point);
    if (error < 0.0) return std::numeric_limits<double>::infinity();
    sum += error;
  }
  return std::sqrt(sum / (2.0 * m.views));
}

bool MultiViewRefiner::relative_depth_sigma(const MultiViewState& state, double sigma_px,
                                            std::span<const std::uint8_t> use, std::span<double> out,
                                            double* baseline) {
  Impl& m = *impl_;
  Normal& n = m.normal[0];
  m.build(state, sigma_px, &n);
  std::array<double, kMaxDim> unused{}, mean{};
  if (!m.reduce(state, n, 1e-9, unused.data())) return false;
  const int dim = 6 * m.views;
  // A change x of the views moves point i's log inverse depth by -W_i x / (C_i rho_i); the mean of that over the points
  // is a change of the baseline, whose length is the unit.
  const auto slope = [&](int p) {
    const double inverse = Impl::point_inverse(n, p, 0.0);
    return -inverse / state.inverse_depth[p];
  };
  double used = 0;
  for (int p = 0; p < m.points; ++p) {
    if (use[p] == 0) continue;
    used += 1;
    for (int r = 0; r < dim; ++r) mean[r] += slope(p) * n.W[r * kRoom + p];
  }
  if (used < 1) return false;
  for (double& v : mean) v /= used;
  // One sigma of a row's value, the views being as uncertain as S^-1 says, and `own` besides.
  const auto one_sigma = [&](std::array<double, kMaxDim> x, double own) {
    solve_lower(m.S, dim, x.data());
    for (int r = 0; r < dim; ++r) own += x[r] * x[r];
    return sigma_px * std::sqrt(own);
  };
  *baseline = one_sigma(mean, 0.0);
  for (int p = 0; p < m.points; ++p) {
    const double inverse = Impl::point_inverse(n, p, 0.0);
    if (!(inverse > 0)) {
      out[p] = std::numeric_limits<double>::infinity();
      continue;
    }
    std::array<double, kMaxDim> x{};
    for (int r = 0; r < dim; ++r) {
      x[r] = slope(p) * n.W[r * kRoom + p] - mean[r];
    }
    out[p] = one_sigma(x, inverse / (state.inverse_depth[p] * state.inverse_depth[p]));
  }
  return true;
}

}  // namespace godwit::vo
