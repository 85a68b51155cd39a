// Losing the map on rendered pictures with exact truth: what is found again, where it was looked for, and when a new
// one begins.
#include <cstddef>
#include <gtest/gtest.h>
#include <vector>

#include "tests/vo_core/odometry_flight.h"

namespace godwit::vo {
namespace odometry_loss_test {

using test::Flown;
using test::forward;
using test::kElsewhere;
using test::kMirrored;
using test::kTurned;
using test::kTurnFrames;
using test::run_odometry;
using test::sweep;
using test::turn_pose;

TEST(OdometryLoss, BlackFramesAreNotTrackedAndTheViewIsFoundAgain) {
  std::vector<int> order = forward(40);
  for (int i = 0; i < 6; ++i) order.push_back(-1);
  for (int i = 39; i < 45; ++i) order.push_back(i);
  const Flown run = run_odometry(order);
  ASSERT_TRUE(run.frames[39].tracked);
  for (std::size_t i = 40; i < 46; ++i) {
    EXPECT_FALSE(run.frames[i].tracked) << i;
    EXPECT_EQ(run.frames[i].state, State::kRelocalising);
    EXPECT_GT(run.frames[i].reason_limit, run.frames[i].reason_value);
  }
  EXPECT_TRUE(run.frames.back().tracked);
  EXPECT_EQ(run.frames.back().map_id, run.frames[39].map_id);
}

/// The sweep's truth in the map's frame and unit: the map's unit from the first `known` pictures.
SE3 in_map(const Flown& run, std::size_t known, int picture) {
  const std::vector<SE3> truth = sweep(60);
  double num = 0, den = 0;
  for (std::size_t i = 0; i < known; ++i) {
    if (!run.frames[i].tracked) continue;
    num += (truth[0] * truth[i].inverse()).t.dot(run.frames[i].T_world_cam.t);
    den += run.frames[i].T_world_cam.t.squaredNorm();
  }
  SE3 T_world_cam = truth[0] * truth[static_cast<std::size_t>(picture)].inverse();
  T_world_cam.t *= den / num;
  return T_world_cam;
}

// The sweep goes on in the dark, until hardly anything looks as it did: by likeness the map is not found there. A
// sensor that felt the way knows where to look, if only about.
TEST(OdometryLoss, AViewThatLooksLikeNoneIsFoundWhereTheCameraShouldBe) {
  std::vector<int> order = forward(25);
  for (int i = 0; i < 60; ++i) order.push_back(-1);
  for (int i = 54; i < 60; ++i) order.push_back(i);
  const auto felt = [&](std::size_t i, const Flown& run) {
    PosePrior prior;
    if (i < 25 || order[i] < 0) return prior;
    SE3 T_world_cam = in_map(run, 25, order[i]);
    T_world_cam = SE3(so3_exp(Vec3(0.01, -0.01, 0.01)), Vec3(0.02, -0.02, 0.02)) * T_world_cam;
    prior.known = true;
    prior.map_id = 1;
    prior.T_cam_map = T_world_cam.inverse();
    return prior;
  };
  const Flown by_likeness = run_odometry(order), run = run_odometry(order, {}, 0, felt);
  ASSERT_TRUE(run.frames[24].tracked);
  EXPECT_FALSE(by_likeness.frames[86].tracked) << "else this test shows nothing";
  EXPECT_TRUE(run.frames[86].tracked) << run.frames[85].reason << ", " << run.frames[86].reason;
  EXPECT_EQ(run.frames[86].map_id, run.frames[24].map_id);
  EXPECT_LT((run.frames[86].T_world_cam.t - in_map(run, 25, order[86]).t).norm(), 0.02);
  // Of another map nothing is expected.
  const auto stale = [&](std::size_t i, const Flown& sofar) {
    PosePrior prior = felt(i, sofar);
    prior.map_id = 7;
    return prior;
  };
  EXPECT_FALSE(run_odometry(order, {}, 0, stale).frames[86].tracked);
}

// Another place may look the same; here it is the same, and where the camera cannot have gone.
TEST(OdometryLoss, WhatLooksAlikeWhereTheCameraCannotBeIsNotBelieved) {
  std::vector<int> order = forward(40);
  for (int i = 0; i < 20; ++i) order.push_back(-1);
  for (int i = 10; i < 20; ++i) order.push_back(i);
  const auto tracked_with = [&](double place_sigma) {
    const Flown run = run_odometry(order, {}, 0, [&](std::size_t i, const Flown& sofar) {
      PosePrior prior;
      if (i < 60) return prior;
      prior.known = true;
      prior.map_id = 1;
      prior.T_cam_map = in_map(sofar, 40, 39).inverse();
      prior.place_sigma = place_sigma;
      prior.turn_sigma_rad = 0.02;
      return prior;
    });
    int tracked = 0;
    for (std::size_t i = 60; i < run.frames.size(); ++i) tracked += run.frames[i].tracked;
    return tracked;
  };
  EXPECT_EQ(tracked_with(1e-3), 0) << "for a fact it stayed where it was";
  EXPECT_GT(tracked_with(1.0), 3) << "who knows";
}

TEST(OdometryLoss, ACoveredLensGivesNothingUp) {
  std::vector<int> order = forward(30);
  for (int i = 0; i < TrackerOptions{}.health.give_up_ns / 33'333'333 + 30; ++i) order.push_back(-1);
  for (int i = 29; i < 36; ++i) order.push_back(i);
  const Flown run = run_odometry(order);
  ASSERT_TRUE(run.frames[29].tracked);
  ASSERT_TRUE(run.frames.back().tracked);
  EXPECT_EQ(run.frames.back().map_id, run.frames[29].map_id) << "in the dark nothing was searched";
}

TEST(OdometryLoss, AfterTooLongWithoutAPoseANewMapBegins) {
  std::vector<int> order = forward(30);
  // Another view altogether.
  for (int i = 0; i < TrackerOptions{}.health.give_up_ns / 33'333'333 + 4; ++i) order.push_back(kElsewhere);
  for (int i = 0; i < 30; ++i) order.push_back(kMirrored + i);
  const Flown run = run_odometry(order);
  ASSERT_TRUE(run.frames[29].tracked);
  ASSERT_TRUE(run.frames.back().tracked);
  EXPECT_EQ(run.frames.back().map_id, run.frames[29].map_id + 1);
}

// The map is given up after as long as it was flown in; but nothing has taken its place.
TEST(OdometryLoss, AMapThatWasGivenUpGoesOnIfItIsFoundBeforeAnotherBegins) {
  std::vector<int> order = forward(25);
  order.insert(order.end(), 40, kElsewhere);
  for (int i = 20; i < 30; ++i) order.push_back(i);
  const Flown run = run_odometry(order);
  ASSERT_TRUE(run.frames[24].tracked);
  ASSERT_EQ(run.frames[64].state, State::kLost);
  EXPECT_EQ(run.frames[64].map_id, 0U);
  EXPECT_TRUE(run.frames.back().tracked) << run.frames.back().reason;
  EXPECT_EQ(run.frames.back().map_id, run.frames[24].map_id);
  EXPECT_EQ(run.allocations, 0U);
}

// What another map begins with is gathered while the old one is searched for, not after that.
TEST(OdometryLoss, AnotherMapBeginsAsSoonAsTheOldOneIsGivenUp) {
  std::vector<int> order = forward(25);
  for (int i = 0; i < 30; ++i) order.push_back(kMirrored + i);
  const Flown run = run_odometry(order);
  ASSERT_TRUE(run.frames[24].tracked);
  std::size_t given_up = 25, begun = 25;
  while (given_up < order.size() && run.frames[given_up].state == State::kRelocalising) ++given_up;
  while (begun < order.size() && !run.frames[begun].tracked) ++begun;
  ASSERT_LT(given_up, order.size());
  ASSERT_EQ(run.frames[given_up].state, State::kLost);
  ASSERT_LT(begun, order.size());
  EXPECT_LE(begun, given_up + 2) << "in every second frame it is tried";
  EXPECT_EQ(run.frames[begun].map_id, run.frames[24].map_id + 1);
  for (std::size_t i = begun; i < order.size(); ++i) EXPECT_TRUE(run.frames[i].tracked) << i;
  EXPECT_EQ(run.allocations, 0U);
}

TEST(OdometryLoss, AViewFarFromTheLastOneIsFoundByItsKeyframe) {
  std::vector<int> order = forward(60);
  for (int i = 0; i < 20; ++i) order.push_back(-1);
  for (int i = 10; i < 20; ++i) order.push_back(i);  // back at the beginning
  const Flown run = run_odometry(order);
  ASSERT_TRUE(run.frames[59].tracked);
  std::size_t back = 80;
  while (back < run.frames.size() && !run.frames[back].tracked) ++back;
  ASSERT_LT(back, 88u) << "not found within eight frames";
  EXPECT_EQ(run.frames[back].map_id, run.frames[59].map_id);
  // The same picture was flown before: the pose must be that one again.
  const auto before = static_cast<std::size_t>(order[back]);
  EXPECT_LT((run.frames[back].T_world_cam.t - run.frames[before].T_world_cam.t).norm(), 0.03);
}

TEST(OdometryLoss, ACameraTurnedAwayAndBackIsRightWhereItSaysTracked) {
  std::vector<int> order = forward(41);
  for (int i = 0; i < kTurnFrames; ++i) order.push_back(kTurned + i);
  for (int i = 40; i < 52; ++i) order.push_back(i);
  const Flown run = run_odometry(order);
  ASSERT_TRUE(run.frames[40].tracked);
  const std::vector<SE3> truth = sweep(60);
  // Unit of the map: from the way before the turn.
  double num = 0, den = 0;
  for (std::size_t i = 0; i < 41; ++i) {
    if (!run.frames[i].tracked) continue;
    num += (truth[0] * truth[i].inverse()).t.dot(run.frames[i].T_world_cam.t);
    den += run.frames[i].T_world_cam.t.squaredNorm();
  }
  const double scale = num / den;
  int after = 0;
  for (std::size_t i = 41; i < run.frames.size(); ++i) {
    const bool turn = order[i] >= kTurned;
    if (!run.frames[i].tracked) continue;
    after += !turn;
    const SE3 T = order[i] >= kTurned ? turn_pose(order[i] - kTurned) : truth[static_cast<std::size_t>(order[i])];
    const Mat3 dR = run.frames[i].T_world_cam.R.transpose() * truth[0].R * T.R.transpose();
    EXPECT_LT(so3_log(dR).norm(), 0.05) << i;
    EXPECT_LT((scale * run.frames[i].T_world_cam.t - (truth[0] * T.inverse()).t).norm(), 0.05) << i;
  }
  // It turns by 7 degrees a frame to where there was nothing of the map: lost or not, what is told is right.
  EXPECT_GE(after, 5) << "or nothing above has been judged";
  EXPECT_TRUE(run.frames.back().tracked);
  EXPECT_EQ(run.frames.back().map_id, run.frames[40].map_id);
}

}  // namespace odometry_loss_test
}  // namespace godwit::vo
