// Which boxes stand still in the scene, by synthetic things seen from a camera that flies past.
#include "firmware_app/dynamic/parked_boxes.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <gtest/gtest.h>
#include <random>

#include "hal/rt/alloc_hook.h"
#include "hal/rt/rt_scope.h"

namespace godwit::app {
namespace parked_boxes_test {

using vo::Vec3;
constexpr int kWidth = 640, kHeight = 480;
constexpr int kPerson = 0, kCar = 1;
constexpr double kFocal = 450, kPerSecond = 30, kDistance = 20;
constexpr int kDetectionEvery = 4, kLate = 3;

vo::CameraModel camera() {
  return vo::CameraModel::pinhole_radtan(kWidth, kHeight, kFocal, kFocal, 319.5, 239.5, {}).value();
}

/// World: x right, y down, z into the scene; a wall at z = kDistance full of map points.
struct Scene {
  std::function<Vec3(double)> camera_at = [](double) { return Vec3::Zero(); };
  std::function<Vec3(double)> thing_at = [](double) { return Vec3(0, 0, kDistance); };
  std::function<double(double)> roll_at = [](double) { return 0.0; };
  std::function<bool(double)> has_pose = [](double) { return true; };
  std::function<bool(double)> detected = [](double) { return true; };
  std::function<int(double)> missed = [](double) { return 0; };  ///< detections in a row that it is held over
  std::function<std::uint32_t(double)> map_id = [](double) { return 1U; };
  double half_wide = 2.0, half_high = 1.2, jitter = 0.0;
  int class_id = kCar;
  bool points = true;
};

/// Flies a scene as DynamicMasks does: boxes of each frame, detections that come late, poses after the frame.
class Flight {
 public:
  explicit Flight(Scene scene) : scene_(std::move(scene)) {}

  /// To the time [s]; returns whether the thing is parked then.
  bool fly_to(double until_s) {
    for (; frame_ <= until_s * kPerSecond; ++frame_) step();
    return parked();
  }
  /// Time at which it is parked first, or -1.
  double first_parked(double until_s) {
    for (; frame_ <= until_s * kPerSecond; ++frame_) {
      step();
      if (parked()) return frame_ / kPerSecond;
    }
    return -1;
  }
  bool parked() const { return boxes_.parked(carried_.track); }
  double released_s() const { return released_s_; }

