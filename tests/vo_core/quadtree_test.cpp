#include "vo_core/features/quadtree.h"

#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <random>
#include <set>
#include <vector>

namespace godwit::vo {
namespace quadtree_test {

std::vector<std::int32_t> select(Quadtree& tree, int wanted) {
  std::vector<std::int32_t> ids(static_cast<std::size_t>(wanted), -1);
  ids.resize(static_cast<std::size_t>(tree.select(wanted, ids)));
  return ids;
}

TEST(Quadtree, EmptyTreeAndNothingWantedGiveNothing) {
  Quadtree tree(640, 480, 10);
  EXPECT_TRUE(select(tree, 5).empty());
  ASSERT_TRUE(tree.add_candidate(10, 10, 1, 0));
  EXPECT_TRUE(select(tree, 0).empty());
  EXPECT_EQ(select(tree, 5), std::vector<std::int32_t>{0});
}

TEST(Quadtree, OneWantedIsTheBestOfAll) {
  Quadtree tree(640, 480, 100);
  for (int i = 0; i < 50; ++i)
    ASSERT_TRUE(tree.add_candidate(static_cast<float>(i * 12), 100, static_cast<float>(i * 7 % 50), i));
  const std::vector<std::int32_t> ids = select(tree, 1);
  ASSERT_EQ(ids.size(), 1u);
  EXPECT_EQ(ids[0] * 7 % 50, 49);
}

TEST(Quadtree, GivesExactlyTheWantedNumberWhereThereIsEnough) {
  std::mt19937 random(2);
  std::uniform_real_distribution<float> x(0, 640), y(0, 480), score(0, 100);
  for (const int wanted : {1, 3, 10, 57, 100, 200}) {
    Quadtree tree(640, 480, 2000);
    for (int i = 0; i < 2000; ++i) ASSERT_TRUE(tree.add_candidate(x(random), y(random), score(random), i));
    const std::vector<std::int32_t> ids = select(tree, wanted);
    EXPECT_EQ(ids.size(), static_cast<std::size_t>(wanted));
    EXPECT_EQ(std::set<std::int32_t>(ids.begin(), ids.end()).size(), ids.size()) << "one taken twice";
  }
}

TEST(Quadtree, SpreadsWhereOneCornerHoldsTheStrongest) {
  // 900 strong ones in one sixteenth of the picture, 15 weak ones elsewhere: all of the weak ones are taken.
  std::mt19937 random(4);
  std::uniform_real_distribution<float> x(0, 159), y(0, 119);
  Quadtree tree(640, 480, 1000);
  int id = 0;
  for (; id < 900; ++id) ASSERT_TRUE(tree.add_candidate(x(random), y(random), 1000, id));
  for (int cell = 1; cell < 16; ++cell, ++id) {
    ASSERT_TRUE(tree.add_candidate(80.0f + 160.0f * static_cast<float>(cell % 4),
                                   60.0f + 120.0f * static_cast<float>(cell / 4), 1, id));
  }
  int weak = 0;
  for (const std::int32_t taken : select(tree, 60)) weak += taken >= 900;
  EXPECT_EQ(weak, 15);
}

TEST(Quadtree, OccupiedLeavesAreServed) {
  Quadtree tree(640, 480, 100);
  // One existing feature beside each of three candidates, closer than the smallest leaf, and one free candidate.
  for (int i = 0; i < 3; ++i) {
    const float x = 34.0f + 160.0f * static_cast<float>(i);
    ASSERT_TRUE(tree.add_candidate(x, 34, 10, i));
    ASSERT_TRUE(tree.add_occupied(x + 1, 35));
  }
  ASSERT_TRUE(tree.add_candidate(500, 400, 1, 3));
  EXPECT_EQ(select(tree, 4), std::vector<std::int32_t>{3});
}

TEST(Quadtree, SplitsServedLeavesUntilTheFreePartsCount) {
  // The only existing feature serves the root; the tree must go on to find the ten candidates elsewhere.
  Quadtree tree(640, 480, 100);
  ASSERT_TRUE(tree.add_occupied(20, 20));
  for (int i = 0; i < 10; ++i) ASSERT_TRUE(tree.add_candidate(100.0f + 50.0f * static_cast<float>(i), 300, 5, i));
  EXPECT_EQ(select(tree, 10).size(), 10u);
}

TEST(Quadtree, StopsAtTheSmallestLeaf) {
  Quadtree tree(640, 480, 100);
  for (int i = 0; i < 50; ++i)
    ASSERT_TRUE(tree.add_candidate(100.0f + 0.001f * static_cast<float>(i), 100.0f, static_cast<float>(i), i));
  EXPECT_EQ(select(tree, 50), std::vector<std::int32_t>{49});
}

TEST(Quadtree, RefusesWhatIsOutsideAndWhatIsTooMuch) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  Quadtree tree(640, 480, 2);
  EXPECT_FALSE(tree.add_candidate(-1, 5, 1, 0));
  EXPECT_FALSE(tree.add_candidate(640, 5, 1, 0));
  EXPECT_FALSE(tree.add_occupied(5, 480));
  EXPECT_FALSE(tree.add_occupied(nan, 5));
  EXPECT_FALSE(tree.add_candidate(5, nan, 1, 0));
  EXPECT_TRUE(tree.add_candidate(5, 5, 1, 0));
  EXPECT_TRUE(tree.add_occupied(5, 5));
  EXPECT_FALSE(tree.add_candidate(6, 6, 1, 1));
  tree.clear();
  EXPECT_TRUE(tree.add_candidate(6, 6, 1, 1));
}

}  // namespace quadtree_test
}  // namespace godwit::vo
