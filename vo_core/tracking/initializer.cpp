#include "vo_core/tracking/initializer.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

#include "vo_core/features/initial_tracks.h"
#include "vo_core/geometry/homography.h"
#include "vo_core/geometry/rotation_fit.h"
#include "vo_core/map/multi_view_refine.h"

namespace godwit::vo {
namespace {

constexpr int kMaxTracks = InitialTracks::kMaxTracks;
/// Two motions differ if their directions or their rotations do by more than this.
constexpr double kSameDirectionRad = 0.17, kSameRotationRad = 0.01;
/// A candidate motion needs this share of the model's inliers in front of both cameras. Low on purpose: far points
/// fall on either side by noise; what is wrong is refused by its cost.
constexpr double kMinFrontShare = 0.6;
/// After a refused attempt the parallax has to grow by this much, and the attempt comes after so many frames anyway.
constexpr double kMinGrowth = 1.15, kMaxGrowth = 2.0;
constexpr int kMaxPostponed = 3;
/// Minima of the adjustment that are followed to the bottom; the two of a plane, normally.
constexpr int kMaxMinima = 2;
/// A minimum whose cost is so many times the best one's is followed only while four steps gain more than this share of
/// it: in 2399 decisions on tum_fr1_xyz, euroc_mh01 and two take-offs some 250 were left so, and at their bottom none
/// of them would have been another.
constexpr double kFarBehind = 2.0, kNextToNothing = 0.005;

bool same_motion(const SE3& a, const SE3& b) {
  const double c = a.t.normalized().dot(b.t.normalized());
  return std::acos(std::clamp(c, -1.0, 1.0)) < kSameDirectionRad &&
         so3_log(a.R.transpose() * b.R).norm() < kSameRotationRad;
}

TwoViewOptions two_view_options(const InitializerOptions& o) {
  return {o.ransac_iterations, o.sigma_px, o.homography_ratio};
}

}  // namespace

struct Initializer::Impl {
  struct Solution {
    MultiViewState state;
    InitModel model = InitModel::kNone;
    double cost = 0;
  };

  CameraModel camera;
  InitializerOptions options;
  InitialTracks tracks;
  TwoViewGeometry two_view;
  MultiViewRefiner refiner;

  bool started = false;
  double next_parallax_px = 0;                   ///< no attempt before
  InitStatus refused = InitStatus::kNoParallax;  ///< why the last attempt failed
  int next_frame = 0;                            ///< an attempt again at the latest
  Mat3 R_cur_ref = Mat3::Identity();             ///< best pure rotation to the latest view

  std::vector<Vec2> gathered, ref_px, cur_px;
  std::vector<double> scratch, depth_sigma;
  std::vector<double> spread;  ///< of a point's relative depth, from motion to motion that explains the tracks
  std::vector<std::uint8_t> good;
  std::array<Solution, 4> solutions;
  std::array<int, 4> order{};  ///< of the solutions, best first
  int solution_count = 0;

  SE3 T_cur_ref;
  Vec6 velocity_ref = Vec6::Zero(), velocity_cur = Vec6::Zero();
  std::vector<InitPoint> points;
  int point_count = 0;

  Impl(const CameraModel& c, const InitializerOptions& o)
      : camera(c), options(o), tracks(c, o.readout), two_view(two_view_options(o)) {
    for (auto* v : {&gathered, &ref_px, &cur_px}) v->resize(kMaxTracks);
    for (auto* v : {&scratch, &depth_sigma, &spread}) v->resize(kMaxTracks);
    good.resize(kMaxTracks);
    points.resize(kMaxTracks);
  }

  /// In the first view, z = 1.
  Vec3 ray(std::size_t p) const { return tracks.ref_xy()[p].homogeneous(); }
  std::size_t living() const { return tracks.count(); }
  double focal() const { return 1.0 / camera.rad_per_px(); }

  double median(int n) {
    const auto middle = scratch.begin() + n / 2;
    std::nth_element(scratch.begin(), middle, scratch.begin() + n);
    return *middle;
  }

  InitReport start(const rt::PyramidView& frame, const rt::MaskPyramidView& mask, const ReadoutMotion& motion,
                   InitStatus status) {
    InitReport report;
    R_cur_ref.setIdentity();
    report.tracks = tracks.start(frame, mask, motion, options.features, 2 * options.min_tracks);
    next_parallax_px = 0;
    next_frame = 0;
    refused = InitStatus::kNoParallax;
    started = report.tracks >= options.min_tracks;
    report.status = started ? status : InitStatus::kTooFewFeatures;
    return report;
  }

