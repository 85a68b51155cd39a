// Against the examples of RFC 4648, section 10, and what is none.
#include "firmware_app/output/base64.h"

#include <gtest/gtest.h>

namespace godwit::app {
namespace {

std::string coded(std::string_view text) {
  std::string out;
  append_base64(std::span(reinterpret_cast<const std::uint8_t*>(text.data()), text.size()), &out);
  return out;
}

TEST(Base64, TheStandardsExamples) {
  const std::pair<const char*, const char*> examples[] = {
      {"", ""}, {"f", "Zg=="}, {"fo", "Zm8="}, {"foo", "Zm9v"}, {"foob", "Zm9vYg=="}, {"foobar", "Zm9vYmFy"}};
  for (const auto& [plain, code] : examples) {
    EXPECT_EQ(coded(plain), code);
    const auto back = from_base64(code);
    ASSERT_TRUE(back) << code;
    EXPECT_EQ(std::string(back->begin(), back->end()), plain);
  }
}

TEST(Base64, EveryByteComesBack) {
  std::vector<std::uint8_t> bytes;
  for (int i = 0; i < 1000; ++i) {
    bytes.push_back(static_cast<std::uint8_t>(i * 37));
    std::string code = "before ";
    append_base64(bytes, &code);
    const auto back = from_base64(std::string_view(code).substr(7));
    ASSERT_TRUE(back);
    ASSERT_EQ(*back, bytes);
  }
}

TEST(Base64, WhatIsNoneIsRefused) {
  for (const char* text : {"Z", "Zg", "Zg=", "====", "Z===", "Zg==Zg==", "Zm 9", "Zm9-", "Zm9\xFF", "=m9v"}) {
    EXPECT_FALSE(from_base64(text)) << text;
  }
}

}  // namespace
}  // namespace godwit::app
