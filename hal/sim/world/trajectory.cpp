#include "hal/sim/world/trajectory.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "hal/sim/world/random.h"

namespace godwit::sim {
namespace {
constexpr double kRad = std::numbers::pi / 180.0;
constexpr double kPlanStep = 0.05;  // [s] of the rough plan
constexpr double kKnot = 0.25;      // [s] between control points
constexpr int kBlurSteps = 12;      // the rough plan is averaged over +- this many steps: rounds corners

struct Rough {
  Vec3 p;
  double yaw = 0;
  Vec2 tilt = Vec2::Zero();  ///< pitch and roll beyond what flying takes
};

/// Walks the legs with a trapezoidal speed; corners of position and yaw are rounded afterwards.
class Planner {
 public:
  Planner(const TrajectoryPlan& plan, double ground_m) : plan_(plan), ground_(ground_m) {
    now_.p = Vec3(plan.start_m.x(), plan.start_m.y(), ground_m + plan.start_height_m);
    now_.yaw = plan.heading_deg * kRad;
    hold(0.5);
  }

  void add(const Leg& leg) {
    const Vec3 forward(std::cos(now_.yaw), std::sin(now_.yaw), 0), left(-forward.y(), forward.x(), 0);
    switch (leg.kind) {
      case LegKind::kHover:
        hold(leg.duration_s);
        break;
      case LegKind::kTakeOff:
      case LegKind::kClimb:
        along({Vec3(now_.p.x(), now_.p.y(), ground_ + leg.height_m)}, leg.speed_m_s, false);
        break;
      case LegKind::kLand:
        along({Vec3(now_.p.x(), now_.p.y(), ground_ + plan_.start_height_m)}, leg.speed_m_s, false);
        hold(1.0);
        break;
      case LegKind::kDash:
        along({now_.p + leg.distance_m * forward}, leg.speed_m_s, false);
        break;
      case LegKind::kPath: {
        std::vector<Vec3> points;
        for (const Vec2& p : leg.points_m) points.emplace_back(p.x(), p.y(), now_.p.z());
        along(points, leg.speed_m_s, leg.face_path);
        break;
      }
      case LegKind::kSurvey: {
        std::vector<Vec3> points;
        const Vec3 origin = now_.p;
        const int lanes = static_cast<int>(std::floor(leg.width_m / leg.spacing_m)) + 1;
        for (int i = 0; i < lanes; ++i) {
          const Vec3 lane = origin + i * leg.spacing_m * left;
          const Vec3 far = lane + leg.length_m * forward;
          points.push_back(i % 2 == 0 ? lane : far);
          points.push_back(i % 2 == 0 ? far : lane);
        }
        along(points, leg.speed_m_s, leg.face_path);
        break;
      }
      case LegKind::kSpin:
        spin(leg.angle_deg * kRad, leg.rate_deg_s * kRad);
        break;
      case LegKind::kTilt:
        tilt(Vec2(leg.pitch_deg, leg.roll_deg) * kRad, leg.rate_deg_s * kRad);
        break;
    }
  }

  const std::vector<Rough>& rough() const { return rough_; }

 private:
  void hold(double s) {
    for (double t = 0; t < s; t += kPlanStep) rough_.push_back(now_);
  }

  /// Distance gone after t seconds of a move of given length that speeds up and slows down at rate a.
  static double trapezoid(double t, double length, double speed, double a, double* total_s) {
    const double v = std::min(speed, std::sqrt(length * a));
    const double ramp = v / a, cruise = length / v - ramp;
    *total_s = 2 * ramp + cruise;
    if (t >= *total_s) return length;
    if (t < ramp) return 0.5 * a * t * t;
    if (t < ramp + cruise) return 0.5 * a * ramp * ramp + v * (t - ramp);
    const double left = *total_s - t;
    return length - 0.5 * a * left * left;
  }

