// godwit-init-survey SEQUENCE [--every N] [--limit N] [--trace OFFSET] [--truth-offset S] [--set OPTION=VALUE]
// [OFFSET...] Starts the initialisation at many places of a recorded sequence and compares the first map's motion with
// the ground truth: how soon, how often, how good. One line a start. --trace prints every frame of one start.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>
#include <yaml-cpp/yaml.h>

#include "benchmarks/last_catch.h"
#include "benchmarks/table_file.h"
#include "vo_core/image/pyramid.h"
#include "vo_core/tracking/initializer.h"

namespace {

using godwit::vo::SE3;
using godwit::vo::Vec3;

struct Stamped {
  double t;
  SE3 T_world_cam;
};

/// A picture with its pyramid in storage of its own.
struct Frame {
  double t = 0;
  std::vector<std::uint8_t> storage;
  godwit::rt::PyramidView pyramid;
};

struct Sequence {
  std::string folder;
  std::vector<std::pair<double, std::string>> pictures;
  std::vector<Stamped> truth;
  std::vector<std::unique_ptr<Frame>> cache;
};

std::uint8_t* aligned(std::uint8_t* p) {
  const auto a = reinterpret_cast<std::uintptr_t>(p);
  return p + (godwit::rt::kRowAlignment - a % godwit::rt::kRowAlignment) % godwit::rt::kRowAlignment;
}

const Frame* load(Sequence* s, std::size_t i) {
  auto& slot = s->cache[i];
  if (slot) return slot.get();
  const cv::Mat grey = cv::imread(s->folder + "/" + s->pictures[i].second, cv::IMREAD_GRAYSCALE);
  if (grey.empty()) {
    std::fprintf(stderr, "cannot read %s/%s\n", s->folder.c_str(), s->pictures[i].second.c_str());
    std::exit(1);
  }
  slot = std::make_unique<Frame>();
  slot->t = s->pictures[i].first;
  const int align = godwit::rt::kRowAlignment;
  const int stride = (grey.cols + align - 1) / align * align;
  const std::size_t base_bytes = static_cast<std::size_t>(stride) * static_cast<std::size_t>(grey.rows) + align;
  const std::size_t bytes = godwit::vo::pyramid_bytes(grey.cols, grey.rows, godwit::rt::kPyramidLevels);
  slot->storage.resize(base_bytes + bytes + 4 * static_cast<std::size_t>(align));
  std::uint8_t* base = aligned(slot->storage.data());
  for (int y = 0; y < grey.rows; ++y)
    std::memcpy(base + static_cast<std::ptrdiff_t>(y) * stride, grey.ptr(y), static_cast<std::size_t>(grey.cols));
  slot->pyramid = godwit::vo::build_pyramid({base, grey.cols, grey.rows, stride}, godwit::rt::kPyramidLevels,
                                            aligned(base + base_bytes), bytes);
  return slot.get();
}

bool truth_at(const std::vector<Stamped>& truth, double t, SE3* T) {
  // The first one that is later: a picture may be as old as the truth's beginning.
  const auto after =
      std::upper_bound(truth.begin(), truth.end(), t, [](double v, const Stamped& s) { return v < s.t; });
  if (after == truth.begin() || after == truth.end() || after->t - (after - 1)->t > 0.1) return false;
  const Stamped &a = *(after - 1), &b = *after;
  const double f = (t - a.t) / (b.t - a.t);
  T->R = a.T_world_cam.quaternion().slerp(f, b.T_world_cam.quaternion()).toRotationMatrix();
  T->t = (1 - f) * a.T_world_cam.t + f * b.T_world_cam.t;
  return true;
}

const char* name(godwit::vo::InitStatus s) {
  using S = godwit::vo::InitStatus;
  switch (s) {
    case S::kFirstFrame:
      return "first";
    case S::kTooFewFeatures:
      return "few-features";
    case S::kTracksLost:
      return "lost";
    case S::kNoMotion:
      return "no-motion";
    case S::kNoParallax:
      return "no-parallax";
    case S::kNoModel:
      return "no-model";
    case S::kAmbiguous:
      return "ambiguous";
    case S::kTurnOrWay:
      return "turn-or-way";
    case S::kTwoMotions:
      return "two-motions";
    case S::kDone:
      return "done";
  }
  return "?";
}

int usage(const char* program) {
  std::fprintf(stderr,
               "usage: %s SEQUENCE [--every N] [--limit N] [--trace OFFSET] [--truth-offset S] [--set OPTION=VALUE] "
               "[OFFSET...]\n",
               program);
  return 2;
}

/// Sets one threshold of the initialisation by its name; false if there is none of that name.
bool set(const std::string& assignment, godwit::vo::InitializerOptions* o) {
  const std::size_t equals = assignment.find('=');
  if (equals == std::string::npos) return false;
  const std::string key = assignment.substr(0, equals);
  const double value = std::strtod(assignment.c_str() + equals + 1, nullptr);
  if (key == "min_disparity_px")
    o->min_disparity_px = value;
  else if (key == "min_parallax_px")
    o->min_parallax_px = value;
  else if (key == "min_parallax_deg")
    o->min_parallax_deg = value;
  else if (key == "max_depth_uncertainty")
    o->max_depth_uncertainty = value;
  else if (key == "max_ambiguity")
    o->max_ambiguity = value;
  else if (key == "max_baseline_uncertainty")
    o->max_baseline_uncertainty = value;
  else if (key == "max_second_motion")
    o->max_second_motion = value;
  else if (key == "readout")
    o->readout = value;
  else if (key == "min_views")
    o->min_views = static_cast<int>(value);
  else if (key == "min_noise_px")
    o->min_noise_px = value;
  else if (key == "features")
    o->features = static_cast<int>(value);
  else
    return false;
  return true;
}

double thread_cpu_ms() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) * 1e3 + static_cast<double>(t.tv_nsec) * 1e-6;
}

