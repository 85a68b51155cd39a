#include "firmware_app/output/event_ring.h"

#include <gtest/gtest.h>

namespace godwit::app {
namespace {

void add(EventRing* ring, int number) {
  std::uint8_t* const to = ring->place();
  ASSERT_NE(to, nullptr);
  to[0] = static_cast<std::uint8_t>(number);
  rt::FrameMeta meta;
  meta.t_capture_ns = number * 10;
  ring->added(meta);
}

std::unique_ptr<EventRing> four() {
  return std::move(EventRing::create({8, 4, 4, 6})).value();
}

TEST(EventRing, TheOldestMakeWay) {
  const auto ring = four();
  for (int i = 0; i < 7; ++i) add(ring.get(), i);
  EXPECT_EQ(ring->first(), 3u);
  EXPECT_EQ(ring->next(), 7u);
  for (std::uint64_t n = 3; n < 7; ++n) {
    EXPECT_EQ(ring->pixels(n).at(0, 0), n);
    EXPECT_EQ(ring->meta(n).t_capture_ns, static_cast<rt::TimeNs>(n) * 10);
  }
  EXPECT_EQ(ring->at(45, 0), 5u);
  EXPECT_EQ(ring->at(0, 0), 3u);
  EXPECT_EQ(ring->at(0, 6), 6u);
  EXPECT_EQ(ring->at(1000, 0), 7u) << "none";
}

TEST(EventRing, WhatIsKeptIsNotOverwritten) {
  const auto ring = four();
  for (int i = 0; i < 4; ++i) add(ring.get(), i);
  ring->keep_from(1);
  add(ring.get(), 4);
  EXPECT_EQ(ring->place(), nullptr) << "1 is the oldest and kept";
  EXPECT_EQ(ring->pixels(1).at(0, 0), 1);
  ring->keep_from(2);
  add(ring.get(), 5);
  ring->keep_from(~0ULL);
  for (int i = 6; i < 12; ++i) add(ring.get(), i);
  EXPECT_EQ(ring->first(), 8u);
}

TEST(EventRing, ReadingsOfASpanAreCopied) {
  const auto ring = four();
  for (int i = 0; i < 10; ++i) {
    hal::ImuSample s;
    s.t_ns = i;
    ring->add(s);
  }
  std::vector<hal::ImuSample> out;
  ring->copy_samples(2, 7, &out);
  ASSERT_EQ(out.size(), 4u) << "4 to 9 are held";
  EXPECT_EQ(out.front().t_ns, 4);
  EXPECT_EQ(out.back().t_ns, 7);
}

}  // namespace
}  // namespace godwit::app
