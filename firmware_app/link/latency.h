// How old a pose is when the autopilot has it, measured; and the value of VISO_DELAY_MS that follows.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "firmware_app/link/mavlink/messages.h"
#include "hal/rt/time.h"

namespace godwit::link {

/// MAVLink TIMESYNC, both roles. One thread, no allocation.
class TimeSync {
 public:
  /// A question to send now.
  mavlink::Timesync question(rt::TimeNs now_ns);
  /// Our answer to a question (tc1 == 0): our clock, CLOCK_MONOTONIC [ns].
  static mavlink::Timesync answer(const mavlink::Timesync& question, rt::TimeNs now_ns);
  /// Takes an answer; false where it answers no question of ours, or came more than a second late.
  bool take_answer(const mavlink::Timesync& answer, rt::TimeNs now_ns);

  /// At least 8 answers were taken and the last is at most 10 s old.
  bool synchronised(rt::TimeNs now_ns) const;
  /// Smallest round trip of the last 32 answers [ns].
  rt::TimeNs round_trip_ns() const { return best_round_trip_ns_; }
  /// The autopilot's clock minus ours [ns], from the answer with the smallest round trip, whose error is at most half
  /// of it.
  rt::TimeNs offset_ns() const { return offset_ns_; }
  std::uint64_t answers() const { return answers_; }

 private:
  static constexpr std::size_t kWindow = 32;
  struct Answer {
    rt::TimeNs round_trip_ns = 0;
    rt::TimeNs offset_ns = 0;
  };
  std::array<rt::TimeNs, 8> asked_{};  ///< questions not answered yet, 0: none
  std::size_t next_question_ = 0;
  std::array<Answer, kWindow> window_{};
  std::uint64_t answers_ = 0;
  rt::TimeNs last_answer_ns_ = 0;
  rt::TimeNs best_round_trip_ns_ = 0;
  rt::TimeNs offset_ns_ = 0;
};

/// What of the way from capture to the autopilot is not in our own clock.
struct LatencyPath {
  rt::TimeNs one_way_ns = 0;     ///< half the smallest TIMESYNC round trip
  rt::TimeNs wire_extra_ns = 0;  ///< time on the wire of a pose message beyond that of a TIMESYNC
  /// ArduPilot takes a message through the tunnel for older than its arrival, by 10 bits a byte at the baud rate that
  /// the tunnel names.
  rt::TimeNs serial_correction_ns = 0;
};

struct LatencySummary {
  std::size_t samples = 0;
  double min_ms = 0;
  double p50_ms = 0;
  double p99_ms = 0;
  int viso_delay_ms = 0;  ///< what to set: the smallest latency, as the autopilot itself reckons arrival; 0 to 250
  bool grew = false;      ///< the median rose by more than 10 ms and a quarter above that of the first window
};

/// The newest kSize times of one kind. One thread, no allocation.
class TimeWindow {
 public:
  static constexpr std::size_t kSize = 512;
  void add(rt::TimeNs time_ns);
  std::size_t size() const { return count_ < kSize ? count_ : kSize; }
  /// Readies the percentiles: sorts a copy, so call it about once a second.
  void sort();
  /// Share 0 (least) to 1 (most) of the times as they were at the last sort() [ms]; 0 where there were none.
  double share_ms(double share) const;

 private:
  std::array<float, kSize> times_ms_{};
  std::array<float, kSize> sorted_ms_{};
  std::size_t count_ = 0;
  std::size_t sorted_ = 0;
};

/// Latencies of the newest poses. One thread, no allocation.
class LatencyMonitor {
 public:
  static constexpr std::size_t kWindow = TimeWindow::kSize;
  static constexpr std::size_t kMinSamples = 60;
  /// t_sent_ns: when the last frame of the message was handed to the bus.
  void add(rt::TimeNs t_capture_ns, rt::TimeNs t_sent_ns, const LatencyPath& path);
  /// Sorts the windows: call it about once a second.
  LatencySummary summary();

 private:
  TimeWindow total_;
  TimeWindow corrected_;
  double baseline_p50_ms_ = 0;
};

}  // namespace godwit::link
