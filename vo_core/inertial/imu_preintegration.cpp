#include "vo_core/inertial/imu_preintegration.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {
namespace {

/// What a saturated axis is off by, one sigma, as a share of what it reads: nobody knows how far beyond its end the
/// truth was. A truth of 1.5 times the range is one sigma off then, and one of 2.5 times three. Not measured.
constexpr double kSaturatedShare = 0.5;

/// Nobody says which axis it is: it is the one that reads most, and those that read as much. Their sigmas; zero: of the
/// others.
Vec3 saturated_sigma(const Vec3& reading) {
  const double end = 0.99 * reading.cwiseAbs().maxCoeff();
  return (reading.array().abs() >= end).select(kSaturatedShare * reading.array().abs(), 0.0);
}

}  // namespace

Mat3 so3_right_jacobian(const Vec3& w) {
  const double theta2 = w.squaredNorm();
  const Mat3 W = skew(w);
  if (theta2 < 1e-10) return Mat3::Identity() - 0.5 * W + W * W / 6.0;
  const double theta = std::sqrt(theta2);
  return Mat3::Identity() - (1.0 - std::cos(theta)) / theta2 * W + (theta - std::sin(theta)) / (theta2 * theta) * W * W;
}

Mat3 so3_right_jacobian_inverse(const Vec3& w) {
  const double theta2 = w.squaredNorm();
  const Mat3 W = skew(w);
  if (theta2 < 1e-10) return Mat3::Identity() + 0.5 * W + W * W / 12.0;
  const double theta = std::sqrt(theta2);
  return Mat3::Identity() + 0.5 * W +
         (1.0 / theta2 - (1.0 + std::cos(theta)) / (2.0 * theta * std::sin(theta))) * W * W;
}

void Preintegration::add(const Vec3& gyro, const Vec3& accel, double dt_s, const ImuNoise& noise, const Vec6& more) {
  const Vec3 turn = (gyro - bias_.gyro) * dt_s, force = accel - bias_.accel;
  const Mat3 half = so3_exp(0.5 * turn), whole = so3_exp(turn);
  const Mat3 R_mid = dR_ * half;
  const Mat3 R_force = R_mid * skew(force);
  const double dt = dt_s, dt2 = 0.5 * dt * dt;
  // The middle attitude's own derivative by the gyroscope's bias, as a vector right of R_mid.
  const Mat3 mid_dbg = half.transpose() * dR_dbg_ - so3_right_jacobian(0.5 * turn) * (0.5 * dt);

  // Covariance (Forster, 63): A C A^T with A = [W 0 0; V 1 0; P dt 1], by its blocks.
  const Mat3 W = whole.transpose(), V = -R_force * half.transpose() * dt, P = 0.5 * dt * V;
  Eigen::Matrix<double, 9, 9> C;
  C.topRows<3>() = W * covariance_.topRows<3>();
  C.middleRows<3>(3) = V * covariance_.topRows<3>() + covariance_.middleRows<3>(3);
  C.bottomRows<3>() = P * covariance_.topRows<3>() + dt * covariance_.middleRows<3>(3) + covariance_.bottomRows<3>();
  covariance_.leftCols<3>() = C.leftCols<3>() * W.transpose();
  covariance_.middleCols<3>(3) = C.leftCols<3>() * V.transpose() + C.middleCols<3>(3);
  covariance_.rightCols<3>() = C.leftCols<3>() * P.transpose() + dt * C.middleCols<3>(3) + C.rightCols<3>();
  // The step's white noise of density n is n / sqrt(dt); what a turn's makes of the way is left out.
  const Vec3 gyro2 = Vec3::Constant(noise.gyro * noise.gyro / dt) + more.head<3>();
  const Vec3 accel2 = Vec3::Constant(noise.accel * noise.accel / dt) + more.tail<3>();
  const Mat3 turned = so3_right_jacobian(turn) * dt, sped = -R_force * (0.5 * dt) * dt;
  const Mat3 turned2 = turned * gyro2.asDiagonal(), pushed2 = R_mid * accel2.asDiagonal() * R_mid.transpose();
  const Mat3 both = turned2 * sped.transpose();
  covariance_.block<3, 3>(0, 0) += turned2 * turned.transpose();
  covariance_.block<3, 3>(0, 3) += both;
  covariance_.block<3, 3>(3, 0) += both.transpose();
  covariance_.block<3, 3>(3, 3) += sped * gyro2.asDiagonal() * sped.transpose() + dt * dt * pushed2;
  covariance_.block<3, 3>(3, 6) += dt * dt2 * pushed2;
  covariance_.block<3, 3>(6, 3) += dt * dt2 * pushed2;
  covariance_.block<3, 3>(6, 6) += dt2 * dt2 * pushed2;

  dp_dba_ += dv_dba_ * dt - R_mid * dt2;
  dp_dbg_ += dv_dbg_ * dt - R_force * mid_dbg * dt2;
  dv_dba_ -= R_mid * dt;
  dv_dbg_ -= R_force * mid_dbg * dt;
  dR_dbg_ = W * dR_dbg_ - turned;

  dp_ += dv_ * dt + R_mid * force * dt2;
  dv_ += R_mid * force * dt;
  dR_ = dR_ * whole;
  dt_s_ += dt;
}

