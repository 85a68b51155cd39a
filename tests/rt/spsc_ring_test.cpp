#include "hal/rt/spsc_ring.h"

#include <cstdint>
#include <gtest/gtest.h>
#include <memory>
#include <thread>

#include "tests/support/stress.h"

namespace godwit::rt {
namespace {

TEST(SpscRing, KeepsOrderAndRefusesWhenFull) {
  SpscRing<int, 4> ring;
  int out = -1;
  EXPECT_FALSE(ring.try_pop(&out));
  EXPECT_EQ(out, -1);
  for (int i = 0; i < 4; ++i) EXPECT_TRUE(ring.try_push(i));
  EXPECT_EQ(ring.size(), 4u);
  EXPECT_FALSE(ring.try_push(99)) << "a full ring never overwrites";
  for (int i = 0; i < 4; ++i) {
    ASSERT_TRUE(ring.try_pop(&out));
    EXPECT_EQ(out, i);
  }
  EXPECT_EQ(ring.size(), 0u);
}

TEST(SpscRing, FrontLooksWithoutTaking) {
  SpscRing<int, 2> ring;
  EXPECT_EQ(ring.front(), nullptr);
  ASSERT_TRUE(ring.try_push(5));
  ASSERT_NE(ring.front(), nullptr);
  EXPECT_EQ(*ring.front(), 5);
  EXPECT_EQ(ring.size(), 1u);
  ring.drop_front();
  EXPECT_EQ(ring.front(), nullptr);
}

TEST(SpscRing, WrapsManyTimes) {
  SpscRing<int, 2> ring;
  int out = 0;
  for (int i = 0; i < 1000; ++i) {
    ASSERT_TRUE(ring.try_push(i));
    ASSERT_TRUE(ring.try_pop(&out));
    ASSERT_EQ(out, i);
  }
}

// A large item whose words must all agree: a torn copy shows.
struct Wide {
  std::uint64_t word[16];
};

TEST(SpscRingStress, ItemsBetweenTwoThreadsArriveWholeAndInOrder) {
  const std::uint64_t kItems = test::stress_items();
  const auto ring = std::make_unique<SpscRing<Wide, 64>>();
  std::thread producer([&] {
    test::Patience patience;
    for (std::uint64_t i = 0; i < kItems;) {
      Wide item{};
      for (std::uint64_t& w : item.word) w = i;
      if (ring->try_push(item)) {
        ++i;
        patience.progress();
      } else {
        patience.wait();
      }
    }
  });
  std::uint64_t wrong = 0;
  test::Patience patience;
  for (std::uint64_t expected = 0; expected < kItems;) {
    Wide item{};
    if (!ring->try_pop(&item)) {
      patience.wait();
      continue;
    }
    patience.progress();
    for (const std::uint64_t w : item.word) wrong += w != expected ? 1u : 0u;
    ++expected;
  }
  producer.join();
  EXPECT_EQ(wrong, 0u);
  EXPECT_EQ(ring->size(), 0u);
}

}  // namespace
}  // namespace godwit::rt
