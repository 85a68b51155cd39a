#include "hal/rt/triple_buffer.h"

#include <atomic>
#include <cstdint>
#include <gtest/gtest.h>
#include <thread>

#include "tests/support/stress.h"

namespace godwit::rt {
namespace {

TEST(TripleBuffer, GivesTheLatestOnce) {
  TripleBuffer<int> buffer;
  int value = -1;
  EXPECT_FALSE(buffer.read(&value)) << "nothing was written yet";
  buffer.write(1);
  buffer.write(2);
  buffer.write(3);
  ASSERT_TRUE(buffer.read(&value));
  EXPECT_EQ(value, 3);
  EXPECT_FALSE(buffer.read(&value)) << "the same value is not news twice";
  buffer.write(4);
  ASSERT_TRUE(buffer.read(&value));
  EXPECT_EQ(value, 4);
}

struct WideValue {
  std::uint64_t word[16];
};

TEST(TripleBufferStress, AcrossThreadsValuesAreWholeRiseAndTheLastArrives) {
  const std::uint64_t kValues = test::stress_items();
  TripleBuffer<WideValue> buffer;
  std::thread writer([&] {
    for (std::uint64_t i = 1; i <= kValues; ++i) {
      WideValue value{};
      for (std::uint64_t& w : value.word) w = i;
      buffer.write(value);
    }
  });
  std::uint64_t last = 0, torn = 0, backwards = 0;
  test::Patience patience;
  while (last < kValues) {
    WideValue value{};
    if (!buffer.read(&value)) {
      patience.wait();
      continue;
    }
    patience.progress();
    for (const std::uint64_t w : value.word) torn += w != value.word[0] ? 1u : 0u;
    backwards += value.word[0] <= last ? 1u : 0u;
    last = value.word[0];
  }
  writer.join();
  EXPECT_EQ(torn, 0u);
  EXPECT_EQ(backwards, 0u);
}

}  // namespace
}  // namespace godwit::rt
