#include "hal/camera/replay/sequence_index.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace godwit::hal::sequence_index_test {
namespace {

using testing::HasSubstr;

TEST(DecimalSeconds, AreReadAndWrittenToTheLastNanosecond) {
  rt::TimeNs t = -1;
  ASSERT_TRUE(parse_decimal_seconds("1403636584.763555584", &t));
  EXPECT_EQ(t, 1403636584763555584);
  EXPECT_EQ(format_seconds(t), "1403636584.763555584");
  ASSERT_TRUE(parse_decimal_seconds("1305031102.175304", &t));
  EXPECT_EQ(format_seconds(t), "1305031102.175304000");
  ASSERT_TRUE(parse_decimal_seconds("7", &t));
  EXPECT_EQ(t, 7 * rt::kNsPerSecond);
  ASSERT_TRUE(parse_decimal_seconds("0.0000000019", &t));
  EXPECT_EQ(t, 1) << "digits behind the ninth are cut off";
}

TEST(DecimalSeconds, RefusesEverythingElse) {
  rt::TimeNs t = 0;
  for (const char* bad : {"", ".", "1.", ".5", "-1.0", "+1", "1e9", "1,5", "nan", "inf", "0x10", "1 2", "1.2.3",
                          "99999999999999999999", "9000000000.0"}) {
    EXPECT_FALSE(parse_decimal_seconds(bad, &t)) << bad;
  }
}

TEST(TumIndex, ReadsCommentsBlankLinesCarriageReturnsAndNamesWithBlanks) {
  const auto index = parse_tum_index("# a comment\r\n\r\n1.5 rgb/a.png\r\n  2.5\trgb/b c.png  \n3.5 d.png", "rgb.txt");
  ASSERT_TRUE(index.ok()) << index.error().message;
  const auto& e = index.value().entries;
  ASSERT_EQ(e.size(), 3u);
  EXPECT_EQ(e[0].file, "rgb/a.png");
  EXPECT_EQ(e[0].line, 3);
  EXPECT_EQ(e[1].file, "rgb/b c.png");
  EXPECT_EQ(e[2].t_ns, 3'500'000'000);
}

TEST(TumIndex, RefusesWithFileLineAndReason) {
  const auto no_time = parse_tum_index("1.0 a.png\nhello b.png\n", "x/rgb.txt");
  ASSERT_FALSE(no_time.ok());
  EXPECT_EQ(no_time.error().message, "x/rgb.txt:2: 'hello' is not a time in decimal seconds");
  const auto no_name = parse_tum_index("1.0\n", "x/rgb.txt");
  ASSERT_FALSE(no_name.ok());
  EXPECT_EQ(no_name.error().message, "x/rgb.txt:1: no file name behind the time");
  for (const char* empty : {"", "\n\n", "# only a comment\n"}) {
    const auto nothing = parse_tum_index(empty, "rgb.txt");
    ASSERT_FALSE(nothing.ok());
    EXPECT_EQ(nothing.error().message, "rgb.txt: lists no pictures");
  }
  const auto binary = parse_tum_index(std::string_view("\x01\x02\xff\0\xfe garbage", 13), "rgb.txt");
  ASSERT_FALSE(binary.ok());
  EXPECT_THAT(binary.error().message, HasSubstr("'.....'"));
}

TEST(TumIndex, AListThatBreaksOffIsReadUpToThere) {
  const auto index = parse_tum_index("1.0 a.png\n2.0 b.png\n3.", "rgb.txt");
  ASSERT_TRUE(index.ok()) << index.error().message;
  EXPECT_EQ(index.value().entries.size(), 2u);
  EXPECT_EQ(index.value().cut_off,
            "rgb.txt:3: '3.' is not a time in decimal seconds; the file breaks off there, what comes "
            "before is used");
  EXPECT_EQ(parse_tum_index("1.0 a.png\n2.0 b.png", "rgb.txt").value().cut_off, "");
  EXPECT_FALSE(parse_tum_index("1.0 a.png\n3.\n4.0 c.png", "rgb.txt").ok()) << "not at its end";
  EXPECT_FALSE(parse_tum_index("# head\n1.0", "rgb.txt").ok()) << "nothing comes before";
}

TEST(TumIndex, MarksTimesThatRepeatOrGoBackAgainstTheNewestSoFar) {
  const auto index = parse_tum_index("1 a\n2 b\n2 c\n1.5 d\n2 e\n3 f\n", "rgb.txt");
  ASSERT_TRUE(index.ok());
  const auto& e = index.value().entries;
  EXPECT_EQ(e[1].fault, TimeFault::kNone);
  EXPECT_EQ(e[2].fault, TimeFault::kRepeats);
  EXPECT_EQ(e[3].fault, TimeFault::kGoesBack);
  EXPECT_EQ(e[4].fault, TimeFault::kRepeats);
  EXPECT_EQ(e[5].fault, TimeFault::kNone);
}

TEST(EurocIndex, ReadsNanosecondsExactly) {
  const auto index =
      parse_euroc_index("#timestamp [ns],filename\r\n1403636579763555584,1403636579763555584.png\r\n", "data.csv");
  ASSERT_TRUE(index.ok()) << index.error().message;
  ASSERT_EQ(index.value().entries.size(), 1u);
  EXPECT_EQ(index.value().entries[0].t_ns, 1403636579763555584);
  EXPECT_EQ(index.value().entries[0].file, "1403636579763555584.png");
}

TEST(EurocIndex, RefusesSecondsAndMissingNames) {
  EXPECT_THAT(parse_euroc_index("1.5,a.png\n", "data.csv").error().message,
              HasSubstr("data.csv:1: '1.5' is not a time in whole nanoseconds"));
  EXPECT_THAT(parse_euroc_index("15\n", "data.csv").error().message, HasSubstr("data.csv:1: no file name"));
  EXPECT_FALSE(parse_euroc_index("9223372036854775807,a.png\n", "data.csv").ok()) << "rebasing it would overflow";
}

}  // namespace
}  // namespace godwit::hal::sequence_index_test
