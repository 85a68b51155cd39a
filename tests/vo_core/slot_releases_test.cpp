// References on their way back: none is lost, however late they are taken.
#include "vo_core/map/slot_releases.h"

#include <array>
#include <gtest/gtest.h>

namespace godwit::vo {
namespace slot_releases_test {

TEST(SlotReleases, NoneIsDroppedHoweverManyWait) {
  SlotReleases releases;
  for (int round = 0; round < 5; ++round)
    for (int slot = 0; slot < rt::kMaxFrameSlots; ++slot) releases.add(slot, 1 + slot % 2);
  releases.add(-1, 1);
  releases.add(3, 0);
  std::array<int, rt::kMaxFrameSlots> back{};
  SlotRelease one;
  while (releases.take(&one)) back[static_cast<std::size_t>(one.slot)] += one.count;
  for (int slot = 0; slot < rt::kMaxFrameSlots; ++slot)
    EXPECT_EQ(back[static_cast<std::size_t>(slot)], 5 * (1 + slot % 2)) << slot;
  EXPECT_FALSE(releases.take(&one));
}

}  // namespace slot_releases_test
}  // namespace godwit::vo
