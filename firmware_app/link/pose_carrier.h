// Poses between two pictures: the last one carried on by the inertial sensor.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>

#include "firmware_app/link/pose_sample.h"
#include "hal/imu/imu.h"
#include "hal/rt/spsc_ring.h"
#include "vo_core/inertial/carried_motion.h"

namespace godwit::link {

/// The inertial sensor's thread -> link thread. The link takes them at least every 5 ms; this is half a second of the
/// fastest sensor.
class ReadingRing {
 public:
  /// The sensor's thread. No allocation, no lock, no wait: what finds it full is missed and counted.
  void push(const hal::ImuSample& sample) {
    if (!ring_.try_push(sample)) missed_.fetch_add(1, std::memory_order_relaxed);
  }
  /// Link thread.
  bool pop(hal::ImuSample* sample) { return ring_.try_pop(sample); }
  std::uint64_t missed() const { return missed_.load(std::memory_order_relaxed); }
  static constexpr std::size_t capacity() { return Ring::capacity(); }

 private:
  using Ring = rt::SpscRing<hal::ImuSample, 512>;
  Ring ring_;
  std::atomic<std::uint64_t> missed_{0};  ///< relaxed: a figure, nothing is ordered by it
};

struct CarryOptions {
  /// So long after its picture a pose may go on: that picture's way to us, and two more that do not come. A camera that
  /// is silent for longer must be heard to be.
  rt::TimeNs horizon_ns = 100 * rt::kNsPerMs;
  vo::DeadReckoningOptions inertial;
};

/// Link thread. Large; no allocation after the constructor.
class PoseCarrier {
 public:
  explicit PoseCarrier(ReadingRing* readings, const CarryOptions& options = {})
      : readings_(readings), options_(options) {}

  /// Takes what waits in the ring.
  void hear();
  std::uint64_t missed() const { return readings_->missed(); }
  /// The time, on the pictures' clock, to which the readings heard so far can carry a measured pose; 0: they cannot
  /// carry it beyond its own.
  rt::TimeNs reaches(const PoseSample& from) const;
  /// The sample there: pose, velocity, turn rate, and the covariance that has grown. False: it cannot be carried.
  bool carry(const PoseSample& from, rt::TimeNs t_ns, PoseSample* out) const;

 private:
  ReadingRing* const readings_;
  const CarryOptions options_;
  vo::ImuBuffer buffer_;
};

}  // namespace godwit::link
