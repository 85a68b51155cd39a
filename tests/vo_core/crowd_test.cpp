// Tracker and mapper between movers who hide most of the picture, on rendered pictures with exact truth. Each mechanism
// is proved by the same flight without it, which must go otherwise.
#include <algorithm>
#include <array>
#include <cmath>
#include <gtest/gtest.h>
#include <memory>
#include <vector>

#include "tests/vo_core/crowd_flight.h"
#include "vo_core/map/mapper.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::vo {
namespace crowd_test {

TEST(Crowd, FewButSureFeaturesCarryOnWithoutBeingTold) {
  const auto order = shots({{0, kFree - 1, 0.0}, {kFree, kFree + 9, 0.6}, {kFree + 10, kFree + 11, 0.0}});
  TrackerOptions options;
  options.health.min_measurements = few();
  const Flight flight = fly(order, options);
  const FrameResult& before = flight.frames[kFree - 1];
  ASSERT_TRUE(before.tracked);
  const double scale = scale_of(flight, order, kFree);
  for (std::size_t i = kFree; i < kFree + 10; ++i) {
    const FrameResult& r = flight.frames[i];
    EXPECT_FALSE(r.tracked) << i;
    EXPECT_EQ(r.state, State::kRelocalising) << i;
    // The movers come from nowhere: in the first picture with them the pose may have to be sought.
    EXPECT_TRUE(weak(r) || i == kFree) << i << ": " << r.reason;
    EXPECT_LT(r.measurements, few()) << i;
    EXPECT_EQ(r.map_id, before.map_id) << i;
    EXPECT_GE(flight.points[i], flight.points[kFree - 1] / 2) << i;
  }
  EXPECT_GE(flight.keyframes[kFree + 9], flight.keyframes[kFree - 1]);
  // The chain has held: the first free picture counts at once, and in the right place.
  EXPECT_TRUE(flight.frames[kFree + 10].tracked) << flight.frames[kFree + 10].reason;
  EXPECT_EQ(flight.frames[kFree + 10].map_id, before.map_id);
  EXPECT_LT(off_by(flight, order, kFree + 10, scale), 0.05);

  // Without it nothing is gone on from between the movers: each pose there is sought anew.
  options.least_measurements = options.least_beside_prior = few();
  const Flight without = fly(order, options);
  for (std::size_t i = kFree; i < kFree + 10; ++i) EXPECT_FALSE(weak(without.frames[i])) << i;
}

TEST(Crowd, WeakPosesGoOnForAsLongAsEachSpeaksForItself) {
  // There and back between movers, then hidden nearly altogether, and free pictures again.
  const auto order = shots({{0, kFree - 1, 0.0},
                            {kFree, kFree + 9, 0.6},
                            {kFree, kFree + 5, 0.6},
                            {kFree + 6, kFree + 7, 0.97},
                            {kFree + 8, kFree + 9, 0.0}});
  constexpr std::size_t kCrowd = kFree, kHidden = kFree + 16, kOpen = kFree + 18;
  TrackerOptions options;
  options.health.min_measurements = few();
  const Flight flight = fly(order, options);
  ASSERT_TRUE(flight.frames[kCrowd - 1].tracked);
  const double scale = scale_of(flight, order, kCrowd);
  for (std::size_t i = kCrowd + 1; i < kHidden; ++i) {
    EXPECT_TRUE(weak(flight.frames[i])) << i << ": " << flight.frames[i].reason;
    EXPECT_FALSE(flight.frames[i].tracked) << i;
    EXPECT_EQ(flight.frames[i].state, State::kRelocalising) << i;
    EXPECT_EQ(flight.frames[i].map_id, flight.frames[kCrowd - 1].map_id) << i;
  }
  for (std::size_t i = kHidden; i < kOpen; ++i) EXPECT_FALSE(weak(flight.frames[i])) << i << ": nothing speaks for it";
  const FrameResult& back = flight.frames[order.size() - 1];
  EXPECT_TRUE(back.tracked) << back.reason;
  EXPECT_EQ(back.map_id, flight.frames[kCrowd - 1].map_id);
  EXPECT_LT(off_by(flight, order, order.size() - 1, scale), 0.05);
}

TEST(Crowd, ALostPoseIsFoundBetweenMoversInTheSameMap) {
  // No picture comes for longer than a last frame is good for; then the camera is back on its way, rolled, and movers
  // hide most of what it sees.
  constexpr std::size_t kLost = 12;
  std::vector<Shot> order;
  order.reserve(kLost);
  for (int i = 0; i < static_cast<int>(kLost); ++i) order.push_back({3 * i});
  for (int i = 0; i < 8; ++i) order.push_back({21 + i / 3, 0.6, -0.25, i == 0 ? 35 : 0});
  const CameraModel camera = camera_of(640);
  const Flight flight = fly(order, {}, camera);
  ASSERT_TRUE(flight.frames[kLost - 1].tracked);
  const double scale = scale_of(flight, order, kLost);
  int tracked = 0;
  for (std::size_t i = kLost; i < order.size(); ++i) {
    EXPECT_EQ(flight.frames[i].map_id, flight.frames[kLost - 1].map_id) << i;
    if (!flight.frames[i].tracked) continue;
    ++tracked;
    EXPECT_LT(off_by(flight, order, i, scale), 0.05) << i;
  }
  EXPECT_GE(tracked, 1);

  // By what the points look like: a tracker that never believes in that finds it later, if at all.
  TrackerOptions options;
  options.landmarks.min_agreeing = options.landmarks.min_agreeing_near = kMaxFrameFeatures + 1;
  const Flight without = fly(order, options, camera);
  const auto first_tracked = [](const Flight& f) {
    const auto begin = f.frames.begin() + kLost;
    return std::find_if(begin, f.frames.end(), [](const FrameResult& r) { return r.tracked; }) - begin;
  };
  EXPECT_LT(first_tracked(flight) + 3, first_tracked(without));
}

TEST(Crowd, APoseThatItsOwnPictureSpeaksAgainstIsSoughtAnewOrNotTold) {
  // Three parts of two pictures go three ways, one of them the camera's.
  auto order = shots({{0, kFree + 3, 0.0}});
  for (std::size_t i = kFree + 1; i < kFree + 3; ++i) order[i].torn = 6;
  TrackerOptions options;
  options.crowded = -1.0;                                                // whatever hides, or does not
  options.motion.acceleration = options.motion.turn_acceleration = 1e6;  // nor is the motion a witness
  const Flight flight = fly(order, options);
  ASSERT_TRUE(flight.frames[kFree].tracked);
  const double scale = scale_of(flight, order, kFree);
  // The alignment lays it between them; from where the motion goes on as it was the right part is found.
  const FrameResult &first = flight.frames[kFree + 1], &second = flight.frames[kFree + 2];
  EXPECT_TRUE(first.tracked) << first.reason;
  EXPECT_LT(off_by(flight, order, kFree + 1, scale), 0.01);
  // Of the second neither convinces. Pictures before say where it should be: that is gone on from, and not told.
  EXPECT_FALSE(second.tracked) << second.measurements << " of " << second.matches;
  EXPECT_STREQ(second.reason, "too little speaks for the pose [nats]");
  EXPECT_GE(second.measurements, HealthOptions{}.min_measurements) << "it is not for their number";
  EXPECT_EQ(second.state, State::kRelocalising);
  EXPECT_TRUE(flight.frames[kFree + 3].tracked) << flight.frames[kFree + 3].reason;
  EXPECT_LT(off_by(flight, order, kFree + 3, scale), 0.05);
  // Where no movers are known it is blur or light that speaks against all points alike.
  const Flight open = fly(order);
  EXPECT_TRUE(open.frames[kFree + 2].tracked) << open.frames[kFree + 2].reason;
}

TEST(Crowd, WhereTheMotionGoesOnAPoseIsToldThoughItsPictureSaysLittle) {
  auto order = shots({{0, kFree + 2, 0.0}});
  order[kFree + 1].blur = 12;
  TrackerOptions options;
  options.crowded = -1.0;  // whatever hides, or does not
  options.told = 45.0;     // what a blurred picture does not have
  const Flight flight = fly(order, options);
  EXPECT_TRUE(flight.frames[kFree + 1].tracked) << flight.frames[kFree + 1].reason;
  EXPECT_LT(off_by(flight, order, kFree + 1, scale_of(flight, order, kFree)), 0.02);
  // Without that witness it is gone on from and not told.
  options.motion.acceleration = options.motion.turn_acceleration = 1e6;
  const Flight alone = fly(order, options);
  EXPECT_FALSE(alone.frames[kFree + 1].tracked);
  EXPECT_STREQ(alone.frames[kFree + 1].reason, "too little speaks for the pose [nats]");
  EXPECT_TRUE(alone.frames[kFree + 2].tracked) << alone.frames[kFree + 2].reason;
}

TEST(Crowd, BetweenMoversTheMotionTellsAtMostHalfOfWhatIsWanted) {
  // A camera that sweeps as evenly as it did, and hardly a point: its motion says more than they do.
  auto order = shots({{0, kFree, 0.0}, {kFree + 1, kFree + 1, 0.5}});
  order.back().blur = 12;
  TrackerOptions options;
  options.health.min_measurements = options.least_beside_prior;
  options.motion.acceleration = 0.05;
  options.motion.turn_acceleration = 0.15;
  const auto told = [&](double wanted) {
    options.told = wanted;
    return fly(order, options).frames.back();
  };
  // Both together, from where half of what is wanted is more than the motion has.
  const FrameResult all = told(1e4);
  ASSERT_FALSE(all.tracked);
  ASSERT_STREQ(all.reason, "too little speaks for the pose [nats]");
  ASSERT_GT(all.reason_value, TrackerOptions{}.told);
  const double wanted = all.reason_value - 1;
  const FrameResult half = told(wanted);
  ASSERT_FALSE(half.tracked) << "they have as much together";
  EXPECT_LT(half.reason_value, wanted - 5);
  const double by_points = half.reason_value - 0.5 * wanted;
  EXPECT_GT(by_points, 2);
  EXPECT_LT(by_points, all.reason_value - by_points) << "else this proves nothing";
  EXPECT_TRUE(told(2 * by_points - 2).tracked) << "where they have the other half it is told";
}

TEST(Crowd, BetweenMoversOnlyPointsThatWereRightBeforeProveAPose) {
  const auto order = shots({{0, kFree + 9, 0.0}});
  TrackerOptions options;
  options.crowded = -1.0;  // whatever hides, or does not
  const Flight flight = fly(order, options);
  std::size_t first = 0;
  while (first < order.size() && flight.points[first] == 0) ++first;
  ASSERT_LT(first, static_cast<std::size_t>(kFree));
  EXPECT_EQ(flight.vouched[first], flight.points[first]) << "nothing speaks against the first map's";
  for (std::size_t i = first; i < order.size(); ++i) EXPECT_TRUE(flight.frames[i].tracked) << flight.frames[i].reason;
  // What came later is vouched as soon as poses agreed with it that the others speak for.
  EXPECT_GT(flight.points.back(), flight.points[first] + 50);
  EXPECT_GT(flight.vouched.back(), flight.points[first] + 30);

  // As if those had not sufficed for a pose: what comes later proves none, and stays as it is.
  options.told = 1e6;
  const Flight without = fly(order, options);
  std::size_t i = first + 1;
  for (; i < order.size() && without.frames[i].state != State::kLost; ++i) {
    EXPECT_FALSE(without.frames[i].tracked) << i;
    EXPECT_STREQ(without.frames[i].reason, "too little speaks for the pose [nats]") << i;
    EXPECT_GE(without.frames[i].measurements, options.health.min_measurements) << i << ": it is not for their number";
    EXPECT_LE(without.vouched[i], flight.points[first]) << i;
  }
  EXPECT_GE(i, first + 10);
  EXPECT_GT(without.points[i - 1], without.vouched[i - 1] + 50) << "it is gone on from, and the map grows";
  // Where no movers are known any point will do.
  options.crowded = 1.0;
  EXPECT_TRUE(fly(order, options).frames.back().tracked);
}

TEST(Crowd, ACameraThatIsPushedIsFollowed) {
  // A step of six pictures' way within one, to a tracker that takes its camera for very heavy: the picture says better.
  auto order = shots({{0, kFree - 1, 0.0}, {kFree + 6, kFree + 15, 0.0}});
  TrackerOptions heavy;
  heavy.motion.acceleration = heavy.motion.turn_acceleration = 1e-4;
  const Flight flight = fly(order, heavy, camera_of(640));
  const double scale = scale_of(flight, order, kFree);
  for (std::size_t i = kFree; i < order.size(); ++i) {
    EXPECT_TRUE(flight.frames[i].tracked) << i << ": " << flight.frames[i].reason;
    EXPECT_LT(off_by(flight, order, i, scale), 0.02) << i;
  }
}

TEST(Crowd, FewFeaturesAreGoneOnFromWhateverHidesTheRest) {
  const auto order = shots({{0, kFree - 1, 0.0}, {kFree, kFree + 7, 0.35}});
  TrackerOptions options;
  options.health.min_measurements = few();
  options.crowded = 1.0;  // whether that is called a crowd makes no difference
  const Flight flight = fly(order, options);
  ASSERT_TRUE(flight.frames[kFree - 1].tracked);
  int gone_on = 0;
  for (std::size_t i = kFree; i < order.size(); ++i) {
    EXPECT_TRUE(weak(flight.frames[i]) || flight.frames[i].tracked || i == kFree) << i << flight.frames[i].reason;
    EXPECT_EQ(flight.frames[i].map_id, flight.frames[kFree - 1].map_id) << i;
    gone_on += weak(flight.frames[i]);
  }
  EXPECT_GT(gone_on, 0);
  // Where such a pose is none, each frame of few features is sought anew.
  options.least_measurements = options.least_beside_prior = few();
  const Flight without = fly(order, options);
  for (std::size_t i = kFree; i < order.size(); ++i) EXPECT_FALSE(weak(without.frames[i])) << i;
}

TEST(Crowd, FoundWithoutDoubtItCountsAtOnce) {
  // No picture comes for longer than a last frame is good for; then the camera is back on its way.
  constexpr std::size_t kLost = 12;
  std::vector<Shot> order;
  for (int i = 0; i < static_cast<int>(kLost); ++i) order.push_back({3 * i});
  order.push_back({21, 0.0, 0.0, 35});
  order.push_back({22});
  const Flight flight = fly(order);
  ASSERT_TRUE(flight.frames[kLost - 1].tracked);
  const double scale = scale_of(flight, order, kLost);
  for (std::size_t i = kLost; i < order.size(); ++i) {
    EXPECT_TRUE(flight.frames[i].tracked) << i << ": " << flight.frames[i].reason;
    EXPECT_EQ(flight.frames[i].map_id, flight.frames[kLost - 1].map_id) << i;
    EXPECT_LT(off_by(flight, order, i, scale), 0.05) << i;
    // How fast it moves nobody knows in the first of them.
    EXPECT_FALSE(i == kLost && flight.frames[i].is_keyframe);
  }
  // With more to be proved than one picture can, another must confirm it.
  TrackerOptions options;
  options.most_evidence = 1e6;
  const Flight without = fly(order, options);
  EXPECT_FALSE(without.frames[kLost].tracked);
  EXPECT_TRUE(without.frames[kLost + 1].tracked) << without.frames[kLost + 1].reason;
}

TEST(Crowd, WhatMotionBlurTakesIsFoundOnACoarserLevel) {
  auto order = shots({{0, kFree - 1, 0.0}, {kFree, kFree + 9, 0.4}});
  for (std::size_t i = kFree + 2; i < order.size(); ++i) order[i].blur = 9;
  TrackerOptions options;
  const Flight flight = fly(order, options);
  ASSERT_TRUE(flight.frames[kFree + 1].tracked);
  const double scale = scale_of(flight, order, kFree);
  // The same without: it finds less where it is blurred, and where it is not, as much.
  options.reprojector.coarser_levels = 0;
  const Flight without = fly(order, options);
  EXPECT_EQ(flight.frames[kFree - 1].measurements, without.frames[kFree - 1].measurements);
  int found = 0, found_without = 0;
  for (std::size_t i = kFree + 2; i < order.size(); ++i) {
    found += flight.frames[i].measurements;
    found_without += without.frames[i].measurements;
    EXPECT_TRUE(flight.frames[i].tracked) << i;
    EXPECT_LT(off_by(flight, order, i, scale), 0.05) << i;
  }
  EXPECT_GT(found, found_without * 14 / 10);
}

struct Made {
  std::vector<int> points;  ///< in the map after each frame
  int wrong = 0;            ///< of the last of them, off by a fifth of their depth
};
/// A mapper by itself, told the truth: two keyframes of known points, then frames on the way.
Made points_made(double hidden, int agreeing_matches) {
  const CameraModel& camera = small_camera();
  MapperOptions options;
  options.agreeing_matches = agreeing_matches;
  options.hungry_shift_px = 0.0;  // or small motion alone would be enough
  const auto channel = std::make_unique<MapChannel>();
  Mapper mapper(camera, options, channel.get());
  constexpr int kStep = 2, kPoints = 40;
  std::array<Vec3, kPoints> points;
  std::vector<std::unique_ptr<Seen>> memory;
  Made made;
  for (int i = -1; i < 12; ++i) {
    MapperMessage* m = channel->messages.claim();
    if (m == nullptr) ADD_FAILURE() << "the mapper does not give messages back";
    if (m == nullptr) break;
    m->epoch = 1;
    m->kind = i < 0 ? MessageKind::kReset : i < 2 ? MessageKind::kKeyframe : MessageKind::kFrame;
    if (i >= 0) {
      const Shot shot{kStep * i, hidden};
      memory.push_back(std::make_unique<Seen>(camera, shot, i));
      const FrameInput& in = memory.back()->input;
      m->sequence = in.sequence;
      m->slot = in.slot;
      m->pyramid = build_pyramid(in.grey, rt::kPyramidLevels, in.pyramid_storage, in.pyramid_bytes);
      m->t_capture_ns = in.t_capture_ns;
      m->anchor_id = 0;
      m->T_cam_anchor = pose_of(shot);
      m->tracked_features = 110;  // not few: it is the crowd that makes hungry
      m->median_depth = 3.5;
      m->min_depth = 1.0;
      m->mask.assign(in.mask);
      m->keyframe_id = static_cast<std::uint32_t>(i + 1);
      m->keyframe_place = i;
      m->initial = true;
      m->feature_count = m->weak_count = 0;
      for (int k = 0; i < 2 && k < kPoints; ++k) {
        Vec3& p = points[static_cast<std::size_t>(k)];
        if (i == 0) {
          const Vec2 px(20 + 40 * (k % 8), 25 + 45 * (k / 8));
          const Vec3 bearing = camera.unproject(px);
          p = pose_of(shot).inverse() * (bearing / bearing.z() * scene().depth(camera, pose_of(shot), px));
        }
        Vec2 px;
        if (!camera.project(pose_of(shot) * p, &px)) continue;
        FrameFeature& f = m->features[static_cast<std::size_t>(m->feature_count)];
        f = {};
        f.px = f.px_global = px.cast<float>();
        f.point = {static_cast<std::uint16_t>(k), 0};
        m->initial_points[static_cast<std::size_t>(m->feature_count++)] = p.cast<float>();
      }
    }
    channel->messages.commit();
    while (mapper.step()) {
    }
    while (channel->deltas.front() != nullptr) channel->deltas.pop();
    SlotRelease release;
    while (mapper.take_release(&release)) {
    }
    if (i >= 2) made.points.push_back(mapper.map().point_count());
  }
  for (int k = 0; k < 2; ++k) {
    const Keyframe& kf = mapper.map().keyframe(k);
    for (int i = 0; i < kf.feature_count; ++i) {
      const MapPoint* p = mapper.map().find(kf.features[static_cast<std::size_t>(i)].point);
      if (p == nullptr) continue;
      const double depth = (kf.T_kf_world * p->p_world).z();
      const Vec2 px = kf.features[static_cast<std::size_t>(i)].px.cast<double>();
      made.wrong += std::abs(depth - scene().depth(camera, kf.T_kf_world, px)) > 0.2 * depth;
    }
  }
  return made;
}

TEST(Crowd, MatchesThatAgreeMakeAPointSooner) {
  const Made with = points_made(0.6, MapperOptions{}.agreeing_matches), without = points_made(0.6, 1 << 20);
  ASSERT_EQ(with.points.size(), without.points.size());
  int sooner = 0;
  for (std::size_t i = 0; i < with.points.size(); ++i) {
    EXPECT_GE(with.points[i], without.points[i]) << i;
    sooner = std::max(sooner, with.points[i] - without.points[i]);
  }
  EXPECT_GE(sooner, 20) << "in a map of " << with.points.back();
  // And they are as good.
  EXPECT_LE(with.wrong, without.wrong + with.points.back() / 20);
  // Where there is no crowd nothing depends on it.
  EXPECT_EQ(points_made(0.3, MapperOptions{}.agreeing_matches).points, points_made(0.3, 1 << 20).points);
}

}  // namespace crowd_test
}  // namespace godwit::vo
