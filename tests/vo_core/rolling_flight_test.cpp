// Tracker and mapper behind a rolling shutter, on rendered pictures with exact truth.
#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>
#include <memory>
#include <numbers>
#include <vector>

#include "tests/vo_core/relative_nees.h"
#include "tests/vo_core/synthetic_scene.h"
#include "vo_core/map/mapper.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::vo {
namespace rolling_flight_test {

constexpr int kWidth = 320, kHeight = 240;
constexpr double kIntervalS = 1.0 / 30, kReadout = 0.7;

const CameraModel& camera() {
  static const CameraModel some =
      CameraModel::pinhole_radtan(kWidth, kHeight, 260, 260, 160, 120, {0.05, -0.02, 0, 0, 0}).value();
  return some;
}
const test::SyntheticScene& scene() {
  static const test::SyntheticScene some = test::SyntheticScene::general();
  return some;
}
/// Where the camera is at a time [frames]: a sideways way, looking about with up to 0.7 rad/s.
SE3 pose_at(double frame) {
  const double s = 0.02 * frame;
  const double yaw = 0.12 * std::sin(0.2 * frame), roll = 0.05 * std::sin(0.13 * frame);
  return SE3(so3_exp(Vec3(0, yaw, roll)), Vec3::Zero()) * SE3(Mat3::Identity(), Vec3(-s, 0.05 * std::sin(3.0 * s), 0));
}
double row_time(double row) {
  return (row / kHeight - 0.5) * kReadout;
}
/// Left twist rate of the pose [1/s].
Vec6 velocity_at(double frame) {
  return (pose_at(frame + 0.01) * pose_at(frame - 0.01).inverse()).log() / (0.02 * kIntervalS);
}
const test::Picture& picture(int frame) {
  static std::vector<std::unique_ptr<test::Picture>> all(100);
  auto& one = all[static_cast<std::size_t>(frame)];
  if (!one)
    one = std::make_unique<test::Picture>(
        scene().render_rows(camera(), [&](int row) { return pose_at(frame + row_time(row)); }));
  return *one;
}
/// Where a global shutter sees at the frame's time what the rolling one sees at px.
Vec2 truly_global(int frame, const Vec2& px) {
  const SE3 T_row = pose_at(frame + row_time(px.y()));
  const Vec3 ray = camera().unproject(px);
  const Vec3 p = ray / ray.z() * scene().depth(camera(), T_row, px);
  Vec2 out = px;
  EXPECT_TRUE(camera().project(pose_at(frame) * T_row.inverse() * p, &out));
  return out;
}

/// A flight, frame by frame. Each picture keeps its memory: no reference need be given back.
struct Flight {
  explicit Flight(double readout) {
    TrackerOptions options;
    options.delta_delay_frames = 2;
    options.shutter.readout_s = readout * kIntervalS;
    options.initializer.readout = readout;
    MapperOptions mapper_options;
    mapper_options.shutter = options.shutter;
    tracker = std::make_unique<Tracker>(camera(), options, channel.get());
    mapper = std::make_unique<Mapper>(camera(), mapper_options, channel.get());
  }
  FrameResult fly(int frame) { return fly(frame, picture(frame), {}); }
  FrameResult fly(int frame, const test::Picture& shown, const MeasuredShake& shake) {
    constexpr std::size_t kPixels = kWidth * kHeight;
    const std::size_t extra = pyramid_bytes(kWidth, kHeight, rt::kPyramidLevels);
    memory.emplace_back(kPixels + extra + 2 * rt::kRowAlignment);
    std::uint8_t* data = memory.back().data();
    while (reinterpret_cast<std::uintptr_t>(data) % rt::kRowAlignment != 0) ++data;
    std::copy_n(shown.view().data, kPixels, data);
    FrameInput in;
    in.grey = {data, kWidth, kHeight, kWidth};
    in.pyramid_storage = data + kPixels;
    in.pyramid_bytes = extra;
    in.shake = shake;
    in.slot = frame;
    in.sequence = static_cast<std::uint32_t>(frame);
    in.t_capture_ns = rt::kNsPerSecond + frame * 33'333'333LL;
    const FrameResult r = tracker->track(in);
    while (mapper->step()) {
    }
    SlotRelease release;
    while (tracker->take_release(&release)) {
    }
    while (mapper->take_release(&release)) {
    }
    return r;
  }

