#include "hal/can/can_frame.h"

#include <gtest/gtest.h>

#include "hal/can/can_bus.h"
#include "hal/can/crc16.h"

namespace godwit::hal::can_frame_test {
namespace {

TEST(CanFrame, FdLengthsAreThoseOfTheStandard) {
  const std::array<std::size_t, 16> legal{0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64};
  for (std::size_t n = 0; n <= 64; ++n) {
    const auto expected = *std::lower_bound(legal.begin(), legal.end(), n);
    EXPECT_EQ(fd_frame_length(n), expected) << n;
  }
}

TEST(Crc16, CatalogueCheckValue) {
  const std::array<std::uint8_t, 9> text{'1', '2', '3', '4', '5', '6', '7', '8', '9'};
  EXPECT_EQ(crc16(text), 0x29B1);
}

TEST(CanFilter, ComparesMaskedIdentifiersOfTheSameLength) {
  const std::array<CanFilter, 2> filters{CanFilter{0x00015500, 0x00FFFF80, true}, CanFilter{0x123, 0x7FF, false}};
  CanFrame frame;
  frame.id = 0x1401552A;
  EXPECT_TRUE(passes(filters, frame));
  frame.id = 0x1401562A;
  EXPECT_FALSE(passes(filters, frame));
  frame.id = 0x123;
  EXPECT_FALSE(passes(filters, frame));
  frame.extended = false;
  EXPECT_TRUE(passes(filters, frame));
  EXPECT_TRUE(passes({}, frame));
}

TEST(OpenCan, SaysWhatItExpected) {
  for (const char* bad : {"", "can0", "multicast:", "multicast:x", "multicast:12", "multicast:1:", "socketcan:"}) {
    const auto bus = open_can(bad);
    ASSERT_FALSE(bus.ok()) << bad;
    EXPECT_NE(bus.error().message.find("multicast"), std::string::npos) << bus.error().message;
  }
  const auto gone = open_can("socketcan:nosuchcan0");
  ASSERT_FALSE(gone.ok());
  EXPECT_NE(gone.error().message.find("nosuchcan0"), std::string::npos) << gone.error().message;
  const auto address = open_can("multicast:0:somewhere");
  ASSERT_FALSE(address.ok());
  EXPECT_NE(address.error().message.find("somewhere"), std::string::npos);
}

}  // namespace
}  // namespace godwit::hal::can_frame_test
