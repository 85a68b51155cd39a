// Two configurations or two programs, flown in turn, and the ratio of what they cost.
#pragma once

#include <atomic>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "benchmarks/latency/options.h"
#include "hal/rt/result.h"

namespace godwit::bench {

/// The ratio A / B of one figure over all pairs.
struct Ratio {
  std::string figure;
  double median = 0, least = 0, most = 0;
  /// Median absolute deviation of the pairs' ratios, scaled to a standard deviation, over the root of their number:
  /// how far the median would wander if all was flown again.
  double spread = 0;
  std::size_t pairs = 0;  ///< that had it
};

/// Ratios of pairs (A, B), all above zero.
Ratio ratio_of(const std::string& figure, const std::vector<std::pair<double, double>>& pairs);

/// Figures of a pair, by name: A's and B's, above zero.
using PairFigures = std::map<std::string, std::pair<double, double>>;

/// What the figures (JSON, kind "latency") of two flights or sets of flights have in common. How many detections a
/// flight has, and of which input, is the ladder's matter and the machine's: a detection is compared with one of the
/// same input, and the sum over all threads counts as many on both sides. What one side did not do is left out. Error:
/// not such JSON, other flights, a figure of zero.
rt::Result<PairFigures> pair_figures(const std::string& a, const std::string& b);

struct Comparison {
  std::vector<Ratio> ratios;
  std::int64_t pairs = 0;
};

/// Flies o.pairs pairs; each flight is a process of its own, and who flies first changes from pair to pair, so that a
/// machine that grows slower or warmer favours neither. Compared are thread CPU times, which a busy machine moves less
/// than ages. Error: a flight failed (with what it said), or the two did not fly the same number of flights.
rt::Result<Comparison> compare(const Options& o, const std::atomic<bool>& stop);

std::string table(const Options& o, const Comparison& comparison);
/// Schema docs/figures.schema.json, kind "latency-comparison".
std::string json(const Options& o, const Comparison& comparison);

}  // namespace godwit::bench
