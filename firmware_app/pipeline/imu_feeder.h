// From the inertial sensor to the tracker: each sample looked at before anybody believes it.
#pragma once

#include <cstddef>
#include <cstdint>

#include "firmware_app/pipeline/onlooker.h"
#include "hal/imu/imu.h"
#include "hal/rt/spsc_ring.h"

namespace godwit::app {

/// Samples that the tracker has not taken: a second of the fastest sensor (1 kHz). It takes them at least ten times a
/// second.
using ImuRing = rt::SpscRing<hal::ImuSample, 1024>;
/// Samples on their way to the sink, which a disc or a log may hold up for seconds.
using ReadingRing = rt::SpscRing<hal::ImuSample, 4096>;

struct ImuCounters {
  std::uint64_t samples = 0;      ///< plausible ones
  std::uint64_t saturated = 0;    ///< of these: an axis at the end of its range
  std::uint64_t gaps = 0;         ///< steps of more than one and a half intervals between two of them
  std::uint64_t faults = 0;       ///< the device did not answer, or with nonsense
  std::uint64_t implausible = 0;  ///< times that repeat, go back, or lie in the future
  std::uint64_t dropped = 0;      ///< no room in the ring: the tracker hung
  std::uint64_t silences = 0;     ///< times that it was called silent
};

/// One thread.
class ImuFeeder {
 public:
  /// live: times are moments of this machine's clock, so a sample of the future is found out. onlooker: may be null.
  ImuFeeder(hal::Imu* imu, bool live, Onlooker* onlooker) : imu_(imu), live_(live), onlooker_(onlooker) {}

  /// The next plausible sample. kFault: one came that is not, or the device failed. Waits at most timeout_ns. No
  /// allocation, no lock.
  hal::ImuStatus next(hal::ImuSample* sample, rt::TimeNs timeout_ns);

  /// The same without waiting, for samples at or before t_ns; a later one is kept for the next call. False: there is
  /// none now.
  bool next_until(rt::TimeNs t_ns, hal::ImuSample* sample);

  /// All but silences, which the tracker counts.
  ImuCounters counters;

 private:
  hal::Imu* imu_;
  const bool live_;
  Onlooker* const onlooker_;
  rt::TimeNs t_last_ns_ = 0;
  bool any_ = false;   ///< t_last_ns_ is set
  bool held_ = false;  ///< held_sample_ is waiting for its frame
  hal::ImuSample held_sample_;
};

}  // namespace godwit::app