  /// Median of value(p) over the accepted tracks, of which there must be one.
  template <typename Value>
  double median_of_good(const Value& value) {
    int n = 0;
    for (std::size_t p = 0; p < living(); ++p)
      if (good[p] != 0) scratch[n++] = value(p);
    return median(n);
  }

  /// Views for the refinement: the present one and, spread evenly over them, past ones that saw at least a quarter of
  /// its parallax. Returns how many; the last is the present one.
  int choose_views(std::array<int, MultiViewRefiner::kMaxViews>* chosen) const {
    const double least = 0.25 * tracks.history(tracks.history_count() - 1).parallax_px;
    std::array<int, InitialTracks::kHistory> usable;
    int n = 0;
    for (int k = 0; k + 1 < tracks.history_count(); ++k)
      if (tracks.history(k).parallax_px >= least) usable[n++] = k;
    const int take = std::min(n, MultiViewRefiner::kMaxViews - 1);
    for (int k = 0; k < take; ++k) (*chosen)[k] = usable[(2 * k + 1) * n / (2 * take)];
    (*chosen)[take] = tracks.history_count() - 1;
    return take + 1;
  }

  /// From a motion of two views to all views: depths by triangulation, the views between by pose alone, then together
  /// in at most so many steps.
  void solve(const TwoViewCandidate& candidate, int views, int steps, Solution* out) {
    out->model = candidate.model;
    MultiViewState& state = out->state;
    const int last = views - 1;
    for (int k = 0; k < views; ++k) state.T_view_ref[k] = candidate.T_b_a;
    int positive = 0;
    for (std::size_t p = 0; p < living(); ++p) {
      double inverse_depth = 0;
      if (!triangulate_inverse_depth(candidate.T_b_a, tracks.ref_xy()[p], tracks.cur_xy()[p], &inverse_depth))
        inverse_depth = 0;
      state.inverse_depth[p] = inverse_depth;
      if (inverse_depth > 0) scratch[positive++] = inverse_depth;
    }
    const double typical = positive > 0 ? median(positive) : 1.0;
    for (std::size_t p = 0; p < living(); ++p) {
      double& rho = state.inverse_depth[p];
      if (!(rho > 0.1 * typical && rho < 10.0 * typical)) rho = typical;
    }
    refiner.refine_pose(last, 3, &state);
    const double length = state.T_view_ref[last].t.norm();
    if (length > 1e-6) {  // the pose alone is free in length; the unit is the last view's distance
      state.T_view_ref[last].t /= length;
      for (std::size_t p = 0; p < living(); ++p) state.inverse_depth[p] *= length;
    }
    for (int k = last - 1; k >= 0; --k) {
      state.T_view_ref[k] = state.T_view_ref[k + 1];
      refiner.refine_pose(k, 4, &state);
    }
    refiner.refine(steps, &state);
  }

  Solution& solution(int k) { return solutions[order[k]]; }

  /// The weights' width follows the residuals from stage to stage. One that is far behind the best one and gains next
  /// to nothing in a stage stays behind.
  void to_bottom(int k, bool behind) {
    for (int stage = 0; stage < 3; ++stage) {
      const double gained = refiner.refine(4, &solution(k).state);
      if (behind && gained < kNextToNothing) return;
    }
  }

  /// Sorts the first n places of `order` by cost, reckoned for all with the noise of the one that fits best.
  void rank(int n) {
    double noise = std::numeric_limits<double>::max();
    for (int k = 0; k < n; ++k) noise = std::min(noise, refiner.sigma(solution(k).state));
    for (int k = 0; k < n; ++k) solution(k).cost = refiner.cost(solution(k).state, noise);
    for (int i = 1; i < n; ++i)
      for (int j = i; j > 0 && solution(j).cost < solution(j - 1).cost; --j) std::swap(order[j], order[j - 1]);
  }

  /// Marks the points that fit every view, lie in front and are neither absurdly near nor far. Returns their number.
  int judge(const MultiViewState& state, double noise_px) {
    int n = 0;
    for (std::size_t p = 0; p < living(); ++p) {
      if (state.inverse_depth[p] > 0) scratch[n++] = state.inverse_depth[p];
    }
    if (n == 0) return 0;
    const double typical = median(n);
    int accepted = 0;
    for (std::size_t p = 0; p < living(); ++p) {
      const double rho = state.inverse_depth[p];
      good[p] =
          rho > 0.02 * typical && rho < 20.0 * typical && refiner.point_rms(state, static_cast<int>(p)) < 2.5 * noise_px
              ? 1
              : 0;
      accepted += good[p];
    }
    return accepted;
  }

