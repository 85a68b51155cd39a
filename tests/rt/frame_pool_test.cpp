#include "hal/rt/frame_pool.h"

#include <atomic>
#include <cstring>
#include <gtest/gtest.h>
#include <memory>
#include <set>
#include <thread>

#include "tests/support/stress.h"

namespace godwit::rt {
namespace {

FramePool::Layout layout(int slots, int readers) {
  FramePool::Layout l;
  l.width = 70;
  l.height = 50;
  l.pyramid_bytes = 1000;
  l.colour = true;
  l.slots = slots;
  l.readers = readers;
  return l;
}

TEST(FramePool, RefusesAbsurdLayouts) {
  FramePool::Layout l = layout(4, 1);
  l.width = kMaxImageWidth + 1;
  EXPECT_FALSE(FramePool::create(l).ok());
  EXPECT_FALSE(FramePool::create(layout(0, 1)).ok());
  EXPECT_FALSE(FramePool::create(layout(kMaxFrameSlots + 1, 1)).ok());
  EXPECT_FALSE(FramePool::create(layout(4, 0)).ok());
  EXPECT_FALSE(FramePool::create(layout(4, kMaxFrameReaders + 1)).ok());
}

TEST(FramePool, TellsHowFewSlotsWereFree) {
  const auto pool = std::move(FramePool::create(layout(4, 1))).value();
  EXPECT_EQ(pool->free_slots(), 4);
  EXPECT_EQ(pool->fewest_free_slots(), 4);
  const int a = pool->acquire(), b = pool->acquire();
  pool->hand_out(a, 1);
  pool->hand_out(b, 1);
  pool->cancel(pool->acquire());
  EXPECT_EQ(pool->free_slots(), 2);
  FrameReturn back = pool->reader(0);
  back.give_back(a);
  back.give_back(b);
  pool->cancel(pool->acquire());
  EXPECT_EQ(pool->free_slots(), 4);
  EXPECT_EQ(pool->fewest_free_slots(), 2);
  for (int i = 0; i < 4; ++i) pool->hand_out(pool->acquire(), 1);
  EXPECT_EQ(pool->acquire(), -1);
  EXPECT_EQ(pool->free_slots(), 0);
  EXPECT_EQ(pool->fewest_free_slots(), 0);
}

TEST(FramePool, PartsOfAllSlotsAreAlignedAndDoNotOverlap) {
  const auto pool = std::move(FramePool::create(layout(3, 1))).value();
  struct Part {
    std::uint8_t* begin;
    std::size_t bytes;
  };
  std::vector<Part> parts;
  for (int s = 0; s < 3; ++s) {
    const MutableImageView grey = pool->grey(s);
    EXPECT_EQ(grey.width, 70);
    EXPECT_EQ(grey.stride, 128);
    parts.push_back({grey.data, static_cast<std::size_t>(grey.stride) * 50 + kRowAlignment});
    parts.push_back({pool->pyramid_storage(s), 1000 + kRowAlignment});
    parts.push_back({pool->bgr(s), 70 * 50 * 3});
  }
  for (const Part& p : parts) {
    EXPECT_EQ(reinterpret_cast<std::uintptr_t>(p.begin) % kRowAlignment, 0u);
    std::memset(p.begin, 0xA5, p.bytes);  // the address sanitizer sees a write past the end
    for (const Part& q : parts) {
      if (p.begin != q.begin) {
        EXPECT_TRUE(p.begin + p.bytes <= q.begin || q.begin + q.bytes <= p.begin);
      }
    }
  }
}

TEST(FramePool, WithoutColourThereIsNoBgr) {
  FramePool::Layout l = layout(2, 1);
  l.colour = false;
  const auto pool = std::move(FramePool::create(l)).value();
  EXPECT_EQ(pool->bgr(0), nullptr);
}

TEST(FramePool, ASlotIsFreeOnlyWhenAllReferencesAreBack) {
  const auto pool = std::move(FramePool::create(layout(1, 2))).value();
  FrameReturn tracker = pool->reader(0), mapper = pool->reader(1);
  const int slot = pool->acquire();
  ASSERT_EQ(slot, 0);
  pool->hand_out(slot, 2);
  tracker.give_back(slot);
  EXPECT_EQ(pool->acquire(), -1) << "the mapper still holds it";
  EXPECT_EQ(pool->exhausted(), 0u) << "a feeder that can wait drops nothing";
  pool->count_drop();
  EXPECT_EQ(pool->exhausted(), 1u);
  mapper.give_back(slot);
  EXPECT_EQ(pool->acquire(), 0);
}

TEST(FramePool, OneReaderMayReturnSeveralReferencesAtOnce) {
  const auto pool = std::move(FramePool::create(layout(1, 2))).value();
  const int slot = pool->acquire();
  pool->hand_out(slot, 2);
  pool->reader(0).give_back(slot, 2);
  EXPECT_EQ(pool->acquire(), 0);
}

TEST(FramePool, ACancelledSlotIsFreeAgain) {
  const auto pool = std::move(FramePool::create(layout(1, 1))).value();
  pool->cancel(pool->acquire());
  EXPECT_EQ(pool->acquire(), 0);
}

// Owner, tracker and mapper as in flight: the tracker passes every third frame on and returns both references of the
// others; the mapper keeps many. Nobody may ever see a picture change while holding a reference to it.
TEST(FramePoolStress, ThreeThreadsNeverSeeASlotReusedUnderTheirEyes) {
  const auto kFrames = static_cast<std::uint32_t>(test::stress_items());
  FramePool::Layout l = layout(64, 2);
  l.colour = false;
  const auto pool = std::move(FramePool::create(l)).value();
  SpscRing<FrameHandle, 32> to_tracker;
  SpscRing<FrameHandle, 16> to_mapper;
  std::atomic<std::uint64_t> wrong{0};
  std::atomic<bool> tracker_done{false};

  const auto stamp = [](std::uint32_t sequence) { return static_cast<std::uint8_t>(sequence * 37u + 11u); };
  const auto check = [&](const FrameHandle& h) {
    const MutableImageView g = pool->grey(h.slot);
    const bool same = g.data[0] == stamp(h.meta.sequence) && g.data[g.stride * (g.height - 1)] == g.data[0] &&
                      pool->meta(h.slot).sequence == h.meta.sequence;
    if (!same) wrong.fetch_add(1, std::memory_order_relaxed);
  };

  std::thread tracker([&] {
    FrameReturn give = pool->reader(0);
    test::Patience patience;
    for (std::uint32_t seen = 0; seen < kFrames;) {
      FrameHandle h;
      if (!to_tracker.try_pop(&h)) {
        patience.wait();
        continue;
      }
      patience.progress();
      check(h);
      const bool pass_on = h.meta.sequence % 3 == 0 && to_mapper.try_push(h);
      check(h);
      give.give_back(h.slot, pass_on ? 1 : 2);
      ++seen;
    }
    tracker_done.store(true, std::memory_order_release);
  });
  std::thread mapper([&] {
    FrameReturn give = pool->reader(1);
    std::vector<FrameHandle> kept;
    test::Patience patience;
    while (true) {
      const bool last_round = tracker_done.load(std::memory_order_acquire);
      FrameHandle h;
      while (to_mapper.try_pop(&h)) {
        patience.progress();
        kept.push_back(h);
        if (kept.size() > 40) {
          check(kept.front());
          give.give_back(kept.front().slot);
          kept.erase(kept.begin());
        }
      }
      if (last_round) break;
      patience.wait();
    }
    for (const FrameHandle& h : kept) {
      check(h);
      give.give_back(h.slot);
    }
  });
  test::Patience patience;
  for (std::uint32_t sequence = 0; sequence < kFrames;) {
    const int slot = pool->acquire();
    if (slot < 0) {
      patience.wait();
      continue;
    }
    patience.progress();
    const MutableImageView g = pool->grey(slot);
    g.data[0] = stamp(sequence);
    g.data[g.stride * (g.height - 1)] = stamp(sequence);
    pool->meta(slot) = {static_cast<TimeNs>(sequence), 0, sequence};
    pool->hand_out(slot, 2);
    while (!to_tracker.try_push({slot, pool->meta(slot)})) patience.wait();
    ++sequence;
  }
  tracker.join();
  mapper.join();
  EXPECT_EQ(wrong.load(), 0u);
  std::set<int> free_again;
  for (int i = 0; i < 64; ++i) free_again.insert(pool->acquire());
  EXPECT_EQ(free_again.size(), 64u) << "every reference came home";
  EXPECT_EQ(free_again.count(-1), 0u);
}

TEST(FramePool, AnOnlookerHoldsASlotOnlyWhereItGotAReference) {
  FramePool::Layout with = layout(1, 2);
  with.onlooker = true;
  auto pool = std::move(FramePool::create(with)).value();
  FrameReturn first = pool->reader(0), onlooker = pool->onlooker();
  pool->hand_out(pool->acquire(), 2);
  first.give_back(0, 2);
  EXPECT_EQ(pool->acquire(), 0) << "it was shown nothing";
  pool->hand_out(0, 3);
  first.give_back(0, 2);
  EXPECT_EQ(pool->acquire(), -1);
  onlooker.give_back(0);
  EXPECT_EQ(pool->acquire(), 0);
  with.readers = kMaxFrameReaders;
  EXPECT_FALSE(FramePool::create(with).ok()) << "one too many";
}

}  // namespace
}  // namespace godwit::rt
