// Median, percentiles and the like of a row of figures.
#pragma once

#include <string>
#include <vector>

namespace godwit::app {

/// All zero for no values.
struct Statistics {
  double median = 0, p95 = 0, p99 = 0, max = 0, mean = 0;
};
/// Percentiles interpolate linearly between the two nearest values, as numpy.percentile does.
Statistics statistics_of(std::vector<double> values);

/// Percentile p (0 to 100) of values sorted upwards, not empty.
double percentile_of_sorted(const std::vector<double>& sorted, double p);

/// Highest resident memory of this process so far [MB = 10^6 bytes], from the kernel's VmHWM; 0 where it cannot be
/// read.
double peak_memory_mb();

}  // namespace godwit::app
