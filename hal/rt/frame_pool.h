// Fixed slots for pictures, allocated once, shared between threads by counted references without a lock.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "hal/rt/image.h"
#include "hal/rt/result.h"
#include "hal/rt/spsc_ring.h"
#include "hal/rt/time.h"

namespace godwit::rt {

constexpr int kMaxFrameSlots = 128;
constexpr int kMaxFrameReaders = 4;

/// What travels with a picture; written by the owner before it hands the frame out.
struct FrameMeta {
  TimeNs t_capture_ns = 0;     ///< middle of exposure, CLOCK_MONOTONIC
  TimeNs t_source_ns = 0;      ///< the source's own timestamp
  std::uint32_t sequence = 0;  ///< counts every picture that was due
  TimeNs t_delivered_ns = 0;   ///< when the camera handed it over, CLOCK_MONOTONIC
};

/// What goes through the rings from thread to thread: which slot, and whose picture it holds.
struct FrameHandle {
  int slot = -1;
  FrameMeta meta;
};

class FramePool;

/// One reader's way of giving references back. Owned by one thread at a time; copying it shares the same ring.
class FrameReturn {
 public:
  /// Gives `count` references to this slot back. Wait-free, no allocation. From here on the reader must not touch the
  /// slot by these references.
  void give_back(int slot, int count = 1);

 private:
  friend class FramePool;
  FrameReturn(FramePool* pool, int reader) : pool_(pool), reader_(reader) {}
  FramePool* pool_;
  int reader_;
};

/// The slots. One thread, the owner (camera or feeder), acquires, fills and hands out; only it counts.
///
/// A frame goes out with as many references as there are readers that may come to hold it. Whoever ends up without need
/// of one gives it back: the tracker returns two for a frame that it did not pass on to the mapper, and one otherwise.
/// Nobody adds a reference later: an "add" of one reader could reach the owner after another reader's "give back", and
/// the slot would be reused under the first one's eyes. A slot is free when all references are back.
class FramePool {
 public:
  struct Layout {
    int width = 0;                  ///< of the grey picture, at most kMaxImageWidth
    int height = 0;                 ///< at most kMaxImageHeight
    std::size_t pyramid_bytes = 0;  ///< storage for the pyramid levels above 0
    bool colour = false;            ///< also a BGR picture in each slot
    int slots = 0;                  ///< 1 to kMaxFrameSlots
    int readers = 0;                ///< 1 to kMaxFrameReaders
    /// One more who reads (counts among kMaxFrameReaders), and gets a reference to a frame only where the owner says
    /// so.
    bool onlooker = false;
  };

  /// Allocates and touches everything. Error: a size or number out of range, or no memory.
  static Result<std::unique_ptr<FramePool>> create(const Layout& layout);

  /// Owner. A free slot, or -1 if there is none. Collects what the readers gave back. No allocation, bounded.
  int acquire();
  /// Owner. Counts a picture that was due while there was no slot: the newest frame is the one that is dropped.
  void count_drop() { exhausted_.fetch_add(1, std::memory_order_relaxed); }
  /// Owner. The slot's frame leaves with this many references (1 or more). Push the handle into the rings after it.
  void hand_out(int slot, int references);
  /// Owner. Takes an acquired slot back that was never handed out (bad picture).
  void cancel(int slot);

  /// The return ring of reader 0 .. readers-1.
  FrameReturn reader(int index);
  /// That of Layout::onlooker.
  FrameReturn onlooker();

  /// The owner between acquire and hand_out may write, holders of a reference may read; the pyramid storage belongs to
  /// the first reader. Level 0 has kRowAlignment-aligned rows and at least kRowAlignment readable bytes behind it.
  MutableImageView grey(int slot) const;
  std::uint8_t* pyramid_storage(int slot) const;
  std::size_t pyramid_bytes() const { return layout_.pyramid_bytes; }
  std::uint8_t* bgr(int slot) const;  ///< null without colour; width * 3 bytes a row, no padding
  FrameMeta& meta(int slot) { return slots_[slot].meta; }
  const FrameMeta& meta(int slot) const { return slots_[slot].meta; }

  int slots() const { return layout_.slots; }
  const Layout& layout() const { return layout_; }
  /// Slots that were free when the owner last asked for one, that one included, and the fewest that ever were. Any
  /// thread.
  int free_slots() const { return free_.load(std::memory_order_relaxed); }
  int fewest_free_slots() const { return fewest_free_.load(std::memory_order_relaxed); }
  /// Frames dropped because no slot was free. Any thread.
  std::uint64_t exhausted() const { return exhausted_.load(std::memory_order_relaxed); }

 private:
  friend class FrameReturn;
  struct Return {
    std::int16_t slot;
    std::int16_t count;
  };
  struct Slot {
    FrameMeta meta;
    int references = 0;  ///< owner's count
    bool taken = false;  ///< acquired and not yet free again
  };
  struct FreeDeleter {
    void operator()(std::uint8_t* p) const;
  };
  // A reader returns each reference at most once, so a ring with room for all of them can never be full.
  using ReturnRing = SpscRing<Return, static_cast<std::size_t>(kMaxFrameSlots) * kMaxFrameReaders>;

  explicit FramePool(const Layout& layout);
  void collect();

  Layout layout_;
  int stride_ = 0;
  std::size_t grey_bytes_ = 0;
  std::size_t slot_bytes_ = 0;
  std::unique_ptr<std::uint8_t, FreeDeleter> memory_;
  std::vector<Slot> slots_;
  std::vector<std::unique_ptr<ReturnRing>> returns_;
  int next_ = 0;   ///< where the search for a free slot goes on: the slot longest free comes first
  int taken_ = 0;  ///< slots
  /// Written by the owner, read by whoever reports. Figures alone: nothing is ordered by them.
  std::atomic<std::uint64_t> exhausted_{0};
  std::atomic<int> free_{0}, fewest_free_{0};
};

}  // namespace godwit::rt
