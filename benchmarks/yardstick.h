// The yardstick: a workload of known size, timed in turn with what is to be measured, frame by frame in one run, so
// that both see the same machine.
#pragma once

#include <fmt/format.h>
#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>
#include <vector>

#include "firmware_app/output/statistics.h"
#include "hal/rt/time.h"

namespace godwit::bench {

constexpr int kYardstickCorners = 180;

/// Thread CPU time [ms] of one cv::calcOpticalFlowPyrLK of 180 corners from the earlier to the later picture
/// (goodFeaturesToTrack(180, 0.01, 15) on the earlier one; window 21 x 21, three pyramid levels above the picture, at
/// most 30 iterations or a step below 0.01 px; pyramids built inside). Below 0 if the earlier one has no corners. The
/// median over the frames is Y. The caller has set cv::setNumThreads(1).
inline double time_yardstick(const cv::Mat& earlier, const cv::Mat& later) {
  std::vector<cv::Point2f> corners, found;
  cv::goodFeaturesToTrack(earlier, corners, kYardstickCorners, 0.01, 15);
  if (corners.empty()) return -1;
  std::vector<unsigned char> status;
  std::vector<float> error;
  const cv::TermCriteria criteria(cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 30, 0.01);
  const rt::TimeNs begin = rt::thread_cpu_now_ns();
  cv::calcOpticalFlowPyrLK(earlier, later, corners, found, status, error, cv::Size(21, 21), 3, criteria);
  return rt::to_ms(rt::thread_cpu_now_ns() - begin);
}

/// A line of heading, then a line for each row of figures: milliseconds, and the same in Y.
inline void print_heading() {
  fmt::print("{:28s} {:>8s} {:>8s} {:>8s} {:>8s} {:>8s}   {:>6s} {:>6s} {:>6s} {:>6s} {:>6s}\n", "[ms | in Y]",
             "median", "p95", "p99", "max", "mean", "median", "p95", "p99", "max", "mean");
}
inline void print_row(const char* name, const std::vector<double>& ms, double y) {
  const app::Statistics s = app::statistics_of(ms);
  fmt::print("{:28s} {:8.3f} {:8.3f} {:8.3f} {:8.3f} {:8.3f}   {:6.3f} {:6.3f} {:6.3f} {:6.3f} {:6.3f}\n", name,
             s.median, s.p95, s.p99, s.max, s.mean, s.median / y, s.p95 / y, s.p99 / y, s.max / y, s.mean / y);
}

}  // namespace godwit::bench
