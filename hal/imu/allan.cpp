#include "hal/imu/allan.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace godwit::hal {
namespace {

constexpr double kLeastSeconds = 100;
/// Share of the samples that may be missing before even steps are a fiction.
constexpr double kMostMissing = 0.01;
/// A sensor that lies still turns by no more than its bias: beyond this (3 degrees a second, a mean over a second) it
/// was moved; and its specific force does not change by more than this.
constexpr double kMostTurn = 0.05, kMostForce = 0.5;
constexpr double kFlicker = 0.4412712003053032;  // 2 ln 2 / pi

/// Least squares with these terms only, by the normal equations of at most three unknowns (Cramer's way, by
/// elimination).
std::array<double, 3> solve(const std::vector<AllanPoint>& points, const std::array<bool, 3>& use) {
  double A[3][4] = {};
  for (const AllanPoint& p : points) {
    const double variance = p.deviation * p.deviation;
    if (!(variance > 0)) continue;
    // Relative error of a variance from n independent values: sqrt(2 / n).
    const double weight = p.independent / (2 * variance * variance);
    const double f[3] = {1 / p.tau_s, kFlicker, p.tau_s / 3};
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) A[i][j] += weight * f[i] * f[j];
      A[i][3] += weight * f[i] * variance;
    }
  }
  for (std::size_t i = 0; i < 3; ++i) {
    if (use[i]) continue;
    for (double& v : A[i]) v = 0;
    for (auto& row : A) row[i] = 0;
    A[i][i] = 1;
  }
  for (int i = 0; i < 3; ++i) {
    for (int r = 0; r < 3; ++r) {
      if (r == i || A[i][i] == 0) continue;
      const double share = A[r][i] / A[i][i];
      for (int c = 0; c < 4; ++c) A[r][c] -= share * A[i][c];
    }
  }
  std::array<double, 3> x{};
  for (std::size_t i = 0; i < 3; ++i) x[i] = A[i][i] != 0 ? A[i][3] / A[i][i] : 0;
  return x;
}

}  // namespace

std::vector<AllanPoint> allan_deviation(const std::vector<double>& values, double step_s) {
  const std::size_t n = values.size();
  std::vector<double> sum(n + 1, 0.0);
  double mean = 0;
  for (const double v : values) mean += v / static_cast<double>(n);
  for (std::size_t i = 0; i < n; ++i) sum[i + 1] = sum[i] + (values[i] - mean);
  std::vector<AllanPoint> out;
  std::size_t last = 0;
  for (double span = 1; span <= static_cast<double>(n) / 9; span *= std::pow(10.0, 1.0 / 8)) {
    const auto m = static_cast<std::size_t>(std::llround(span));
    if (m == last) continue;
    last = m;
    double squares = 0;
    const std::size_t count = n - 2 * m + 1;
    for (std::size_t i = 0; i < count; ++i) {
      const double d = sum[i + 2 * m] - 2 * sum[i + m] + sum[i];
      squares += d * d;
    }
    const auto spans = static_cast<double>(m);
    out.push_back(
        {spans * step_s, std::sqrt(squares / static_cast<double>(count) / 2) / spans, static_cast<double>(n) / spans});
  }
  return out;
}

NoiseFigures fit_noise(const std::vector<AllanPoint>& points) {
  // Non-negative least squares of three terms: every set of them, the best that has no negative one.
  std::array<double, 3> best{};
  double least = -1;
  for (unsigned set = 1; set < 8; ++set) {
    const std::array<bool, 3> use{(set & 1U) != 0, (set & 2U) != 0, (set & 4U) != 0};
    const std::array<double, 3> x = solve(points, use);
    if (*std::min_element(x.begin(), x.end()) < 0) continue;
    double error = 0;
    for (const AllanPoint& p : points) {
      const double variance = p.deviation * p.deviation;
      if (!(variance > 0)) continue;
      const double model = x[0] / p.tau_s + kFlicker * x[1] + x[2] * p.tau_s / 3;
      error += p.independent / 2 * (model / variance - 1) * (model / variance - 1);
    }
    if (least < 0 || error < least) {
      least = error;
      best = x;
    }
  }
  return {std::sqrt(best[0]), std::sqrt(best[1]), std::sqrt(best[2])};
}