  /// If the points are a plane, there is a second motion that shows it alike: as the last two solutions, as it is and
  /// at the bottom from there. Elsewhere that falls back into the best one, or costs far more. On a climb the valley
  /// between both is flat: what has slid to its other end no longer tells how long it is, what has not is dearer than
  /// it need be.
  void add_other_motion_of_plane(int views) {
    const Solution& best = solution(0);
    const SE3& T = best.state.T_view_ref[views - 1];
    Mat3 A = Mat3::Zero();
    Vec3 b = Vec3::Zero();
    for (std::size_t p = 0; p < living(); ++p) {
      A.noalias() += ray(p) * ray(p).transpose();
      b.noalias() += best.state.inverse_depth[p] * ray(p);
    }
    TwoViewCandidate other;
    if (!other_motion_of_plane(T, A.ldlt().solve(b), &other.T_b_a)) return;
    other.T_b_a.t.normalize();
    other.model = InitModel::kHomography;
    // `order` holds every solution once: what is kept stands first, the two places after it are free.
    solve(other, views, 0, &solution(solution_count));
    solution(solution_count + 1) = solution(solution_count);
    to_bottom(solution_count + 1, false);
    solution_count += 2;
    rank(solution_count);
  }

  /// What a second minimum says of the first, if it fits about as well. With other depths it makes the map ambiguous.
  /// With almost the same it is an error bar: a plane, and a motion along its normal, have two minima that move apart
  /// with the root of the noise, the truth between them, and the curvature at either knows nothing of the other.
  void compare(const Solution& best, const Solution& other, InitReport* report) {
    const auto stretch = [&](std::size_t p) { return other.state.inverse_depth[p] / best.state.inverse_depth[p]; };
    const double scale = median_of_good(stretch), ratio = best.cost / other.cost;
    if (!(scale > 0)) return;  // the best one turned inside out, all points behind the cameras: no world
    const auto apart = [&](std::size_t p) { return std::abs(stretch(p) / scale - 1.0); };
    if (median_of_good(apart) > options.max_depth_uncertainty) {
      report->ambiguity = std::max(report->ambiguity, ratio);
    } else if (ratio > options.max_ambiguity) {
      for (std::size_t p = 0; p < living(); ++p)
        if (good[p] != 0) spread[p] = std::max(spread[p], apart(p));
    }
  }

  /// The camera's velocity (left twist rate of its T_cam_world) that moves the accepted points as their tracks did at
  /// the view: least squares on the plane z = 1. scale: of the points' depths.
  Vec6 camera_velocity(const InitialTracks::View& view, const SE3& T_view_ref, const MultiViewState& state,
                       double scale) const {
    Mat6 H = Mat6::Zero();
    Vec6 b = Vec6::Zero();
    for (std::size_t p = 0; p < living(); ++p) {
      if (good[p] == 0) continue;
      const Vec3 q = T_view_ref * (ray(p) * (scale / state.inverse_depth[p]));
      Mat23 to_plane;
      to_plane << 1.0, 0.0, -q.x() / q.z(), 0.0, 1.0, -q.y() / q.z();
      to_plane /= q.z();
      Mat26 J;
      J << to_plane, -to_plane * skew(q);
      H.noalias() += J.transpose() * J;
      b.noalias() += J.transpose() * view.velocity[tracks.track_of(p)];
    }
    const Vec6 velocity = H.ldlt().solve(b);
    return velocity.allFinite() ? velocity : Vec6::Zero();
  }

  Vec2f to_picture(const Vec2& xy, const Vec2f& otherwise) const {
    Vec2 px;
    return camera.project(Vec3(xy.x(), xy.y(), 1.0), &px) ? Vec2f(px.cast<float>()) : otherwise;
  }