bool ImuBuffer::add(const ImuReading& r) {
  if (!r.gyro_rad_s.allFinite() || !r.accel_m_s2.allFinite()) {
    ++refused_;
    return false;
  }
  if (count_ > 0 && r.t_ns <= newest_ns()) {
    if (newest_ns() - r.t_ns <= kSpanNs) {
      ++refused_;
      return false;
    }
    clear();
  }
  if (count_ == kReadings) {
    first_ = (first_ + 1) % kReadings;
    --count_;
  }
  Kept& kept = readings_[(first_ + count_) % kReadings];
  kept = {r, r.t_ns, r.t_ns};
  if (count_ > 0) {
    const Kept& last = at(count_ - 1);
    if (last.gyro_saturated) kept.gyro_since_ns = last.gyro_since_ns;
    if (last.accel_saturated) kept.accel_since_ns = last.accel_since_ns;
  }
  ++count_;
  while (count_ > 2 && r.t_ns - at(1).t_ns > kSpanNs) {
    first_ = (first_ + 1) % kReadings;
    --count_;
  }
  return true;
}

std::size_t ImuBuffer::at_or_before(rt::TimeNs t_ns) const {
  std::size_t low = 0, high = count_;
  while (high - low > 1) {
    const std::size_t middle = (low + high) / 2;
    (at(middle).t_ns <= t_ns ? low : high) = middle;
  }
  return low;
}

double ImuBuffer::time_scatter_s() const {
  constexpr std::size_t kSteps = 100, kFewest = 10;
  const std::size_t steps = std::min(kSteps, count_ > 0 ? count_ - 1 : 0);
  if (steps < kFewest) return 0;
  const auto step_s = [&](std::size_t i) { return rt::to_seconds(at(count_ - 1 - i).t_ns - at(count_ - 2 - i).t_ns); };
  const double all = rt::to_seconds(newest_ns() - at(count_ - 1 - steps).t_ns) / static_cast<double>(steps);
  double sum = 0, squares = 0, count = 0;
  for (std::size_t i = 0; i < steps; ++i) {
    const double s = step_s(i);
    if (s > 2 * all) continue;
    sum += s;
    squares += s * s;
    ++count;
  }
  const double mean = sum / count, variance = squares / count - mean * mean;
  // A step has the errors of two times. Below a microsecond they are rounded.
  return variance > 1e-12 ? std::sqrt(0.5 * variance) : 0;
}

Vec3 ImuBuffer::rate_at(rt::TimeNs t_ns) const {
  const std::size_t i = at_or_before(t_ns);
  const ImuReading &a = at(i), &b = at(std::min(i + 1, count_ - 1));
  const double span = rt::to_seconds(b.t_ns - a.t_ns);
  const double x = span > 0 ? std::clamp(rt::to_seconds(t_ns - a.t_ns) / span, 0.0, 1.0) : 0.0;
  return (1 - x) * a.gyro_rad_s + x * b.gyro_rad_s;
}

