#include "vo_core/inertial/even_pace.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace godwit::vo {
namespace {
constexpr double kMemoryNs = 1e9;
constexpr double kRoundedNs = 1e3;  ///< times told that are off by less have been rounded
constexpr std::size_t kFew = 8;     ///< readings whose mean shows a step too many or too few
constexpr int kMostStrays = 4;
/// Of a step: times off the pace by more show none. Times that say nothing within a step are off by 0.29 of it.
constexpr double kMostScatter = 0.4;
constexpr double kPatience = 4;  ///< times kStart: after so many readings that show none another is looked for

/// The likeliest number of steps, 1 or more, of a reading that came `steps` of them after the one before; sigma: of
/// that. ln 99: a reading in a hundred is lost.
double number_of(double steps, double sigma) {
  const double nearest = std::max(1.0, std::round(steps));
  const double more = (steps - 1) * (steps - 1) - (steps - nearest) * (steps - nearest);
  return more > 2 * 4.6 * sigma * sigma ? nearest : 1;
}

constexpr std::size_t kStart = EvenPace::kStart;

double median(double* values, std::size_t count) {
  std::nth_element(values, values + count / 2, values + count);
  return values[count / 2];
}

/// Median of what `over` steps take, of one.
double median_step(const std::array<double, kStart>& told, std::size_t over) {
  std::array<double, kStart> each{};
  for (std::size_t i = 0; i + over < kStart; ++i) each[i] = (told[i + over] - told[i]) / static_cast<double>(over);
  return median(each.data(), kStart - over);
}

struct Line {
  double step = 0, last = 0, square = 0;  ///< ns; time of the last reading by it; mean square off it
};

/// Each reading's number by what the readings before say where the next one is, then the line through all.
Line line_through(const std::array<double, kStart>& told, double step) {
  std::array<double, kStart> off{};
  for (std::size_t i = 0; i + 1 < kStart; ++i) off[i] = std::abs(told[i + 1] - told[i] - step);
  // A step has the errors of two times; half of a normal error's values lie within 0.674 of its sigma.
  const double sigma = median(off.data(), kStart - 1) / (0.674 * std::sqrt(2.0) * step);
  std::array<double, kStart> number{};
  double base = 0;  // of the last few readings, the mean of time less number times step
  for (std::size_t i = 1; i < kStart; ++i) {
    const auto seen = static_cast<double>(std::min(kFew, i));
    base += (told[i - 1] - number[i - 1] * step - base) / seen;
    number[i] = number[i - 1] + number_of((told[i] - base) / step - number[i - 1], sigma * std::sqrt(1 + 1 / seen));
  }
  double n = 0, t = 0, nn = 0, nt = 0;
  for (std::size_t i = 0; i < kStart; ++i) {
    n += number[i] / kStart;
    t += told[i] / kStart;
    nn += number[i] * number[i] / kStart;
    nt += number[i] * told[i] / kStart;
  }
  Line line;
  line.step = (nt - n * t) / (nn - n * n);
  line.last = t + line.step * (number.back() - n);
  for (std::size_t i = 0; i < kStart; ++i) {
    const double d = told[i] - t - line.step * (number[i] - n);
    line.square += d * d / kStart;
  }
  return line;
}
}  // namespace

void EvenPace::begin(rt::TimeNs t_ns) {
  gathered_ = 0;
  step_ns_ = count_ = square_ns2_ = lag_ns_ = 0;
  strays_ = 0;
  first_[gathered_++] = t_ns;
}

double EvenPace::scatter_s() const {
  return step_ns_ > 0 ? 1e-9 * std::sqrt(square_ns2_) : 0;
}

void EvenPace::find_pace() {
  std::array<double, kStart> told;
  for (std::size_t i = 0; i < kStart; ++i) told[i] = static_cast<double>(first_[i] - first_[0]);
  origin_ns_ = first_[0];
  count_ = kStart;
  // Single steps say how long one is where many are lost, those of eight where times scatter much: the better line.
  double best = std::numeric_limits<double>::infinity();
  for (const std::size_t over : {std::size_t{1}, kFew}) {
    const Line line = line_through(told, median_step(told, over));
    const double off = line.square / (line.step * line.step);
    if (off >= best) continue;
    best = off;
    step_ns_ = line.step;
    phase_ns_ = line.last;
    square_ns2_ = line.square;
  }
}

bool EvenPace::shows_pace() const {
  return square_ns2_ < kMostScatter * kMostScatter * step_ns_ * step_ns_;
}

bool EvenPace::follow(double told_ns) {
  const double steps = number_of((told_ns - phase_ns_) / step_ns_, std::sqrt(square_ns2_) / step_ns_);
  phase_ns_ += steps * step_ns_;
  lag_ns_ += (told_ns - phase_ns_ - lag_ns_) / static_cast<double>(kFew);
  if (std::abs(lag_ns_) > 0.55 * step_ns_) {
    const double slip = std::copysign(step_ns_, lag_ns_);
    phase_ns_ += slip;
    lag_ns_ -= slip;
  }
  const double off = told_ns - phase_ns_;
  if (std::abs(off) > 2 * step_ns_) return ++strays_ <= kMostStrays;
  strays_ = 0;
  count_ = std::min(count_ + steps, std::max<double>(kStart, kMemoryNs / step_ns_));
  phase_ns_ += off * 2 * (2 * count_ - 1) / (count_ * (count_ + 1));
  step_ns_ += off / steps * 6 / (count_ * (count_ + 1));
  square_ns2_ += (off * off - square_ns2_) / count_;
  return shows_pace() || count_ < kPatience * kStart;
}

rt::TimeNs EvenPace::lay(rt::TimeNs t_ns) {
  const auto memory = static_cast<rt::TimeNs>(kMemoryNs);
  const bool any = gathered_ > 0;
  if (any && t_ns <= t_told_ns_ && t_told_ns_ - t_ns < memory) return t_laid_ns_;
  const bool begins = !any || t_ns <= t_told_ns_ || t_ns - t_told_ns_ > memory;
  const rt::TimeNs last_ns = t_laid_ns_;
  t_told_ns_ = t_laid_ns_ = t_ns;
  if (begins) {
    begin(t_ns);
  } else if (step_ns_ == 0) {
    first_[gathered_++] = t_ns;
    if (gathered_ == kStart) find_pace();
  } else if (!follow(static_cast<double>(t_ns - origin_ns_))) {
    begin(t_ns);
  } else if (strays_ == 0 && shows_pace() && square_ns2_ > kRoundedNs * kRoundedNs) {
    t_laid_ns_ = origin_ns_ + std::llround(phase_ns_);
  }
  if (!begins && t_laid_ns_ <= last_ns) t_laid_ns_ = last_ns + 1;
  return t_laid_ns_;
}

}  // namespace godwit::vo