  /// Writes the accepted points with median depth 1.
  void publish(const MultiViewState& state, int views) {
    const double scale = 1.0 / median_of_good([&](std::size_t p) { return 1.0 / state.inverse_depth[p]; });
    T_cur_ref = state.T_view_ref[views - 1];
    T_cur_ref.t *= scale;
    velocity_ref = camera_velocity(tracks.first(), SE3(), state, scale);
    velocity_cur = camera_velocity(tracks.latest(), T_cur_ref, state, scale);
    point_count = 0;
    for (std::size_t p = 0; p < living(); ++p) {
      if (good[p] == 0) continue;
      const std::size_t track = tracks.track_of(p);
      const double depth = scale / state.inverse_depth[p];
      const Vec2f px_ref = tracks.px_ref(track), px_cur = tracks.px_cur(track);
      points[point_count++] = {px_ref,
                               px_cur,
                               to_picture(tracks.ref_xy()[p], px_ref),
                               to_picture(tracks.cur_xy()[p], px_cur),
                               static_cast<std::int8_t>(tracks.level(track)),
                               depth * ray(p),
                               depth_sigma[p] * depth * ray(p).norm()};
    }
  }

  /// How many of the tracks that were not accepted follow one motion, whichever.
  int agreeing_among_others() {
    std::size_t others = 0;
    for (std::size_t p = 0; p < living(); ++p) {
      if (good[p] != 0) continue;
      ref_px[others] = ref_px[p];
      cur_px[others++] = cur_px[p];
    }
    constexpr std::size_t kLeast = 8;
    return others < kLeast ? 0 : two_view.estimate({ref_px.data(), others}, {cur_px.data(), others}, focal()).inliers;
  }

  void postpone(const InitReport& report);

