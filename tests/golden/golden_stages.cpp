// Prints what the stages of the odometry make of the first pictures of a sequence, one line an item, for comparison
// with the committed outputs (scripts/golden).
//   golden_stages SEQUENCE
#include <cstdio>
#include <memory>
#include <vector>

#include "firmware_app/pipeline/odometry_stage.h"
#include "hal/camera/replay/replay_camera.h"
#include "vo_core/image/pyramid.h"
#include "vo_core/map/mapper.h"
#include "vo_core/tracking/tracker.h"

namespace godwit {
namespace {

constexpr int kFrames = 40;
constexpr int kCorners = 200;

/// FNV-1a over the pixels of one level.
std::uint64_t hash(const rt::ImageView& image) {
  std::uint64_t h = 0xcbf29ce484222325ULL;
  for (int y = 0; y < image.height; ++y)
    for (int x = 0; x < image.width; ++x) h = (h ^ image.at(x, y)) * 0x100000001b3ULL;
  return h;
}

void print_pyramid(const rt::PyramidView& pyramid) {
  for (int l = 0; l < pyramid.levels; ++l) {
    const rt::ImageView& image = pyramid.level[static_cast<std::size_t>(l)];
    std::printf("pyramid %d %d %d %016llx\n", l, image.width, image.height,
                static_cast<unsigned long long>(hash(image)));
  }
}

void print_corners(const rt::PyramidView& pyramid) {
  vo::FeatureDetector detector(pyramid.level[0].width, pyramid.level[0].height, {});
  std::vector<vo::Feature> features(kCorners);
  const int n = detector.detect(pyramid, {}, {}, kCorners, features);
  for (int i = 0; i < n; ++i) {
    const vo::Feature& f = features[static_cast<std::size_t>(i)];
    std::printf("corner %d %d %d %.7g %.7g %.7g\n", i, f.level, static_cast<int>(f.type), static_cast<double>(f.px.x()),
                static_cast<double>(f.px.y()), static_cast<double>(f.score));
  }
}

void print_map(const vo::Map& map) {
  for (int i = 0; i < map.point_end(); ++i) {
    const vo::MapPoint& p = map.point(i);
    if (p.active) std::printf("first_map %d %.9g %.9g %.9g\n", i, p.p_world.x(), p.p_world.y(), p.p_world.z());
  }
}

void print_pose(int frame, const vo::FrameResult& r) {
  const Eigen::Quaterniond q = r.T_world_cam.quaternion();
  const Eigen::Vector3d& t = r.T_world_cam.t;
  std::printf("pose %d %d %d %.9g %.9g %.9g %.9g %.9g %.9g %.9g\n", frame, r.tracked, r.measurements, t.x(), t.y(),
              t.z(), q.x(), q.y(), q.z(), q.w());
}

int run(const char* folder) {
  hal::ReplayOptions replay;
  replay.frames = kFrames;
  auto camera = hal::ReplayCamera::open(folder, replay);
  if (!camera) {
    std::fprintf(stderr, "golden_stages: %s\n", camera.error().message.c_str());
    return 2;
  }
  const hal::CameraCalibration& calibration = camera.value()->calibration();
  const auto model = app::make_camera_model(calibration);
  if (!model) {
    std::fprintf(stderr, "golden_stages: %s\n", model.error().message.c_str());
    return 2;
  }
  const int width = calibration.width, height = calibration.height;
  const int stride = (width + rt::kRowAlignment - 1) / rt::kRowAlignment * rt::kRowAlignment;
  const std::size_t picture = static_cast<std::size_t>(stride) * static_cast<std::size_t>(height);
  const std::size_t pyramid = vo::pyramid_bytes(width, height, rt::kPyramidLevels);

  vo::TrackerOptions options;
  options.delta_delay_frames = 2;
  options.shutter.readout_s = calibration.readout_s();
  options.initializer.readout = calibration.readout_frames;
  vo::MapperOptions mapper_options;
  mapper_options.shutter.readout_s = calibration.readout_s();
  auto channel = std::make_unique<vo::MapChannel>();
  auto tracker = std::make_unique<vo::Tracker>(model.value(), options, channel.get());
  auto mapper = std::make_unique<vo::Mapper>(model.value(), mapper_options, channel.get());

  struct Aligned {
    void operator()(std::uint8_t* p) const { ::operator delete[](p, std::align_val_t(rt::kRowAlignment)); }
  };
  std::vector<std::unique_ptr<std::uint8_t[], Aligned>> memory;  // every frame keeps its own: nothing to give back
  bool had_map = false;
  for (int i = 0; i < kFrames; ++i) {
    memory.emplace_back(new (std::align_val_t(rt::kRowAlignment)) std::uint8_t[picture + pyramid + 64]());
    std::uint8_t* data = memory.back().get();
    hal::CapturedFrame frame;
    std::string why;
    if (camera.value()->next({data, width, height, stride}, nullptr, 0, &frame, &why) != hal::CameraStatus::kFrame) {
      std::fprintf(stderr, "golden_stages: picture %d: %s\n", i, why.c_str());
      return 2;
    }
    vo::FrameInput in;
    in.grey = {data, width, height, stride};
    in.pyramid_storage = data + picture;
    in.pyramid_bytes = pyramid;
    in.slot = i;
    in.sequence = frame.sequence;
    in.t_capture_ns = frame.t_capture_ns;
    if (i == 0) {
      const rt::PyramidView levels = vo::build_pyramid(in.grey, rt::kPyramidLevels, in.pyramid_storage, pyramid);
      print_pyramid(levels);
      print_corners(levels);
    }
    const vo::FrameResult r = tracker->track(in);
    while (mapper->step()) {
    }
    vo::SlotRelease unused;
    while (tracker->take_release(&unused)) {
    }
    while (mapper->take_release(&unused)) {
    }
    print_pose(i, r);
    if (r.tracked && !had_map) print_map(tracker->map());
    had_map |= r.tracked;
    if (i + 1 == kFrames) {
      int k = 0;
      for (const vo::FrameFeature& f : tracker->features())
        std::printf("aligned %d %d %.7g %.7g\n", k++, f.level, static_cast<double>(f.px.x()),
                    static_cast<double>(f.px.y()));
    }
  }
  return 0;
}

}  // namespace
}  // namespace godwit

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: golden_stages SEQUENCE\n");
    return 2;
  }
  return godwit::run(argv[1]);
}