 private:
  static rt::TimeNs time_of(int frame) { return 1'000'000'000 + std::llround(frame / kPerSecond * 1e9); }
  vo::SE3 pose(double t) const {
    const vo::Mat3 R = vo::so3_exp(Vec3(0, 0, scene_.roll_at(t)));
    return {R, -(R * scene_.camera_at(t))};
  }

  /// The box of the thing at a time, as a detector gives it: clipped to the picture.
  bool box_at(double t, double jitter, detector::Box* box) {
    vo::Vec2 px;
    const Vec3 p = pose(t) * scene_.thing_at(t);
    if (!model_.project(p, &px)) return false;
    const double w = kFocal * scene_.half_wide / p.z(), h = kFocal * scene_.half_high / p.z();
    const auto edge = [&](double v, double side, int limit) {
      return static_cast<float>(std::clamp(v + jitter * 2 * side * noise_(random_), 0.0, static_cast<double>(limit)));
    };
    box->x0 = edge(px.x() + 0.5 - w, w, kWidth);
    box->x1 = edge(px.x() + 0.5 + w, w, kWidth);
    box->y0 = edge(px.y() + 0.5 - h, h, kHeight);
    box->y1 = edge(px.y() + 0.5 + h, h, kHeight);
    box->class_id = scene_.class_id;
    return box->x1 - box->x0 > 1 && box->y1 - box->y0 > 1;
  }

  void step() {
    const double t = frame_ / kPerSecond;
    const bool was = parked();
    std::array<SeenPoint, 200> seen;
    std::size_t n = 0;
    for (int i = 0; i < 20 && scene_.points; ++i) {
      for (int j = 0; j < 10; ++j) {
        const float x = 16.F + 32.F * static_cast<float>(i), y = 24.F + 48.F * static_cast<float>(j);
        const Vec3 ray = pose(t).R.transpose() * model_.unproject({x, y});
        seen[n++] = {x, y, static_cast<float>((kDistance - scene_.camera_at(t).z()) / ray.z())};
      }
    }
    const rt::RtScope scope;
    // Carried: where it is, with the name that the last detection gave it.
    detector::Box now;
    now.track = carried_.track;
    boxes_.note_boxes(time_of(frame_), {&now, box_at(t, 0, &now) && carried_.track >= 0 ? 1U : 0U});
    if (frame_ >= kLate && (frame_ - kLate) % kDetectionEvery == 0) {
      const double then = (frame_ - kLate) / kPerSecond;
      detector::Box found;
      const bool any = scene_.detected(then) && box_at(then, scene_.jitter, &found);
      found.track = 77;  // must be overwritten
      found.missed = scene_.missed(then);
      boxes_.take_detection(time_of(frame_ - kLate), {&found, any ? 1U : 0U});
      if (any) carried_ = found;
    }
    if (scene_.has_pose(t)) boxes_.note_tracked({time_of(frame_), scene_.map_id(t), pose(t), {seen.data(), n}});
    if (was && !parked()) released_s_ = t;
  }

  Scene scene_;
  const vo::CameraModel model_ = camera();
  ParkedBoxes boxes_{model_, {false, true}};
  detector::Box carried_;
  int frame_ = 0;
  double released_s_ = -1;
  std::mt19937 random_{7};
  std::normal_distribution<double> noise_;
};

Vec3 passing(double t) {
  return {2.0 * t - 5.0, 0.3 * t, 0.0};
}

TEST(ParkedBoxes, ParkedCarIsKnownAfterTwoSecondsFromAPassingCamera) {
  Scene scene;
  scene.camera_at = passing;
  const double t = Flight(scene).first_parked(5);
  EXPECT_GE(t, 2.0);
  EXPECT_LE(t, 2.0 + (2 * kDetectionEvery + kLate) / kPerSecond);
  Flight flight(scene);
  EXPECT_TRUE(flight.fly_to(5));
  EXPECT_EQ(flight.released_s(), -1) << "what stands stays parked";
}

TEST(ParkedBoxes, ParkedCarIsKnownFromARollingHoverAndFromAnApproach) {
  Scene hover;
  hover.camera_at = [](double t) { return Vec3(0.02 * std::sin(3 * t), 0.02 * std::cos(2 * t), 0); };
  hover.roll_at = [](double t) { return 0.3 * std::sin(t); };
  hover.thing_at = [](double) { return Vec3(2, 1, kDistance); };
  EXPECT_TRUE(Flight(hover).fly_to(3));
  Scene approach;
  approach.camera_at = [](double t) { return Vec3(0, 0, 2 * t); };
  EXPECT_TRUE(Flight(approach).fly_to(3)) << "it grows as its distance says";
}

TEST(ParkedBoxes, WhatDrivesIsNeverParked) {
  struct Drive {
    const char* name;
    Vec3 camera_m_s, thing_m_s;
  };
  for (const Drive& d : {Drive{"across a hover", {0, 0, 0}, {0.7, 0, 0}},
                         {"across a hover, up", {0, 0, 0}, {0, 0.7, 0}},
                         {"away from a hover", {0, 0, 0}, {0, 0, 2}},
                         {"towards a hover", {0, 0, 0}, {0, 0, -2}},
                         {"across a flight", {2, 0, 0}, {0, 1, 0}},
                         {"with the aircraft", {2, 0, 0}, {2, 0, 0}},
                         {"half as fast", {2, 0, 0}, {1, 0, 0}},
                         {"faster", {2, 0, 0}, {3.5, 0, 0}},
                         {"against the flight", {2, 0, 0}, {-2, 0, 0}},
                         {"away before the camera", {0, 0, 2}, {0, 0, 4}},
                         {"away as fast as the camera", {0, 0, 2}, {0, 0, 2}}}) {
    Scene scene;
    scene.camera_at = [&](double t) { return Vec3((t - 2.5) * d.camera_m_s); };
    scene.thing_at = [&](double t) { return Vec3(Vec3(0, 0, kDistance) + (t - 2.5) * d.thing_m_s); };
    EXPECT_EQ(Flight(scene).first_parked(5), -1) << d.name;
  }
}

TEST(ParkedBoxes, PeopleAreNeverParked) {
  Scene scene;
  scene.camera_at = passing;
  scene.class_id = kPerson;
  EXPECT_EQ(Flight(scene).first_parked(5), -1);
  scene.class_id = 5;
  EXPECT_EQ(Flight(scene).first_parked(5), -1) << "a class without a name";
}

TEST(ParkedBoxes, WhatStartsToDriveIsReleasedWithinTwoDetections) {
  for (const bool hover : {false, true}) {
    Scene scene;
    if (!hover) scene.camera_at = passing;
    constexpr double kStart = 3.5;
    scene.thing_at = [](double t) { return Vec3(t > kStart ? 5 * (t - kStart) : 0, 0, kDistance); };
    Flight flight(scene);
    ASSERT_TRUE(flight.fly_to(kStart));
    EXPECT_FALSE(flight.fly_to(5));
    EXPECT_GT(flight.released_s(), kStart);
    EXPECT_LE(flight.released_s(), kStart + (2 * kDetectionEvery + kLate) / kPerSecond);
  }
}

TEST(ParkedBoxes, WhatHasStoppedIsParkedAgain) {
  Scene scene;
  scene.camera_at = passing;
  scene.thing_at = [](double t) { return Vec3(std::min(3 * t - 3, 0.0), 0, kDistance); };
  Flight flight(scene);
  EXPECT_FALSE(flight.fly_to(2.9));
  EXPECT_TRUE(flight.fly_to(4));
}

TEST(ParkedBoxes, BoxesThatTremble) {
  Scene scene;
  scene.camera_at = passing;
  scene.jitter = 0.03;
  Flight flight(scene);
  EXPECT_TRUE(flight.fly_to(3.5));
  EXPECT_TRUE(flight.fly_to(5));
  EXPECT_EQ(flight.released_s(), -1);
}

TEST(ParkedBoxes, BoxesCutOffByThePictureProveNothing) {
  Scene scene;
  scene.thing_at = [](double) { return Vec3(14, 0, kDistance); };
  EXPECT_EQ(Flight(scene).first_parked(5), -1);
  scene.thing_at = [](double) { return Vec3(12, 0, kDistance); };
  EXPECT_GT(Flight(scene).first_parked(5), 0) << "wholly in the picture";
}

TEST(ParkedBoxes, AnotherMapOrNoPoseForLongIsABeginning) {
  Scene scene;
  scene.camera_at = passing;
  scene.map_id = [](double t) { return t < 3 ? 1U : 2U; };
  Flight other_map(scene);
  EXPECT_TRUE(other_map.fly_to(2.9));
  EXPECT_FALSE(other_map.fly_to(3.1));
  EXPECT_FALSE(other_map.fly_to(4.9));
  EXPECT_TRUE(other_map.fly_to(5.5));

  scene.map_id = [](double) { return 1U; };
  scene.has_pose = [](double t) { return t < 3 || t > 3.5; };
  Flight gap(scene);
  EXPECT_TRUE(gap.fly_to(4));
  EXPECT_EQ(gap.released_s(), -1) << "half a second is not long";
  scene.has_pose = [](double t) { return t < 3; };
  Flight lost(scene);
  EXPECT_TRUE(lost.fly_to(3));
  EXPECT_FALSE(lost.fly_to(4.5));
  scene.has_pose = [](double) { return false; };
  EXPECT_EQ(Flight(scene).first_parked(5), -1);
}

TEST(ParkedBoxes, ADetectionThatMissesItBreaksNothing) {
  Scene scene;
  scene.camera_at = passing;
  scene.detected = [](double t) { return std::fmod(t, 1.0) < 0.6; };
  Flight flight(scene);
  EXPECT_TRUE(flight.fly_to(3.5));
  EXPECT_EQ(flight.released_s(), -1);
}

TEST(ParkedBoxes, WhatIsHeldKeepsItsTrackAndIsNoSighting) {
  Scene scene;
  scene.camera_at = passing;
  scene.missed = [](double t) { return t > 2.9 ? 1 : 0; };
  Flight parked(scene);
  ASSERT_TRUE(parked.fly_to(2.8));
  EXPECT_TRUE(parked.fly_to(3.3)) << "one detection missed it: as parked as before";
  scene.missed = [](double t) { return t > 0.3 ? 1 : 0; };
  EXPECT_EQ(Flight(scene).first_parked(5), -1) << "where it was carried to says nothing of whether it stands";
}

TEST(ParkedBoxes, WithoutMapPointsAroundNothingIsKnown) {
  Scene scene;
  scene.camera_at = passing;
  scene.points = false;
  EXPECT_EQ(Flight(scene).first_parked(5), -1);
}

TEST(ParkedBoxes, MoreThingsThanTracksAndLateDetections) {
  ParkedBoxes boxes(camera(), {false, true});
  std::vector<detector::Box> many;
  for (int i = 0; i < detector::kMaxBoxes; ++i) {
    const int column = i % 16, row = i / 16;
    const float x = 10.F + 38.F * static_cast<float>(column), y = 10.F + 55.F * static_cast<float>(row);
    many.push_back({x, y, x + 30.F, y + 45.F, 0.9F, kCar, -1});
  }
  const rt::HeapCounts before = rt::rt_heap_counts();
  for (int frame = 0; frame < 100; ++frame) {
    const rt::RtScope scope;
    boxes.note_boxes(frame * 33 * rt::kNsPerMs, many);
    boxes.take_detection(frame * 33 * rt::kNsPerMs, many);
    boxes.note_tracked({frame * 33 * rt::kNsPerMs, 1, {}, {}});
  }
  EXPECT_EQ(rt::rt_heap_counts().allocations, before.allocations);
  std::vector<int> tracks;
  for (const detector::Box& b : many)
    if (b.track >= 0) tracks.push_back(b.track);
  std::sort(tracks.begin(), tracks.end());
  EXPECT_EQ(std::unique(tracks.begin(), tracks.end()) - tracks.begin(), ParkedBoxes::kTracks) << "one box a track";
  EXPECT_EQ(static_cast<int>(tracks.size()), ParkedBoxes::kTracks);
  boxes.take_detection(0, many);
  EXPECT_EQ(many.front().track, -1) << "older than the pictures that are remembered";
}

}  // namespace parked_boxes_test
}  // namespace godwit::app