  void along(const std::vector<Vec3>& points, double speed, bool face) {
    std::vector<Vec3> line{now_.p};
    std::vector<double> reach{0};
    for (const Vec3& p : points) {
      const double step = (p - line.back()).norm();
      if (step < 1e-6) continue;
      line.push_back(p);
      reach.push_back(reach.back() + step);
    }
    const double length = reach.back();
    if (length <= 0) return;
    // Turn to the first direction before moving, so that the nose does not swing in flight.
    if (face) turn_to(line[1] - line[0], 45 * kRad);
    double total = 0;
    std::size_t i = 1;
    for (double t = 0;; t += kPlanStep) {
      const double s = trapezoid(t, length, speed, plan_.acceleration_m_s2, &total);
      if (t >= total) break;
      while (i + 1 < line.size() && s > reach[i]) ++i;
      const Vec3 direction = (line[i] - line[i - 1]) / (reach[i] - reach[i - 1]);
      now_.p = line[i - 1] + (s - reach[i - 1]) * direction;
      if (face && direction.head<2>().norm() > 1e-6) {
        // The nose follows at most 45 degrees a second.
        const double error = wrapped(std::atan2(direction.y(), direction.x()) - now_.yaw);
        now_.yaw += std::clamp(error, -45 * kRad * kPlanStep, 45 * kRad * kPlanStep);
      }
      rough_.push_back(now_);
    }
    now_.p = line.back();
  }

  static double wrapped(double a) { return std::remainder(a, 2 * std::numbers::pi); }

  void turn_to(const Vec3& direction, double rate) {
    if (direction.head<2>().norm() < 1e-6) return;
    const double error = wrapped(std::atan2(direction.y(), direction.x()) - now_.yaw);
    if (std::abs(error) > 1e-9) spin(error, rate);
  }

  void spin(double angle, double rate) {
    const double start = now_.yaw, sign = angle < 0 ? -1 : 1;
    double total = 0;
    for (double t = 0;; t += kPlanStep) {
      const double s = trapezoid(t, std::abs(angle), rate, 2.0, &total);
      if (t >= total) break;
      now_.yaw = start + sign * s;
      rough_.push_back(now_);
    }
    now_.yaw = start + angle;
  }

  void tilt(const Vec2& to, double rate) {
    const Vec2 from = now_.tilt;
    const double angle = (to - from).norm();
    if (angle <= 0) return;
    double total = 0;
    for (double t = 0;; t += kPlanStep) {
      const double s = trapezoid(t, angle, rate, 2.0, &total);
      if (t >= total) break;
      now_.tilt = from + s / angle * (to - from);
      rough_.push_back(now_);
    }
    now_.tilt = to;
  }

