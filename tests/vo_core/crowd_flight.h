// A flight between movers who hide most of the picture, on rendered pictures with exact truth.
#pragma once

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "tests/vo_core/synthetic_scene.h"
#include "vo_core/map/mapper.h"
#include "vo_core/tracking/tracker.h"

namespace godwit::vo::crowd_test {

constexpr rt::TimeNs kFrameNs = 33'333'333;
/// So many pictures without movers begin each flight.
constexpr int kFree = 30;

/// Sees the same at any size.
inline CameraModel camera_of(int width) {
  return CameraModel::pinhole_radtan(width, width * 3 / 4, 0.8 * width, 0.8 * width, 0.5 * width, 0.375 * width, {})
      .value();
}
inline const CameraModel& small_camera() {
  static const CameraModel camera = camera_of(320);
  return camera;
}

/// A sideways sweep with a gentle turn.
inline SE3 sweep(int i) {
  const double s = 0.02 * i;
  return SE3::exp((Vec6() << -s, 0.12 * std::sin(2.0 * s), 0.05 * std::sin(3.0 * s), 0, 0.06 * s, 0).finished());
}

/// A frame of a flight: the sweep's pose number `place`, turned about the optical axis, with two movers over `hidden`
/// of the picture, of which the mask tells.
struct Shot {
  int place = 0;
  double hidden = 0.0;
  double roll = 0.0;
  int missing = 0;  ///< frames that did not come before it
  int blur = 0;     ///< px that the camera swept sideways while it looked
  int torn = 0;     ///< the outer thirds go ways of their own: they are seen from so many places further on and back
  int rider = -1;   ///< the middle third goes along with the camera: it is seen from this place; -1: it does not
};
inline SE3 pose_of(const Shot& shot) {
  return SE3(so3_exp(Vec3(0, 0, shot.roll)), Vec3::Zero()) * sweep(shot.place);
}
/// A wall and some boards before it.
inline const test::SyntheticScene& scene() {
  static const test::SyntheticScene some = [] {
    test::SyntheticScene out;
    const test::SyntheticScene all = test::SyntheticScene::general();
    for (std::size_t i = 0; i < all.boards.size(); i += 3) out.boards.push_back(all.boards[i]);
    return out;
  }();
  return some;
}
/// The shot's picture without movers.
inline const test::Picture& street(const CameraModel& camera, const Shot& shot) {
  static std::map<std::tuple<int, int, double>, test::Picture> all;
  const std::tuple<int, int, double> key(camera.width(), shot.place, shot.roll);
  auto known = all.find(key);
  if (known == all.end()) known = all.emplace(key, scene().render(camera, pose_of(shot))).first;
  return known->second;
}

inline std::vector<Shot> shots(std::initializer_list<std::tuple<int, int, double>> parts) {
  std::vector<Shot> out;
  for (const auto& [first, last, hidden] : parts)
    for (int i = first; i <= last; ++i) out.push_back({i, hidden});
  return out;
}

/// One frame's memory: the picture with its movers, the pyramid behind it, the mask.
struct Seen {
  Seen(const CameraModel& camera, const Shot& shot, int time)
      : width(camera.width()), height(camera.height()), mask(width, height) {
    const std::size_t pixels = static_cast<std::size_t>(width * height);
    const std::size_t extra = pyramid_bytes(width, height, rt::kPyramidLevels);
    bytes.resize(pixels + extra + 4 * rt::kRowAlignment);
    data = bytes.data();
    while (reinterpret_cast<std::uintptr_t>(data) % rt::kRowAlignment != 0) ++data;
    std::copy_n(street(camera, shot).view().data, pixels, data);
    if (shot.blur > 0) sweep_over(street(camera, shot).view(), shot.blur);
    if (shot.torn != 0) {
      put_part(street(camera, {shot.place + shot.torn}).view(), 0, width / 3);
      put_part(street(camera, {shot.place - shot.torn}).view(), width - width / 3, width);
    }
    if (shot.rider >= 0) put_part(street(camera, {shot.rider}).view(), width / 3, width - width / 3);
    const int each = static_cast<int>(0.5 * shot.hidden * width);
    if (each > 0) {
      // One walks to the right, one to the left, and back again.
      const double way = std::abs(std::fmod(0.02 * time, 2.0) - 1.0);
      const int left = static_cast<int>((0.5 * width - each) * way);
      put_mover(left, each, 71, time);
      put_mover(width - each - left, each, 72, -time);
    }
    input.grey = {data, width, height, width};
    input.pyramid_storage = data + pixels;
    input.pyramid_bytes = extra;
    input.mask = mask.view();
    input.slot = time;
    input.sequence = static_cast<std::uint32_t>(time);
    input.t_capture_ns = time * kFrameNs;
  }
  void sweep_over(const rt::ImageView& sharp, int px) {
    for (int y = 0; y < height; ++y)
      for (int x = 0; x < width; ++x) {
        int sum = 0;
        for (int i = 0; i < px; ++i) sum += sharp.at(std::clamp(x + i - px / 2, 0, width - 1), y);
        data[y * width + x] = static_cast<std::uint8_t>(sum / px);
      }
  }
  void put_part(const rt::ImageView& from, int x0, int x1) {
    for (int y = 0; y < height; ++y) std::copy_n(from.row(y) + x0, x1 - x0, data + y * width + x0);
  }
  void put_mover(int x0, int wide, std::uint32_t clothes, int time) {
    const double cell = 32.0 / width;
    for (int y = 0; y < height; ++y)
      for (int x = x0; x < std::min(x0 + wide, width); ++x)
        data[y * width + x] =
            static_cast<std::uint8_t>(230.0 * test::texture(cell * (x - x0) + time, cell * y, clothes));
    mask.add_rectangle(x0, 0, x0 + wide, height);
  }