  /// The decision on the packed tracks. The caller has found enough disparity and parallax.
  void decide(InitReport* report) {
    for (std::size_t p = 0; p < living(); ++p) {
      ref_px[p] = focal() * tracks.ref_xy()[p];
      cur_px[p] = focal() * tracks.cur_xy()[p];
    }
    const std::size_t n = living();
    const TwoViewResult pair = two_view.estimate({ref_px.data(), n}, {cur_px.data(), n}, focal());
    report->model = pair.model;
    report->inliers = pair.inliers;
    report->ratio_homography = pair.ratio_homography;
    report->status = InitStatus::kNoModel;
    if (pair.inliers < options.min_points) return;

    std::array<int, MultiViewRefiner::kMaxViews> chosen;
    const int views = choose_views(&chosen);
    refiner.begin({tracks.ref_xy().data(), n}, focal(), options.min_noise_px);
    for (int k = 0; k < views; ++k) {
      const InitialTracks::View& view = tracks.history(chosen[k]);
      for (std::size_t i = 0; i < n; ++i) gathered[i] = view.at_middle_row(tracks.track_of(i), options.readout);
      refiner.add_view({gathered.data(), n});
    }

    solution_count = 0;
    for (int k = 0; k < pair.candidate_count; ++k) {
      const TwoViewCandidate& candidate = pair.candidates[k];
      if (candidate.in_front < kMinFrontShare * pair.inliers) continue;
      solve(candidate, views, 3, &solutions[solution_count++]);
    }
    if (solution_count == 0) return;
    std::iota(order.begin(), order.end(), 0);
    rank(solution_count);
    // Candidates of both models often fall into the same minimum: each minimum is followed to its bottom once.
    const int last = views - 1;
    int kept = 1;
    for (int k = 1; k < solution_count; ++k) {
      bool known = false;
      for (int j = 0; j < kept; ++j)
        known = known || same_motion(solution(j).state.T_view_ref[last], solution(k).state.T_view_ref[last]);
      if (!known) std::swap(order[kept++], order[k]);
    }
    solution_count = std::min(kept, kMaxMinima);
    const double best_cost = solution(0).cost;
    for (int k = 0; k < solution_count; ++k) to_bottom(k, solution(k).cost > kFarBehind * best_cost);
    rank(solution_count);
    if (solution_count < 2 || same_motion(solution(0).state.T_view_ref[last], solution(1).state.T_view_ref[last]))
      add_other_motion_of_plane(views);
    Solution& s = solution(0);
    report->noise_px = refiner.sigma(s.state);
    report->points = judge(s.state, report->noise_px);
    if (report->points < options.min_points) return;
    report->status = InitStatus::kNoParallax;
    if (!refiner.relative_depth_sigma(s.state, report->noise_px, {good.data(), n}, {depth_sigma.data(), n},
                                      &report->baseline_uncertainty))
      return;
    std::fill(spread.begin(), spread.end(), 0.0);
    for (int k = 1; k < solution_count; ++k) compare(s, solution(k), report);
    for (std::size_t p = 0; p < n; ++p) depth_sigma[p] = std::hypot(depth_sigma[p], spread[p]);
    report->depth_uncertainty = median_of_good([&](std::size_t p) { return depth_sigma[p]; });
    const Vec3 centre = s.state.T_view_ref[last].centre();
    report->median_parallax_deg = median_of_good([&](std::size_t p) {
      const Vec3 point = ray(p) / s.state.inverse_depth[p];
      const double c = point.normalized().dot((point - centre).normalized());
      return std::acos(std::clamp(c, -1.0, 1.0)) * 180.0 / M_PI;
    });
    if (report->median_parallax_deg < options.min_parallax_deg) return;
    if (report->depth_uncertainty > options.max_depth_uncertainty) return;
    report->status = InitStatus::kTurnOrWay;
    if (report->baseline_uncertainty > options.max_baseline_uncertainty) return;
    report->status = InitStatus::kAmbiguous;
    if (report->ambiguity > options.max_ambiguity) return;
    report->status = InitStatus::kTwoMotions;
    report->second_motion = static_cast<double>(agreeing_among_others()) / report->points;
    if (report->second_motion > options.max_second_motion) return;
    publish(s.state, views);
    report->status = InitStatus::kDone;
  }
};

// An attempt costs as much as several frames of tracking: after a refusal the next one waits until the parallax has
// grown about as much as was missing.
void Initializer::Impl::postpone(const InitReport& report) {
  double missing = kMinGrowth;
  if (report.median_parallax_deg > 0)
    missing = std::max(missing, options.min_parallax_deg / report.median_parallax_deg);
  if (report.depth_uncertainty > 0)
    missing = std::max(missing, report.depth_uncertainty / options.max_depth_uncertainty);
  next_parallax_px = report.parallax_px * std::min(missing, kMaxGrowth);
  next_frame = tracks.frames() + kMaxPostponed;
}

Initializer::Initializer(const CameraModel& camera, const InitializerOptions& options)
    : impl_(std::make_unique<Impl>(camera, options)) {}
Initializer::~Initializer() = default;

void Initializer::reset() {
  impl_->started = false;
  impl_->point_count = 0;
}

InitReport Initializer::add_frame(const rt::PyramidView& frame, const rt::MaskPyramidView& mask, bool decide,
                                  const ReadoutMotion& motion) {
  Impl& m = *impl_;
  m.point_count = 0;
  if (!m.started) return m.start(frame, mask, motion, InitStatus::kFirstFrame);
  InitReport report;
  report.tracks = m.tracks.follow(frame, mask, motion, &report.median_disparity_px);
  if (report.tracks < m.options.min_tracks) return m.start(frame, mask, motion, InitStatus::kTracksLost);
  const std::size_t n = report.tracks;
  report.parallax_px =
      fit_rotation({m.tracks.ref_xy().data(), n}, {m.tracks.cur_xy().data(), n}, m.focal(), m.scratch, &m.R_cur_ref);
  m.tracks.latest().parallax_px = report.parallax_px;
  if (report.median_disparity_px < m.options.min_disparity_px) {
    report.status = InitStatus::kNoMotion;
    constexpr double kMedianOffPx = 0.25;  // of many tracks, half a pixel each
    report.still_rad = (report.median_disparity_px + kMedianOffPx) / m.focal();
  } else if (report.parallax_px < m.options.min_parallax_px || m.tracks.frames() < m.options.min_views) {
    report.status = InitStatus::kNoParallax;
  } else if (!decide || (report.parallax_px < m.next_parallax_px && m.tracks.frames() < m.next_frame)) {
    report.status = m.refused;
  } else {
    m.decide(&report);
    if (report.status != InitStatus::kDone) m.refused = report.status;
    m.postpone(report);
  }
  return report;
}

std::span<const InitialTracks::InThreeViews> Initializer::in_three_views() const {
  return impl_->tracks.in_three_views();
}

const SE3& Initializer::T_cur_ref() const {
  return impl_->T_cur_ref;
}
const Vec6& Initializer::velocity_ref() const {
  return impl_->velocity_ref;
}
const Vec6& Initializer::velocity_cur() const {
  return impl_->velocity_cur;
}
std::span<const InitPoint> Initializer::points() const {
  return std::span(impl_->points).first(impl_->point_count);
}

}  // namespace godwit::vo
