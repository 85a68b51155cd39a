#include "vo_core/inertial/scale_state.h"

#include <algorithm>
#include <cmath>

namespace godwit::vo {
namespace {

/// Of the logarithm, before anything is known: a factor of a thousand either way.
constexpr double kAnyScale = 7;

}  // namespace

ScaleState::ScaleState(const ScaleOptions& options) : options_(options) {
  P_[0][0] = kAnyScale * kAnyScale;
  for (std::size_t i = 0; i < kScaleSources; ++i) P_[1 + i][1 + i] = options_.bias_sigma[i] * options_.bias_sigma[i];
}

void ScaleState::new_map() {
  x_[0] = 0;
  for (std::size_t i = 0; i < kStates; ++i) P_[0][i] = P_[i][0] = 0;
  P_[0][0] = kAnyScale * kAnyScale;
  for (Source& s : sources_) s.equal = s.contradictions = 0, s.information = 0;
  dispute2_ = 0;
}

void ScaleState::advance(rt::TimeNs t_ns) {
  if (!begun_) {
    begun_ = true;
    t_ns_ = t_ns;
  }
  if (t_ns <= t_ns_) return;
  const double dt = rt::to_seconds(t_ns - t_ns_);
  dispute2_ *= std::exp(-dt / rt::to_seconds(options_.silent_ns));
  t_ns_ = t_ns;
  P_[0][0] = std::min(P_[0][0] + options_.scale_walk * options_.scale_walk * dt, kAnyScale * kAnyScale);
  for (std::size_t i = 1; i < kStates; ++i) {
    // What a source is off by wanders, but no further than such sources are off.
    const double most = options_.bias_sigma[i - 1] * options_.bias_sigma[i - 1];
    P_[i][i] = std::max(P_[i][i], std::min(P_[i][i] + options_.bias_walk * options_.bias_walk * dt, most));
  }
}

int ScaleState::others_heard(std::size_t source) const {
  int heard_ones = 0;
  for (std::size_t i = 0; i < kScaleSources; ++i) heard_ones += i != source && heard(sources_[i]) ? 1 : 0;
  return heard_ones;
}

bool ScaleState::heard(const Source& source) const {
  return source.t_used_ns != 0 && t_ns_ - source.t_used_ns < 5 * rt::kNsPerSecond;
}

ScaleVerdict ScaleState::judge(const ScaleReading& r, Source* source) {
  const bool numbers = std::isfinite(r.metres) && std::isfinite(r.units) && std::isfinite(r.metres_sigma) &&
                       std::isfinite(r.units_sigma) && r.metres_sigma >= 0 && r.units_sigma >= 0;
  if (!numbers || (begun_ && r.t_ns < t_ns_)) return ScaleVerdict::kNoNumber;
  advance(r.t_ns);
  if (r.metres == source->last_metres && r.source != ScaleSource::kStartHeight) {
    ++source->equal;
  } else {
    source->equal = 0;
    source->last_metres = r.metres;
    source->units_then = r.units;
  }
  if (source->equal >= options_.frozen && std::abs(r.units - source->units_then) > 3 * r.units_sigma) {
    return ScaleVerdict::kFrozen;
  }
  // Lengths of opposite signs, or lost in their own noise, tell nothing of their ratio.
  if (!(r.metres * r.units > 0)) return ScaleVerdict::kTooShort;
  const double share_m = r.metres_sigma / r.metres, share_u = r.units_sigma / r.units;
  const double noise = share_m * share_m + share_u * share_u;
  if (!(noise < options_.most_sigma * options_.most_sigma)) return ScaleVerdict::kTooShort;

  const bool silent = r.t_ns < source->silent_until_ns;
  const std::size_t b = 1 + scale_source_index(r.source);
  const double residual = std::log(r.metres / r.units) - x_[0] - x_[b];
  // Nothing is known to its last digit.
  const double variance = P_[0][0] + 2 * P_[0][b] + P_[b][b] + noise + 1e-6;
  if (!(residual * residual <= options_.limit2 * variance)) {
    if (others_heard(scale_source_index(r.source)) == 1) dispute2_ = std::max(dispute2_, residual * residual);
    if (silent) return ScaleVerdict::kDistrusted;
    ++source->contradictions;
    return ScaleVerdict::kContradicts;
  }
  if (silent) return ScaleVerdict::kDistrusted;
  source->contradictions = 0;
  std::array<double, kStates> PH{};
  for (std::size_t i = 0; i < kStates; ++i) PH[i] = P_[i][0] + P_[i][b];
  source->information += std::log(P_[0][0] / std::max(1e-12, P_[0][0] - PH[0] * PH[0] / variance));
  for (std::size_t i = 0; i < kStates; ++i) x_[i] += PH[i] / variance * residual;
  for (std::size_t i = 0; i < kStates; ++i) {
    for (std::size_t j = 0; j < kStates; ++j) P_[i][j] -= PH[i] * PH[j] / variance;
  }
  source->t_used_ns = r.t_ns;
  return ScaleVerdict::kUsed;
}

ScaleVerdict ScaleState::take(const ScaleReading& r) {
  const std::size_t i = scale_source_index(r.source);
  Source& source = sources_[i];
  const ScaleVerdict verdict = judge(r, &source);
  ++source.counts[static_cast<std::size_t>(verdict)];
  if (verdict != ScaleVerdict::kContradicts || source.contradictions < options_.distrusted) return verdict;
  source.contradictions = 0;
  if (others_heard(i) > 0) {
    source.silent_until_ns = r.t_ns + options_.silent_ns;
  } else {
    // Alone against what is held for true: which of the two is wrong nobody can tell, so nothing is known any more.
    new_map();
    ++given_up_;
    reason_ = "the only source of scale contradicts what it told before";
  }
  return verdict;
}

bool ScaleState::known() const {
  return log_sigma() < options_.known_sigma;
}

double ScaleState::scale() const {
  return std::exp(x_[0]);
}

double ScaleState::log_sigma() const {
  return std::sqrt(std::max(0.0, P_[0][0] + dispute2_));
}

double ScaleState::share(ScaleSource source) const {
  double all = 0;
  for (const Source& s : sources_) all += s.information;
  return all > 0 ? sources_[scale_source_index(source)].information / all : 0;
}

std::uint64_t ScaleState::count(ScaleSource source, ScaleVerdict verdict) const {
  return sources_[scale_source_index(source)].counts[static_cast<std::size_t>(verdict)];
}

}  // namespace godwit::vo
