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

/// One figure of a pair of flights, above zero.
struct Pair {
  double a = 0, b = 0;
  bool a_first = true;  ///< A flew before B
};

/// The ratio A / B of one figure over all pairs.
struct Ratio {
  std::string figure;
  /// Hodges and Lehmann's estimate over the two orders: the median of the geometric means of each pair that A began
  /// with each that B began. What being first costs or saves goes out of each of these means, however many pairs began
  /// with whom; of normal noise it wanders a sixth less than the median of the pairs does.
  double median = 0;
  double least = 0, most = 0;  ///< of the pairs
  /// Standard error of `median`: the mean distance of the pairs, those of either order from a middle of their own,
  /// scaled to a normal distribution, over the root of their number. Nine times in ten the truth is within twice it.
  double spread = 0;
  std::size_t pairs = 0;  ///< that had it
};

/// Both orders must be there.
Ratio ratio_of(const std::string& figure, const std::vector<Pair>& pairs);

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

/// Flies o.pairs pairs (an even number: A begins one half, B the other); each flight is a process of its own, and who
/// flies first changes from pair to pair (B A, A B, ..), so that a machine that grows slower or warmer favours neither.
/// Before them a pair is flown that counts nowhere: the first flight finds pictures, programs and models on the disc,
/// the others in memory. Compared are thread CPU times, which a busy machine moves less than ages. Error: a flight
/// failed (with what it said), or the two did not fly the same number of flights.
rt::Result<Comparison> compare(const Options& o, const std::atomic<bool>& stop);

std::string table(const Options& o, const Comparison& comparison);
/// Schema docs/figures.schema.json, kind "latency-comparison".
std::string json(const Options& o, const Comparison& comparison);

}  // namespace godwit::bench
