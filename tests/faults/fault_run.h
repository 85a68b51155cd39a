// Flies pictures from memory through the sequential pipeline and compares the poses with a sequence's truth.
#pragma once

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <functional>
#include <gtest/gtest.h>
#include <memory>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "firmware_app/pipeline/odometry_stage.h"
#include "firmware_app/pipeline/pipeline.h"
#include "hal/camera/replay/replay_camera.h"

namespace godwit::test {

using Pixels = std::vector<std::uint8_t>;  ///< grey, rows without padding

/// Where recorded sequences lie, or nothing.
inline std::optional<std::string> sequence_folder(const std::string& name) {
  const char* shared = std::getenv("GODWIT_SHARED_DIR");
  if (shared == nullptr) return {};
  const std::string folder = std::string(shared) + "/data/" + name;
  return std::ifstream(folder + "/rgb.txt").good() ? std::optional(folder) : std::nullopt;
}

/// For SetUp: the folder of a recorded sequence into *folder. Absent: skipped with a word; a failure where CI=true.
inline void need_sequence(const std::string& name, std::string* folder) {
  const auto found = sequence_folder(name);
  if (found) {
    *folder = *found;
    return;
  }
  const char* ci = std::getenv("CI");
  if (ci != nullptr && std::string(ci) == "true") FAIL() << "the recorded sequence " << name << " is not there";
  GTEST_SKIP() << "the recorded sequence " << name << " is not there";
}

struct TruthPose {
  double t_s = 0;
  Eigen::Vector3d p;
  Eigen::Quaterniond q;
};

/// Part of a recorded sequence, decoded.
struct Recording {
  hal::CameraCalibration calibration;
  std::vector<Pixels> pictures;
  std::vector<rt::TimeNs> times;  ///< as in the index [ns]
  std::vector<TruthPose> truth;

  static Recording load(const std::string& folder, int start, int frames) {
    hal::ReplayOptions options;
    options.start = start;
    options.frames = frames;
    auto camera = hal::ReplayCamera::open(folder, options);
    if (!camera) std::abort();
    Recording r;
    r.calibration = camera.value()->calibration();
    Pixels grey(static_cast<std::size_t>(r.calibration.width) * static_cast<std::size_t>(r.calibration.height));
    hal::CapturedFrame frame;
    while (camera.value()->next({grey.data(), r.calibration.width, r.calibration.height, r.calibration.width}, nullptr,
                                0, &frame, nullptr) == hal::CameraStatus::kFrame) {
      r.pictures.push_back(grey);
      r.times.push_back(frame.t_source_ns);
    }
    std::ifstream in(folder + "/groundtruth.txt");
    for (std::string line; std::getline(in, line);) {
      std::istringstream row(line);
      TruthPose p;
      double x, y, z, w;
      if (line.empty() || line[0] == '#') continue;
      row >> p.t_s >> p.p.x() >> p.p.y() >> p.p.z() >> x >> y >> z >> w;
      p.q = Eigen::Quaterniond(w, x, y, z).normalized();
      r.truth.push_back(p);
    }
    return r;
  }

  /// Interpolated truth; nothing where there is none within 50 ms.
  std::optional<TruthPose> truth_at(rt::TimeNs t) const {
    const double t_s = rt::to_seconds(t);
    const auto after =
        std::lower_bound(truth.begin(), truth.end(), t_s, [](const TruthPose& p, double time) { return p.t_s < time; });
    if (after == truth.begin() || after == truth.end() || after->t_s - (after - 1)->t_s > 0.1) return {};
    const TruthPose &a = *(after - 1), &b = *after;
    const double f = (t_s - a.t_s) / (b.t_s - a.t_s);
    return TruthPose{t_s, a.p + f * (b.p - a.p), a.q.slerp(f, b.q)};
  }
};

/// One picture as it reaches the camera interface.
struct Shown {
  const Pixels* pixels = nullptr;  ///< null: due, but cannot be read
  rt::TimeNs t_ns = 0;             ///< time of capture
  int truth_index = -1;            ///< picture of the recording that it is, spoilt or not; -1: none of its scene
};

class MemoryCamera final : public hal::Camera {
 public:
  MemoryCamera(int width, int height, const std::vector<Shown>& shown)
      : width_(width), height_(height), shown_(shown) {}
  int width() const override { return width_; }
  int height() const override { return height_; }
  int channels() const override { return 1; }
  hal::CameraStatus next(const rt::MutableImageView& grey, std::uint8_t*, rt::TimeNs, hal::CapturedFrame* frame,
                         std::string* why) override {
    if (next_ >= shown_.size()) return hal::CameraStatus::kEnd;
    const Shown& s = shown_[next_];
    frame->sequence = static_cast<std::uint32_t>(next_++);
    frame->t_source_ns = s.t_ns;
    frame->t_capture_ns = rt::kNsPerSecond + s.t_ns - shown_.front().t_ns;
    if (s.pixels == nullptr) {
      if (why != nullptr) *why = "spoilt";
      return hal::CameraStatus::kBadFrame;
    }
    for (int y = 0; y < height_; ++y)
      std::memcpy(grey.row(y), s.pixels->data() + static_cast<std::ptrdiff_t>(y) * width_,
                  static_cast<std::size_t>(width_));
    return hal::CameraStatus::kFrame;
  }

