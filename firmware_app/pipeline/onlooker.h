// Each picture and reading for somebody beside the flight, who copies them on a thread of his own: nobody waits for
// him, and what he has no room for he misses.
#pragma once

#include <atomic>
#include <cstdint>

#include "firmware_app/pipeline/stage.h"
#include "hal/imu/imu.h"
#include "hal/rt/frame_pool.h"
#include "hal/rt/spsc_ring.h"
#include "hal/rt/wake_up.h"

namespace godwit::app {

/// The two rings to the onlooker's thread. That takes a handle, copies the picture and gives the slot back
/// (FramePool::onlooker), all before it does anything that takes time: at most kOnlookerSlots slots are his. Large:
/// create it on the heap, before arming; it outlives the run.
class Onlooker {
 public:
  /// Camera's thread. Whether a picture may be shown now; false: it is counted as missed. waiting: not live, somebody
  /// who replays as fast as it goes waits for room, a few seconds at most. No allocation, no lock; live: no wait.
  bool has_room(bool live) {
    if (await(live, [this] { return pictures.size() < kOnlookerSlots; })) return true;
    pictures_missed.fetch_add(1, std::memory_order_relaxed);
    return false;
  }
  /// Camera's thread, after has_room(), with a reference of the onlooker's own.
  void show(const rt::FrameHandle& frame) {
    pictures.try_push(frame);  // has_room() said so, and nobody else pushes
    wake.post();
  }
  /// The thread that reads the inertial sensor; the same rules. It wakes nobody: pictures do, and time.
  void show(const hal::ImuSample& sample, bool live) {
    const bool room = await(live, [this] { return samples.size() < samples.capacity(); });
    if (!room || !samples.try_push(sample)) samples_missed.fetch_add(1, std::memory_order_relaxed);
  }

  rt::SpscRing<rt::FrameHandle, kOnlookerSlots> pictures;  ///< camera's thread -> onlooker
  rt::SpscRing<hal::ImuSample, 1024> samples;              ///< reader of the inertial sensor -> onlooker
  rt::WakeUp wake;
  /// Relaxed; counters.
  std::atomic<std::uint64_t> pictures_missed{0}, samples_missed{0};

 private:
  static constexpr rt::TimeNs kPatienceNs = 5 * rt::kNsPerSecond;

  template <typename Room>
  bool await(bool live, Room room) {
    if (room() || live) return room();
    const rt::TimeNs give_up_ns = rt::monotonic_now_ns() + kPatienceNs;
    while (!room() && rt::monotonic_now_ns() < give_up_ns) {
      wake.post();
      rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerMs / 5);
    }
    return room();
  }
};

}  // namespace godwit::app
