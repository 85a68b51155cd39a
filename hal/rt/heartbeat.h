// Signs of life: each thread of a flight beats, and whoever may look finds the one that fell silent.
#pragma once

#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <initializer_list>
#include <string_view>

#include "hal/rt/time.h"

namespace godwit::rt {

class Heartbeats;

/// One thread's side. Empty: beats are nobody's. beat() is for any thread under real-time rules: no allocation, no
/// lock.
class Pulse {
 public:
  Pulse() = default;
  void beat();
  /// The thread ends rightly: it is not waited for any more.
  void end();

 private:
  friend class Heartbeats;
  Pulse(Heartbeats* all, std::size_t index) : all_(all), index_(index) {}
  Heartbeats* all_ = nullptr;
  std::size_t index_ = 0;
};

/// Outlives the threads that beat.
class Heartbeats {
 public:
  static constexpr std::size_t kMost = 16;

  /// A thread silent for longer than its patience; name null: there is none.
  struct Silent {
    const char* name = nullptr;
    TimeNs for_ns = 0;
  };

  /// From now on this thread is to beat more often than every patience_ns. name: static text. One thread calls it,
  /// before the one that is watched runs; more than kMost get an empty pulse.
  Pulse watch(const char* name, TimeNs patience_ns) {
    const std::size_t index = count_.load(std::memory_order_relaxed);
    if (index == kMost) return {};
    beats_[index].name = name;
    beats_[index].patience_ns = patience_ns;
    beats_[index].t_ns.store(monotonic_now_ns(), std::memory_order_relaxed);
    // Release, partner: the acquire load in silent(), which must not see a place before its name.
    count_.store(index + 1, std::memory_order_release);
    return {this, index};
  }

  /// Any thread; no allocation, no lock, bounded. The one longest over its patience; of these threads only, where any
  /// are named.
  Silent silent(TimeNs now_ns, std::initializer_list<std::string_view> only = {}) const {
    Silent out;
    TimeNs worst = 0;
    const std::size_t count = count_.load(std::memory_order_acquire);
    for (std::size_t i = 0; i < count; ++i) {
      // Relaxed: each stands for itself; one seen late looks older than it is by the look's own length.
      const TimeNs t = beats_[i].t_ns.load(std::memory_order_relaxed);
      const TimeNs over = now_ns - t - beats_[i].patience_ns;
      if (t == kEnded || over <= worst) continue;
      if (only.size() > 0 && std::find(only.begin(), only.end(), beats_[i].name) == only.end()) continue;
      worst = over;
      out = {beats_[i].name, now_ns - t};
    }
    return out;
  }

 private:
  friend class Pulse;
  static constexpr TimeNs kEnded = -1;
  struct Beat {
    const char* name = "";
    TimeNs patience_ns = 0;
    std::atomic<TimeNs> t_ns{kEnded};
  };
  std::array<Beat, kMost> beats_;
  std::atomic<std::size_t> count_{0};
};

inline void Pulse::beat() {
  if (all_ != nullptr) all_->beats_[index_].t_ns.store(monotonic_now_ns(), std::memory_order_relaxed);
}
inline void Pulse::end() {
  if (all_ != nullptr) all_->beats_[index_].t_ns.store(Heartbeats::kEnded, std::memory_order_relaxed);
}

}  // namespace godwit::rt