rt::Result<ImuNoise> analyse_still(const std::vector<ImuSample>& samples) {
  ImuNoise out;
  if (samples.size() > 1) out.seconds = rt::to_seconds(samples.back().t_ns - samples.front().t_ns);
  if (out.seconds < kLeastSeconds) {
    return rt::Error{"the recording lasts " + std::to_string(static_cast<int>(out.seconds)) +
                     " s; 100 at least are needed, and an hour or more for bias instability and random walk"};
  }
  std::vector<rt::TimeNs> steps;
  for (std::size_t i = 1; i < samples.size(); ++i) steps.push_back(samples[i].t_ns - samples[i - 1].t_ns);
  const auto middle = steps.begin() + static_cast<std::ptrdiff_t>(steps.size() / 2);
  std::nth_element(steps.begin(), middle, steps.end());
  // The median says how many steps there should be, the whole recording how long one is.
  const double whole = std::round(out.seconds * 1e9 / static_cast<double>(*middle));
  const double missing = 1 - static_cast<double>(steps.size()) / whole;
  if (missing > kMostMissing) {
    return rt::Error{"of the samples " + std::to_string(static_cast<int>(100 * missing)) +
                     " % are missing; the steps are not even"};
  }
  const double step_s = out.seconds / static_cast<double>(steps.size());
  out.rate_hz = 1 / step_s;
  const auto second = static_cast<std::size_t>(std::max(1.0, std::round(out.rate_hz)));
  for (std::size_t a = 0; a < 6; ++a) {
    std::vector<double> values;
    values.reserve(samples.size());
    for (const ImuSample& s : samples) values.push_back(a < 3 ? s.gyro_rad_s[a] : s.accel_m_s2[a - 3]);
    double low = 0, high = 0;
    for (std::size_t i = 0; i + second <= values.size(); i += second) {
      double mean = 0;
      for (std::size_t k = 0; k < second; ++k) mean += values[i + k] / static_cast<double>(second);
      low = i == 0 ? mean : std::min(low, mean);
      high = i == 0 ? mean : std::max(high, mean);
    }
    if (high - low > (a < 3 ? kMostTurn : kMostForce)) {
      return rt::Error{std::string("the sensor was not still: ") + (a < 3 ? "its rate" : "its acceleration") +
                       " moved by " + std::to_string(high - low) + (a < 3 ? " rad/s" : " m/s^2")};
    }
    out.points[a] = allan_deviation(values, step_s);
    out.axis[a] = fit_noise(out.points[a]);
    NoiseFigures& worst = a < 3 ? out.gyro : out.accel;
    worst.density = std::max(worst.density, out.axis[a].density);
    worst.bias_instability = std::max(worst.bias_instability, out.axis[a].bias_instability);
    worst.random_walk = std::max(worst.random_walk, out.axis[a].random_walk);
  }
  return out;
}

std::string imu_yaml(const ImuNoise& noise) {
  char text[900];
  std::snprintf(text, sizeof text,
                "# Allan deviation of %.0f s of a still sensor; the worst of three axes each\n"
                "accelerometer_noise_density: %.4g  # m/s^2/sqrt(Hz)\n"
                "accelerometer_random_walk: %.4g  # m/s^3/sqrt(Hz)\n"
                "# bias instability of the accelerometer: %.4g m/s^2\n"
                "gyroscope_noise_density: %.4g  # rad/s/sqrt(Hz)\n"
                "gyroscope_random_walk: %.4g  # rad/s^2/sqrt(Hz)\n"
                "# bias instability of the gyroscope: %.4g rad/s\n"
                "rostopic: /imu0\nupdate_rate: %.4f\n",
                noise.seconds, noise.accel.density, noise.accel.random_walk, noise.accel.bias_instability,
                noise.gyro.density, noise.gyro.random_walk, noise.gyro.bias_instability, noise.rate_hz);
  return text;
}

}  // namespace godwit::hal