Vec3 ImuBuffer::turned(rt::TimeNs t0_ns, rt::TimeNs t1_ns) const {
  Vec3 sum = Vec3::Zero(), last = rate_at(t0_ns);
  rt::TimeNs t = t0_ns;
  for (std::size_t i = at_or_before(t0_ns) + 1; i < count_ && at(i).t_ns < t1_ns; ++i) {
    if (at(i).t_ns <= t) continue;
    sum += 0.5 * rt::to_seconds(at(i).t_ns - t) * (last + at(i).gyro_rad_s);
    t = at(i).t_ns;
    last = at(i).gyro_rad_s;
  }
  return sum + 0.5 * rt::to_seconds(t1_ns - t) * (last + rate_at(t1_ns));
}

bool ImuBuffer::row_turns(rt::TimeNs t_before_ns, rt::TimeNs t_ns, rt::TimeNs span_ns, std::span<Vec3> turns,
                          std::span<Vec3> rates) const {
  const rt::TimeNs first = t_ns - span_ns / 2, last = t_ns + span_ns / 2, before = t_before_ns - span_ns / 2;
  const auto gaps = static_cast<rt::TimeNs>(turns.size()) - 1;  // between the first row and the last
  if (gaps < 1 || count_ < 2 || span_ns <= 0 || t_before_ns >= t_ns || before < at(0).t_ns) return false;
  // A reading is missing at the end where the next two would be due by now: times told scatter.
  const rt::TimeNs pace = (newest_ns() - at(0).t_ns) / static_cast<rt::TimeNs>(count_ - 1);
  if (newest_ns() + 2 * pace < last) return false;
  for (std::size_t i = at_or_before(before); i + 1 < count_ && at(i).t_ns < last; ++i)
    if (at(i + 1).t_ns - at(i).t_ns > kGapNs || at(i).gyro_saturated) return false;
  const auto time_of = [&](rt::TimeNs middle, rt::TimeNs k) { return middle - span_ns / 2 + span_ns * k / gaps; };
  // Mean of the rows' turns since the first of them; of the first row and the last only half lies within.
  const auto mean_of_rows = [&](rt::TimeNs middle, auto&& keep) {
    Vec3 turn = Vec3::Zero(), sum = Vec3::Zero();
    for (rt::TimeNs k = 0; k <= gaps; ++k) {
      if (k > 0) turn += turned(time_of(middle, k - 1), time_of(middle, k));
      sum += (k == 0 || k == gaps ? 0.5 : 1.0) * turn;
      keep(static_cast<std::size_t>(k), turn);
    }
    return Vec3(sum / static_cast<double>(gaps));
  };
  const Vec3 then = mean_of_rows(t_before_ns, [](std::size_t, const Vec3&) {});
  const Vec3 now = mean_of_rows(t_ns, [&](std::size_t k, const Vec3& turn) { turns[k] = turn; });
  const Vec3 steady = (turned(before, first) + now - then) / rt::to_seconds(t_ns - t_before_ns);
  for (rt::TimeNs k = 0; k <= gaps; ++k) {
    turns[static_cast<std::size_t>(k)] -= now + rt::to_seconds(time_of(t_ns, k) - t_ns) * steady;
    rates[static_cast<std::size_t>(k)] = rate_at(time_of(t_ns, k)) - steady;
  }
  return true;
}

Vec3 ImuBuffer::mean_turn(rt::TimeNs t_ns, rt::TimeNs span_ns) const {
  if (count_ == 0 || span_ns <= 0) return Vec3::Zero();
  // By trapezoids. What shakes an aircraft at 100 Hz turns once within 10 ms: a dozen of steps for that.
  constexpr int kSteps = 32;
  const double step_s = rt::to_seconds(span_ns) / kSteps;
  const auto rate = [&](int k) { return rate_at(t_ns - span_ns / 2 + span_ns * k / kSteps); };
  Vec3 turned = Vec3::Zero(), sum = Vec3::Zero(), at_t = Vec3::Zero(), last = rate(0);
  for (int k = 1; k <= kSteps; ++k) {
    const Vec3 now = rate(k);
    turned += 0.5 * step_s * (last + now);
    last = now;
    sum += (k < kSteps ? 1.0 : 0.5) * turned;
    if (k == kSteps / 2) at_t = turned;
  }
  return sum / kSteps - at_t;
}