  int width, height;
  std::vector<std::uint8_t> bytes;
  std::uint8_t* data = nullptr;
  test::Mask mask;
  FrameInput input;
};

struct Flight {
  std::vector<FrameResult> frames;
  std::vector<int> points, keyframes, vouched;  ///< of the tracker's map; vouched: points that are
};

inline Flight fly(const std::vector<Shot>& shots, TrackerOptions options = {},
                  const CameraModel& camera = small_camera()) {
  options.delta_delay_frames = 2;
  const auto channel = std::make_unique<MapChannel>();
  Tracker tracker(camera, options, channel.get());
  Mapper mapper(camera, MapperOptions{}, channel.get());
  std::vector<std::unique_ptr<Seen>> memory;  // each frame has its own: none need be given back
  Flight out;
  int time = -1;
  for (const Shot& shot : shots) {
    time += 1 + shot.missing;
    memory.push_back(std::make_unique<Seen>(camera, shot, time));
    out.frames.push_back(tracker.track(memory.back()->input));
    while (mapper.step()) {
    }
    SlotRelease release;
    while (tracker.take_release(&release)) {
    }
    while (mapper.take_release(&release)) {
    }
    out.points.push_back(tracker.map().point_count());
    out.keyframes.push_back(tracker.map().keyframe_count());
    int vouched = 0;
    for (int i = 0; i < tracker.map().point_end(); ++i)
      vouched += tracker.map().point(i).active && tracker.map().point(i).vouched;
    out.vouched.push_back(vouched);
  }
  return out;
}

inline bool weak(const FrameResult& r) {
  return std::string(r.reason) == "a pose of few features, not counted";
}

/// More measurements than a third of the picture hidden leaves, fewer than the free picture gives: of so many a
/// tracker in these tests demands that they count. Found by a flight, so that the tests do not hang on how many
/// features godwit takes.
inline int few() {
  static const int limit = [] {
    const Flight f = fly(shots({{0, kFree - 1, 0.0}}));
    return f.frames.back().measurements * 8 / 10;
  }();
  return limit;
}

/// The flight's world in units of the truth: the factor by which the tracked frames before `end` fit it best.
inline double scale_of(const Flight& flight, const std::vector<Shot>& shots, std::size_t end) {
  double num = 0, den = 0;
  for (std::size_t i = 0; i < end; ++i) {
    if (!flight.frames[i].tracked) continue;
    num += (sweep(0) * pose_of(shots[i]).inverse()).t.dot(flight.frames[i].T_world_cam.t);
    den += flight.frames[i].T_world_cam.t.squaredNorm();
  }
  return num / den;
}
/// How far frame i is off, in units of the truth (the scene is two to six of them away).
inline double off_by(const Flight& flight, const std::vector<Shot>& shots, std::size_t i, double scale) {
  return (scale * flight.frames[i].T_world_cam.t - (sweep(0) * pose_of(shots[i]).inverse()).t).norm();
}

}  // namespace godwit::vo::crowd_test