double degrees(double rad) {
  return rad * 180.0 / M_PI;
}

int run(int argc, char** argv) {
  if (argc < 2) return usage(argv[0]);
  godwit::vo::InitializerOptions options;
  Sequence s;
  s.folder = argv[1];
  std::size_t every = 0, limit = 60;
  long trace = -1;
  double truth_offset = 0;  // what the truth's clock shows when the pictures' clock shows 0 [s]
  std::vector<std::size_t> offsets;
  for (int i = 2; i < argc; ++i) {
    const std::string a = argv[i];
    if (a == "--every" && i + 1 < argc)
      every = std::strtoul(argv[++i], nullptr, 10);
    else if (a == "--limit" && i + 1 < argc)
      limit = std::strtoul(argv[++i], nullptr, 10);
    else if (a == "--trace" && i + 1 < argc)
      trace = std::strtol(argv[++i], nullptr, 10);
    else if (a == "--truth-offset" && i + 1 < argc)
      truth_offset = std::strtod(argv[++i], nullptr);
    else if (a == "--set" && i + 1 < argc && set(argv[i + 1], &options))
      ++i;
    else if (a.rfind("--", 0) == 0)
      return usage(argv[0]);
    else
      offsets.push_back(std::strtoul(a.c_str(), nullptr, 10));
  }
  for (const auto& row : godwit::bench::read_table(s.folder + "/rgb.txt"))
    if (row.size() >= 2) s.pictures.emplace_back(std::stod(row[0]), row[1]);
  for (const auto& row : godwit::bench::read_table(s.folder + "/groundtruth.txt")) {
    if (row.size() < 8) continue;
    const auto v = [&](std::size_t k) { return std::stod(row[k]); };
    const Eigen::Quaterniond q(v(7), v(4), v(5), v(6));
    s.truth.push_back({v(0), SE3(q.normalized().toRotationMatrix(), Vec3(v(1), v(2), v(3)))});
  }
  if (s.pictures.empty() || s.truth.empty()) {
    std::fprintf(stderr, "%s: rgb.txt or groundtruth.txt is missing or empty\n", s.folder.c_str());
    return 1;
  }
  s.cache.resize(s.pictures.size());
  const YAML::Node y = YAML::LoadFile(s.folder + "/camera.yaml");
  std::array<double, 5> d{};
  for (std::size_t i = 0; i < std::min<std::size_t>(5, y["distortion"].size()); ++i)
    d[i] = y["distortion"][i].as<double>();
  const auto camera =
      godwit::vo::CameraModel::pinhole_radtan(y["width"].as<int>(), y["height"].as<int>(), y["fx"].as<double>(),
                                              y["fy"].as<double>(), y["cx"].as<double>(), y["cy"].as<double>(), d);
  if (!camera.ok()) {
    std::fprintf(stderr, "%s/camera.yaml: %s\n", s.folder.c_str(), camera.error().message.c_str());
    return 1;
  }
  if (trace >= 0) offsets.assign(1, static_cast<std::size_t>(trace));
  if (every > 0)
    for (std::size_t i = 0; i + 20 < s.pictures.size(); i += every) offsets.push_back(i);
  if (offsets.empty()) offsets = {0, 37, 111};

  std::printf("%6s %6s %-12s %-2s %5s %5s %5s %6s %6s %6s %6s %6s %6s | %6s %6s %6s | %6s %6s\n", "offset", "frames",
              "status", "m", "R_H", "trk", "pts", "disp", "par_px", "par_dg", "uncert", "ambig", "noise", "dir_dg",
              "rot_dg", "base_m", "ms_med", "ms_dec");
  godwit::vo::Initializer init(camera.value(), options);
  std::vector<double> all_frames, all_direction, all_rotation, all_waiting, all_deciding;
  int wrong = 0;
  for (std::size_t offset : offsets) {
    init.reset();
    SE3 T_world_ref;
    bool have_truth = false;
    godwit::vo::InitReport r;
    std::vector<double> waiting;
    double ms = 0;
    std::size_t used = 0;
    for (std::size_t i = offset; i < std::min(s.pictures.size(), offset + limit); ++i) {
      const Frame* f = load(&s, i);
      const double t0 = thread_cpu_ms();
      r = init.add_frame(f->pyramid, {});
      ms = thread_cpu_ms() - t0;
      ++used;
      SE3 T_world_cur;
      const bool ok = truth_at(s.truth, f->t + truth_offset, &T_world_cur);
      if (r.status == godwit::vo::InitStatus::kFirstFrame || r.status == godwit::vo::InitStatus::kTracksLost) {
        T_world_ref = T_world_cur;
        have_truth = ok;
      }
      const bool done = r.status == godwit::vo::InitStatus::kDone;
      if (trace >= 0 || done || i + 1 == std::min(s.pictures.size(), offset + limit)) {
        double direction = NAN, rotation = NAN, base = NAN;
        if (have_truth && ok) {
          const SE3 T = T_world_cur.inverse() * T_world_ref;
          base = T.t.norm();
          if (done) {
            direction =
                degrees(std::acos(std::clamp(T.t.normalized().dot(init.T_cur_ref().t.normalized()), -1.0, 1.0)));
            rotation = degrees(godwit::vo::so3_log(T.R.transpose() * init.T_cur_ref().R).norm());
          }
        }
        std::sort(waiting.begin(), waiting.end());
        std::printf(
            "%6zu %6zu %-12s %-2s %5.2f %5d %5d %6.1f %6.2f %6.2f %6.3f %6.2f %6.2f | %6.2f %6.2f %6.3f | %6.2f "
            "%6.2f\n",
            offset, used, name(r.status),
            r.model == godwit::vo::InitModel::kHomography    ? "H"
            : r.model == godwit::vo::InitModel::kFundamental ? "F"
                                                             : "-",
            r.ratio_homography, r.tracks, r.points, r.median_disparity_px, r.parallax_px, r.median_parallax_deg,
            r.depth_uncertainty, r.ambiguity, r.noise_px, direction, rotation, base,
            waiting.empty() ? ms : waiting[waiting.size() / 2], ms);
        if (done) {
          all_frames.push_back(static_cast<double>(used));
          if (std::isfinite(direction)) {
            all_direction.push_back(direction);
            all_rotation.push_back(rotation);
            if (direction > 20.0) ++wrong;
          }
          all_deciding.push_back(ms);
        }
      }
      if (done) break;
      waiting.push_back(ms);
      all_waiting.push_back(ms);
    }
  }
  const auto line = [](const char* what, std::vector<double> v) {
    if (v.empty()) return;
    std::sort(v.begin(), v.end());
    const auto at = [&](double q) { return v[static_cast<std::size_t>(q * static_cast<double>(v.size() - 1))]; };
    std::printf("%-24s n %4zu  median %7.3f  p90 %7.3f  p95 %7.3f  max %7.3f\n", what, v.size(), at(0.5), at(0.9),
                at(0.95), v.back());
  };
  std::printf("%zu starts, direction wrong by more than 20 deg: %d\n", offsets.size(), wrong);
  line("frames to the map", all_frames);
  line("direction error [deg]", all_direction);
  line("rotation error [deg]", all_rotation);
  line("waiting frame [ms]", all_waiting);
  line("deciding frame [ms]", all_deciding);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  return godwit::bench::last_catch("godwit-init-survey", run, argc, argv);
}