 private:
  const int width_, height_;
  const std::vector<Shown>& shown_;
  std::size_t next_ = 0;
};

inline std::vector<app::FrameRecord> fly(const hal::CameraCalibration& calibration, const std::vector<Shown>& shown) {
  struct Collect final : app::FrameSink {
    std::vector<app::FrameRecord> records;
    rt::Result<void> take(const app::FrameRecord& record) override {
      records.push_back(record);
      return {};
    }
  } sink;
  const auto model = app::make_camera_model(calibration);
  rt::FramePool::Layout layout;
  layout.width = calibration.width;
  layout.height = calibration.height;
  layout.pyramid_bytes = app::odometry_pyramid_bytes(layout.width, layout.height);
  layout.slots = app::odometry_frame_slots();
  layout.readers = app::kFrameReaders;
  auto pool = rt::FramePool::create(layout);
  app::OdometryOptions options = app::odometry_options(calibration);
  options.mapper_delay_frames = 2;
  const auto stage = app::make_odometry_stage(model.value(), options, pool.value().get());
  MemoryCamera camera(calibration.width, calibration.height, shown);
  app::PipelineOptions pipeline;
  pipeline.sequential = true;
  const std::atomic<bool> stop{false};
  static_cast<void>(app::run_pipeline(&camera, stage.get(), pool.value().get(), pipeline, &sink, stop));
  return sink.records;
}

/// Error of every tracked frame of one map against the truth, after a similarity from the frames for which
/// `reference(i)` holds (rotation from their attitudes, scale and place from their positions).
struct FrameError {
  bool tracked = false;
  bool known = false;  ///< the truth is known here
  double metres = 0, degrees = 0;
};

inline std::vector<FrameError> errors(const Recording& recording, const std::vector<Shown>& shown,
                                      const std::vector<app::FrameRecord>& records, std::uint32_t map_id,
                                      const std::function<bool(std::size_t)>& reference) {
  std::vector<FrameError> out(records.size());
  std::vector<Eigen::Vector3d> estimated, true_position;
  Eigen::Matrix4d turn = Eigen::Matrix4d::Zero();
  const auto attitude = [](const app::FrameRecord& r) {
    return Eigen::Quaterniond(r.q_world_cam[3], r.q_world_cam[0], r.q_world_cam[1], r.q_world_cam[2]);
  };
  const auto truth_of = [&](std::size_t i) -> std::optional<TruthPose> {
    if (shown[i].truth_index < 0) return {};
    return recording.truth_at(recording.times[static_cast<std::size_t>(shown[i].truth_index)]);
  };
  for (std::size_t i = 0; i < records.size(); ++i) {
    out[i].tracked = records[i].tracked && records[i].map_id == map_id;
    const auto truth = truth_of(i);
    if (!out[i].tracked || !truth || !reference(i)) continue;
    estimated.emplace_back(records[i].t_world_cam[0], records[i].t_world_cam[1], records[i].t_world_cam[2]);
    true_position.push_back(truth->p);
    const Eigen::Vector4d q = (truth->q * attitude(records[i]).conjugate()).coeffs();
    turn += q * q.transpose();
  }
  if (estimated.size() < 10) return out;
  // Mean rotation: eigenvector of the sum of outer products (Markley et al. 2007).
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> eigen(turn);
  const Eigen::Quaterniond R(Eigen::Vector4d(eigen.eigenvectors().col(3)));
  Eigen::Vector3d mean_e = Eigen::Vector3d::Zero(), mean_t = mean_e;
  for (std::size_t i = 0; i < estimated.size(); ++i) {
    mean_e += estimated[i] / static_cast<double>(estimated.size());
    mean_t += true_position[i] / static_cast<double>(estimated.size());
  }
  double num = 0, den = 0;
  for (std::size_t i = 0; i < estimated.size(); ++i) {
    num += (true_position[i] - mean_t).dot(R * (estimated[i] - mean_e));
    den += (estimated[i] - mean_e).squaredNorm();
  }
  const double scale = num / den;
  for (std::size_t i = 0; i < records.size(); ++i) {
    const auto truth = truth_of(i);
    if (!out[i].tracked || !truth) continue;
    out[i].known = true;
    const Eigen::Vector3d p(records[i].t_world_cam[0], records[i].t_world_cam[1], records[i].t_world_cam[2]);
    out[i].metres = (mean_t + scale * (R * (p - mean_e)) - truth->p).norm();
    out[i].degrees = (R * attitude(records[i])).angularDistance(truth->q) * 57.29577951308232;
  }
  return out;
}

}  // namespace godwit::test