  const TrajectoryPlan& plan_;
  double ground_;
  Rough now_{};
  std::vector<Rough> rough_;
};

/// The rough plan, averaged over a window, at step i (clamped).
Rough smoothed(const std::vector<Rough>& rough, double i) {
  const int n = static_cast<int>(rough.size()), centre = static_cast<int>(std::lround(i));
  Rough sum{Vec3::Zero(), 0, Vec2::Zero()};
  for (int k = centre - kBlurSteps; k <= centre + kBlurSteps; ++k) {
    const Rough& r = rough[std::clamp(k, 0, n - 1)];
    sum.p += r.p;
    sum.yaw += r.yaw;
    sum.tilt += r.tilt;
  }
  const double w = 1.0 / (2 * kBlurSteps + 1);
  return {sum.p * w, sum.yaw * w, sum.tilt * w};
}

QuinticSpline make_spline(const TrajectoryPlan& plan, double ground_m, std::uint64_t seed) {
  Planner planner(plan, ground_m);
  for (const Leg& leg : plan.legs) planner.add(leg);
  const std::vector<Rough>& rough = planner.rough();
  const double duration = static_cast<double>(rough.size()) * kPlanStep;
  const int count = std::max(1, static_cast<int>(std::ceil(duration / kKnot))) + 5;
  std::vector<Vec6> control(count);
  Rng rng(seed, 0x5741);
  // Sway: a first-order wandering of position and tilt, zero near the ground.
  Vec6 sway = Vec6::Zero();
  Vec6 amplitude;
  amplitude << 0.10, 0.10, 0.06, 0.6 * kRad, 0.5 * kRad, 0.5 * kRad;
  for (int i = 0; i < count; ++i) {
    const double step = (i - 2) * kKnot / kPlanStep, ahead = kKnot / kPlanStep;
    const Rough a = smoothed(rough, step - ahead), b = smoothed(rough, step), c = smoothed(rough, step + ahead);
    const Vec3 acceleration = (a.p - 2 * b.p + c.p) / (kKnot * kKnot), velocity = (c.p - a.p) / (2 * kKnot);
    const Vec3 forward(std::cos(b.yaw), std::sin(b.yaw), 0), right(forward.y(), -forward.x(), 0);
    // A multirotor leans into its acceleration, and against the air's drag.
    const double lean_forward = acceleration.dot(forward) + 0.12 * velocity.dot(forward);
    const double lean_right = acceleration.dot(right) + 0.12 * velocity.dot(right);
    const double decay = std::exp(-kKnot / 0.8), kick = std::sqrt(1 - decay * decay);
    for (int k = 0; k < 6; ++k) sway[k] = decay * sway[k] + kick * amplitude[k] * rng.gaussian();
    const double airborne = std::clamp((b.p.z() - ground_m - plan.start_height_m) / 1.5, 0.0, 1.0);
    const double gain = plan.sway * (plan.start_height_m > 1.0 ? 1.0 : airborne);
    Vec6& out = control[i];
    out << b.p, b.yaw, b.tilt.x() - std::atan2(lean_forward, kGravity), b.tilt.y() + std::atan2(lean_right, kGravity);
    out += gain * sway;
  }
  return QuinticSpline(std::move(control), kKnot);
}

}  // namespace

Trajectory::Trajectory(const TrajectoryPlan& plan, double ground_m, std::uint64_t seed)
    : spline_(make_spline(plan, ground_m, seed)), vibration_(plan.vibration), seed_(seed) {}

BodyState Trajectory::at(double t_s) const {
  SplineSample s = spline_.sample(t_s);
  if (vibration_.frequency_hz > 0) {
    Rng rng(seed_, 0x7163);
    for (int axis = 0; axis < 6; ++axis) {
      const double amplitude = axis < 3 ? vibration_.position_mm * 1e-3 : vibration_.angle_deg * kRad;
      for (int k = 0; k < 3; ++k) {
        const double w = 2 * std::numbers::pi * vibration_.frequency_hz * rng.uniform(0.8, 1.25);
        const double phase = rng.uniform(0, 2 * std::numbers::pi), part = amplitude / 3.0;
        s.value[axis] += part * std::sin(w * t_s + phase);
        s.first[axis] += part * w * std::cos(w * t_s + phase);
        s.second[axis] -= part * w * w * std::sin(w * t_s + phase);
      }
    }
  }
  BodyState out;
  out.position_m = s.value.head<3>();
  out.velocity_m_s = s.first.head<3>();
  out.acceleration_m_s2 = s.second.head<3>();
  // Aerospace Euler angles (yaw, pitch, roll) in a level frame with z down, which is the world turned about x by pi.
  // Heading counts the other way round there.
  const double yaw = -s.value[3], pitch = s.value[4], roll = s.value[5];
  const double yaw_rate = -s.first[3], pitch_rate = s.first[4], roll_rate = s.first[5];
  const Mat3 R_level_body = (Eigen::AngleAxisd(yaw, Vec3::UnitZ()) * Eigen::AngleAxisd(pitch, Vec3::UnitY()) *
                             Eigen::AngleAxisd(roll, Vec3::UnitX()))
                                .toRotationMatrix();
  out.R_world_body = Vec3(1, -1, -1).asDiagonal() * R_level_body;
  out.omega_rad_s = Vec3(roll_rate - yaw_rate * std::sin(pitch),
                         pitch_rate * std::cos(roll) + yaw_rate * std::sin(roll) * std::cos(pitch),
                         -pitch_rate * std::sin(roll) + yaw_rate * std::cos(roll) * std::cos(pitch));
  out.specific_force_m_s2 = out.R_world_body.transpose() * (out.acceleration_m_s2 + Vec3(0, 0, kGravity));
  return out;
}

}  // namespace godwit::sim