Vec6 ImuBuffer::unmeasured(const Kept& a, const Kept& b, rt::TimeNs from_ns, rt::TimeNs to_ns) {
  Vec6 out = Vec6::Zero();
  // The integral's sigma is s t after a time t: a step from t to t + dt adds s^2 (2 t dt + dt^2), which is the step's
  // dt^2 times this.
  const auto one = [&](const Vec3& reading, rt::TimeNs since_ns) -> Vec3 {
    const double t = rt::to_seconds(std::max<rt::TimeNs>(0, from_ns - since_ns)), dt = rt::to_seconds(to_ns - from_ns);
    return (1 + 2 * t / dt) * saturated_sigma(reading).cwiseAbs2();
  };
  if (b.gyro_saturated) out.head<3>() = one(b.gyro_rad_s, b.gyro_since_ns);
  if (a.gyro_saturated) out.head<3>() = out.head<3>().cwiseMax(one(a.gyro_rad_s, a.gyro_since_ns));
  if (b.accel_saturated) out.tail<3>() = one(b.accel_m_s2, b.accel_since_ns);
  if (a.accel_saturated) out.tail<3>() = out.tail<3>().cwiseMax(one(a.accel_m_s2, a.accel_since_ns));
  return out;
}

ImuBuffer::Coverage ImuBuffer::integrate(rt::TimeNs t0_ns, rt::TimeNs t1_ns, const ImuNoise& noise,
                                         Preintegration* out) const {
  Coverage coverage;
  if (t1_ns <= t0_ns) return coverage;
  if (count_ == 0) {
    coverage.missing_ns = t1_ns - t0_ns;
    return coverage;
  }
  const double scatter_s = time_scatter_s();
  const auto step = [&](const Kept& a, const Kept& b, rt::TimeNs from, rt::TimeNs to) {
    // Of a straight line between two readings the mean is its middle.
    const double span = rt::to_seconds(b.t_ns - a.t_ns);
    const double x = span > 0 ? 0.5 * (rt::to_seconds(from - a.t_ns) + rt::to_seconds(to - a.t_ns)) / span : 0.0;
    // A time that is off by d adds d times half of what the readings beside it differ by to the integral, each one
    // anew.
    const double late = span > 0 ? scatter_s / std::sqrt(3 * span) : 0.0;
    ImuNoise all = noise;
    all.gyro = std::hypot(noise.gyro, late * (b.gyro_rad_s - a.gyro_rad_s).norm());
    all.accel = std::hypot(noise.accel, late * (b.accel_m_s2 - a.accel_m_s2).norm());
    out->add((1 - x) * a.gyro_rad_s + x * b.gyro_rad_s, (1 - x) * a.accel_m_s2 + x * b.accel_m_s2,
             rt::to_seconds(to - from), all, unmeasured(a, b, from, to));
    coverage.gyro_saturated |= a.gyro_saturated || b.gyro_saturated;
    coverage.accel_saturated |= a.accel_saturated || b.accel_saturated;
  };
  rt::TimeNs t = t0_ns;
  const Kept& oldest = at(0);
  if (t < oldest.t_ns) {
    const rt::TimeNs to = std::min(oldest.t_ns, t1_ns);
    step(oldest, oldest, t, to);
    coverage.missing_ns += to - t;
    t = to;
  }
  for (std::size_t i = at_or_before(t); i + 1 < count_ && t < t1_ns; ++i) {
    const Kept &a = at(i), &b = at(i + 1);
    const rt::TimeNs to = std::min(b.t_ns, t1_ns);
    if (to <= t) continue;
    step(a, b, t, to);
    if (b.t_ns - a.t_ns > kGapNs) coverage.missing_ns += to - t;
    ++coverage.readings;
    t = to;
  }
  if (t < t1_ns) {
    step(at(count_ - 1), at(count_ - 1), t, t1_ns);
    coverage.missing_ns += t1_ns - t;
  }
  return coverage;
}

}  // namespace godwit::vo
