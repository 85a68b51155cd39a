#include "hal/rt/result.h"

#include <gtest/gtest.h>

namespace godwit::rt {
namespace {

TEST(Result, HoldsValueOrError) {
  const Result<int> good(7);
  ASSERT_TRUE(good.ok());
  EXPECT_EQ(good.value(), 7);
  const Result<int> bad(Error{"camera.yaml: fx is missing"});
  ASSERT_FALSE(bad.ok());
  EXPECT_EQ(bad.error().message, "camera.yaml: fx is missing");
}

TEST(Result, VoidIsOkUnlessGivenAnError) {
  EXPECT_TRUE(Result<void>().ok());
  EXPECT_FALSE(Result<void>(Error{"no"}).ok());
}

}  // namespace
}  // namespace godwit::rt
