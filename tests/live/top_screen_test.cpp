#include "firmware_app/commands/top_screen.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sstream>

namespace godwit::app {
namespace {

using testing::HasSubstr;
using testing::Not;

TEST(TopScreen, ShowsWhatIsTold) {
  const auto shown = top_screen(
      R"({"version":"0.1.0","pid":12,"uptime_s":7.04,"state":"TRACKING","reason":"tracking: 120 of 30","quality":73,)"
      R"("metric":true,"position":[1.0,-2.5,3.25],"position_sigma":0.125,"features":120,"pictures_hz":30.04,)"
      R"("north":"held","fixes":9,)"
      R"("age_ms":{"p50":18.25,"p95":19.0,"max":21.5},"temperature_c":61.5,"throttled":true,"events":["one","two"]})",
      100);
  ASSERT_TRUE(shown.ok()) << shown.error().message;
  for (const char* part : {"godwitd 0.1.0  pid 12  up 7 s", "TRACKING  tracking: 120 of 30", "quality      73",
                           "1.000 -2.500 3.250 m  sigma 0.125", "held  sigma -  fixes 9  used -",
                           "30.0 pictures/s  - poses/s", "features 120", "age at pose     18.25   19.00   21.50",
                           "our share           -       -       -", "61.5 C  the machine slows", "  one\n  two\n"}) {
    EXPECT_THAT(shown.value(), HasSubstr(part));
  }
}

TEST(TopScreen, OfAnyLineALineAColumnWide) {
  const auto shown = top_screen(
      R"({"state":null,"reason":[1],"position":["x",{},null],"age_ms":7,"events":[3,"\u001b[2Jred \u00e9\u00e9\u00e9\u00e9\u00e9\u00e9\u00e9\u00e9\u00e9"]})",
      20);
  ASSERT_TRUE(shown.ok()) << shown.error().message;
  EXPECT_THAT(shown.value(), Not(HasSubstr("\x1b")));
  std::istringstream lines(shown.value());
  for (std::string line; std::getline(lines, line);) EXPECT_LE(line.size(), 20u) << line;
}

TEST(TopScreen, WhatIsNotGodwitdsIsRefused) {
  for (const char* line : {"", "x", "[]", "7", "{}", "{\"state\":", "null"})
    EXPECT_FALSE(top_screen(line, 80).ok()) << line;
  EXPECT_EQ(top_screen(R"({"error":"8 others read already"})", 80).error().message, "8 others read already");
}

}  // namespace
}  // namespace godwit::app