  std::unique_ptr<MapChannel> channel = std::make_unique<MapChannel>();
  std::unique_ptr<Tracker> tracker;
  std::unique_ptr<Mapper> mapper;
  std::vector<std::vector<std::uint8_t>> memory;
};

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

TEST(RollingFlight, TheFirstTwoKeyframesAreFreedOfTheShutter) {
  Flight flight(kReadout);
  int frame = 0;
  while (frame < 40 && !flight.fly(frame).tracked) ++frame;
  ASSERT_LT(frame, 40) << "no first map";
  ASSERT_EQ(flight.tracker->map().keyframe_count(), 2);
  for (const Map* map : {&flight.tracker->map(), &flight.mapper->map()}) {
    for (int place = 0; place < 2; ++place) {
      const Keyframe& kf = map->keyframe(place);
      // The map's unit is unknown: rotations are compared.
      const int at = static_cast<int>(std::lround(rt::to_seconds(kf.t_capture_ns - rt::kNsPerSecond) / kIntervalS));
      const Vec3 rate = kf.motion.velocity.tail<3>(), truth = velocity_at(at).tail<3>();
      EXPECT_LT((rate - truth).norm(), 0.1 + 0.15 * truth.norm()) << "keyframe " << place + 1;
      std::vector<double> as_seen, freed;
      for (int i = 0; i < kf.feature_count; ++i) {
        const KeyframeFeature& f = kf.features[static_cast<std::size_t>(i)];
        const Vec2 global = truly_global(at, f.px.cast<double>());
        as_seen.push_back((f.px.cast<double>() - global).norm());
        freed.push_back((f.px_global.cast<double>() - global).norm());
      }
      ASSERT_GT(freed.size(), 50u);
      EXPECT_LT(median(freed), 0.2 * median(as_seen)) << "keyframe " << place + 1 << ", " << median(as_seen) << " px";
    }
  }
}

struct Errors {
  int tracked = 0;
  double angle_rad = 0.0, off = 0.0;  ///< root mean square
};
Errors errors_of(const std::vector<std::pair<int, SE3>>& poses, int origin);
Errors errors_of_a_flight(double readout) {
  Flight flight(readout);
  std::vector<std::pair<int, SE3>> poses;
  int origin = -1;
  for (int frame = 0; frame < 70; ++frame) {
    const FrameResult r = flight.fly(frame);
    if (r.tracked) poses.emplace_back(frame, r.T_world_cam);
    if (r.tracked && origin < 0)
      origin = static_cast<int>(
          std::lround(rt::to_seconds(flight.tracker->map().keyframe(0).t_capture_ns - rt::kNsPerSecond) / kIntervalS));
  }
  return errors_of(poses, origin);
}
Errors errors_of(const std::vector<std::pair<int, SE3>>& poses, int origin) {
  // World: the first view's camera, in an unknown scale.
  double num = 0, den = 0;
  for (const auto& [frame, T] : poses) {
    num += (pose_at(origin) * pose_at(frame).inverse()).t.dot(T.t);
    den += T.t.squaredNorm();
  }
  Errors out;
  for (const auto& [frame, T] : poses) {
    const SE3 truth = pose_at(origin) * pose_at(frame).inverse();
    out.off += (num / den * T.t - truth.t).squaredNorm();
    out.angle_rad += so3_log(T.R.transpose() * truth.R).squaredNorm();
    ++out.tracked;
  }
  out.off = std::sqrt(out.off / out.tracked);
  out.angle_rad = std::sqrt(out.angle_rad / out.tracked);
  return out;
}

TEST(RollingFlight, PosesAreThoseOfTheCaptureTimes) {
  const Errors with = errors_of_a_flight(kReadout), without = errors_of_a_flight(0.0);
  EXPECT_GE(with.tracked, 50);
  EXPECT_LT(with.off, 0.0065) << "of a path of 1.4 units; 0.0061 when this was written";
  EXPECT_LT(with.angle_rad, 0.002);
  // It is the shutter that makes the difference.
  EXPECT_GT(without.off, 2.0 * with.off) << without.tracked;
}

/// 85 Hz at 30 pictures a second, by two pixels about two axes: what a propeller makes of a camera's mount.
Vec3 shaken(double frame) {
  const double phase = 2 * std::numbers::pi * 85.0 / 30.0 * frame;
  return 8e-3 * Vec3(std::sin(phase), std::cos(phase + 0.7), 0);
}
/// What a gyroscope says of it that leaves six tenths of it and is 2.5 ms late.
MeasuredShake read_by_gyroscope(int frame) {
  MeasuredShake out;
  out.known = true;
  out.t_ns = std::llround(frame * kIntervalS * 1e9);
  constexpr double kLate = 0.0025 / kIntervalS, kLeft = 0.6, kStep = 1e-4;
  Vec3 mean = Vec3::Zero();
  const auto at = [&](double row) { return Vec3(kLeft * shaken(frame + kReadout * (row - 0.5) - kLate)); };
  for (int k = 0; k < RowTurns::kRows; ++k) mean += at(k / (RowTurns::kRows - 1.0)) / RowTurns::kRows;
  for (int k = 0; k < RowTurns::kRows; ++k) {
    const double row = k / (RowTurns::kRows - 1.0);
    out.turn.at[k] = (at(row) - mean).cast<float>();
    out.rate.at[k] = ((at(row + kStep) - at(row - kStep)) / (2 * kStep * kReadout * kIntervalS)).cast<float>();
  }
  return out;
}

TEST(RollingFlight, AGyroscopeTakesTheShakeOutOfTheRows) {
  std::vector<std::unique_ptr<test::Picture>> pictures;
  pictures.reserve(70);
  const auto pose = [](double frame) { return SE3(so3_exp(shaken(frame)), Vec3::Zero()) * pose_at(frame); };
  for (int frame = 0; frame < 70; ++frame)
    pictures.push_back(std::make_unique<test::Picture>(
        scene().render_rows(camera(), [&](int row) { return pose(frame + row_time(row)); })));
  const auto errors_with = [&](bool measured) {
    Flight flight(kReadout);
    std::vector<std::pair<int, SE3>> poses;
    int origin = -1;
    for (int frame = 0; frame < 70; ++frame) {
      const FrameResult r = flight.fly(frame, *pictures[static_cast<std::size_t>(frame)],
                                       measured ? read_by_gyroscope(frame) : MeasuredShake{});
      if (!r.tracked) continue;
      poses.emplace_back(frame, r.T_world_cam);
      if (origin < 0)
        origin = static_cast<int>(std::lround(
            rt::to_seconds(flight.tracker->map().keyframe(0).t_capture_ns - rt::kNsPerSecond) / kIntervalS));
    }
    return errors_of(poses, origin);
  };
  const Errors with = errors_with(true), without = errors_with(false);
  EXPECT_GE(with.tracked, 50);
  EXPECT_LT(with.off, 0.0065) << "of a path of 1.4 units, as without a shake; 0.0043 when this was written";
  EXPECT_LT(with.angle_rad, 0.002);
  EXPECT_LT(without.tracked, 25) << "it is the gyroscope that makes the difference: no map begins without";
}

// Relative to a keyframe half a second older and more, with what the map is off by and behind the shutter.
TEST(RollingFlight, PosesKnowHowWrongTheyAre) {
  Flight flight(kReadout);
  test::RelativeNees nees;
  int judged = 0, inside = 0;
  for (int frame = 0; frame < 100; ++frame) {
    const FrameResult r = flight.fly(frame);
    if (!r.tracked || r.relative.keyframe_id == 0) continue;
    const auto frame_of = [](rt::TimeNs t) {
      return static_cast<double>(std::lround(rt::to_seconds(t - rt::kNsPerSecond) / kIntervalS));
    };
    const double reference = frame_of(r.relative.t_keyframe_ns);
    if (frame - reference < 15) continue;
    const double one =
        nees.add(r.relative.T_ref_cam.inverse(), pose_at(frame) * pose_at(reference).inverse(), r.relative.covariance);
    ++judged;
    inside += one < 11.07 / 5.0;
  }
  ASSERT_GT(judged, 50);
  // One flight: its errors hang together.
  EXPECT_GT(nees.mean(), 0.2);
  EXPECT_LT(nees.mean(), 3.0);
  // 95 % would be true, and half of them are: what a young map is off by is still told too small (docs/uncertainty.md).
  EXPECT_GT(inside, judged * 4 / 10);
}

}  // namespace rolling_flight_test
}  // namespace godwit::vo
