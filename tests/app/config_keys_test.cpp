#include "firmware_app/config/config_keys.h"

#include <gtest/gtest.h>

namespace godwit::app::config_keys_test {
namespace {

/// What the key makes of `value`, written as TOML.
bool apply(const Key& key, const std::string& value) {
  const toml::table table = toml::parse("x = " + value + "\n");
  return key.apply(*table.get("x"));
}

TEST(ConfigKeys, WholeNumbers) {
  int to = 7;
  const Key key = keys::whole("a.b", -2, 9, &to);
  EXPECT_EQ(key.allowed, "a whole number from -2 to 9");
  for (const char* wrong : {"-3", "10", "1.0", "true", "\"1\"", "[1]"}) EXPECT_FALSE(apply(key, wrong)) << wrong;
  EXPECT_EQ(to, 7) << "what is not allowed changes nothing";
  EXPECT_TRUE(apply(key, "-2"));
  EXPECT_EQ(to, -2);
  EXPECT_EQ(key.show(), "-2");
  std::uint64_t seed = 0;
  EXPECT_FALSE(apply(keys::whole<std::uint64_t>("a.c", 0, 1U << 31U, &seed), "-1"));
  EXPECT_TRUE(apply(keys::whole<std::uint64_t>("a.c", 0, 1U << 31U, &seed), "2147483648"));
  EXPECT_EQ(seed, 2147483648U);
}

TEST(ConfigKeys, Numbers) {
  double to = 1;
  const Key key = keys::number("a.b", 0.5, 90, "degrees C", &to);
  EXPECT_EQ(key.allowed, "a number from 0.5 to 90 [degrees C]");
  for (const char* wrong : {"0.4", "90.1", "nan", "inf", "\"1\"", "true"}) EXPECT_FALSE(apply(key, wrong)) << wrong;
  EXPECT_TRUE(apply(key, "90"));
  EXPECT_TRUE(apply(key, "33.3"));
  EXPECT_EQ(to, 33.3);
  EXPECT_EQ(key.show(), "33.3");
}

TEST(ConfigKeys, FlagsTextsAndChoices) {
  bool flag = false;
  EXPECT_FALSE(apply(keys::flag("a.b", &flag), "1"));
  EXPECT_TRUE(apply(keys::flag("a.b", &flag), "true"));
  EXPECT_TRUE(flag);

  std::string text = "old";
  const Key name = keys::text("a.c", 5, "a folder", &text);
  EXPECT_EQ(name.allowed, "a folder in quotes, at most 5 bytes, without control characters");
  for (const char* wrong : {"\"123456\"", "\"a\\nb\"", "5"}) EXPECT_FALSE(apply(name, wrong)) << wrong;
  EXPECT_TRUE(apply(name, "\"a\\\"b\""));
  EXPECT_EQ(text, "a\"b");
  EXPECT_EQ(name.show(), "\"a\\\"b\"");

  enum class Colour { kRed, kGreen, kBlue } colour = Colour::kRed;
  const Key choice =
      keys::choice<Colour>("a.d", {{"red", Colour::kRed}, {"green", Colour::kGreen}, {"blue", Colour::kBlue}}, &colour);
  EXPECT_EQ(choice.allowed, "\"red\", \"green\" or \"blue\"");
  EXPECT_FALSE(apply(choice, "\"yellow\""));
  EXPECT_FALSE(apply(choice, "1"));
  EXPECT_TRUE(apply(choice, "\"blue\""));
  EXPECT_EQ(colour, Colour::kBlue);
  EXPECT_EQ(choice.show(), "\"blue\"");
}

TEST(ConfigKeys, Lists) {
  std::vector<int> to = {1};
  const Key key = keys::whole_list("a.b", 0, 63, 3, &to);
  EXPECT_EQ(key.allowed, "a list [..] of at most 3 different whole numbers from 0 to 63");
  for (const char* wrong : {"1", "[64]", "[1, 1]", "[0, 1, 2, 3]", "[1.0]"}) EXPECT_FALSE(apply(key, wrong)) << wrong;
  EXPECT_EQ(to, std::vector<int>{1});
  EXPECT_TRUE(apply(key, "[4, 2]"));
  EXPECT_EQ(to, (std::vector<int>{4, 2}));
  EXPECT_EQ(key.show(), "[4, 2]");
  EXPECT_TRUE(apply(key, "[]"));
  EXPECT_TRUE(to.empty());
}

}  // namespace
}  // namespace godwit::app::config_keys_test
