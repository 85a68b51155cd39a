#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fmt/format.h>

#include "firmware_app/commands/record_command.h"
#include "firmware_app/commands/stopped.h"
#include "firmware_app/program/exit_code.h"
#if GODWIT_CALIBRATES_CAMERAS
#include "firmware_app/calibration/camera_calibrator.h"
#include "firmware_app/flight/devices.h"
#include "hal/atomic_file.h"
#include "hal/camera/calibration_toml.h"
#include "hal/camera/replay/picture_file.h"
#endif

namespace godwit::app {
namespace {

#if GODWIT_CALIBRATES_CAMERAS

namespace fs = std::filesystem;
/// Two pictures further apart do not tell how the camera moved between them.
constexpr double kMostGapS = 0.15;
/// A live look ends by itself when so much was seen.
constexpr double kEnoughCoverage = 0.95;
constexpr std::size_t kEnoughViews = 200;

struct Seen {
  int width = 0, height = 0;
  std::size_t pictures = 0;
  std::vector<BoardView> views;
  Coverage coverage;

  void add(const Board& board, const rt::ImageView& grey, rt::TimeNs t_ns, const std::string& name) {
    ++pictures;
    BoardView view{t_ns, name, find_board(board, grey)};
    if (view.points.empty()) return;
    coverage.add(view, grey.width, grey.height);
    views.push_back(std::move(view));
  }
  void tell(const char* end) const {
    fmt::print(stderr, "\r{} pictures, the board in {}, {:.0f} % of the picture covered {}", pictures, views.size(),
               100 * coverage.share(), end);
  }
};

/// EuRoC names its pictures by their times in nanoseconds.
rt::TimeNs time_of(const std::string& name) {
  const bool digits =
      name.size() >= 15 && std::all_of(name.begin(), name.end(), [](char c) { return c >= '0' && c <= '9'; });
  return digits ? std::strtoll(name.c_str(), nullptr, 10) : 0;
}

rt::Result<Seen> look_into(const std::string& folder, const Board& board, const std::atomic<bool>& stop) {
  fs::path from = folder;
  for (const char* below : {"mav0/cam0/data", "cam0/data", "rgb"}) {
    std::error_code none;
    if (fs::is_directory(from / below, none)) from /= below;
  }
  std::error_code failed;
  std::vector<fs::path> files;
  for (fs::directory_iterator at(from, failed), end; !failed && at != end; at.increment(failed)) {
    const std::string kind = at->path().extension();
    if (kind == ".png" || kind == ".jpg" || kind == ".jpeg") files.push_back(at->path());
  }
  if (failed) return rt::Error{from.string() + ": " + failed.message()};
  std::sort(files.begin(), files.end());
  Seen out;
  hal::PictureDecoder decoder;
  std::vector<std::uint8_t> pixels;
  for (const fs::path& file : files) {
    if (stop.load(std::memory_order_relaxed)) break;
    if (auto loaded = decoder.load(file); !loaded) {
      fmt::print(stderr, "\ngodwit: left out: {}\n", loaded.error().message);
      continue;
    }
    if (out.width == 0) {
      out.width = decoder.width();
      out.height = decoder.height();
      pixels.resize(out.width * out.height);
    }
    if (decoder.width() != out.width || decoder.height() != out.height) {
      return rt::Error{fmt::format("{} has another size than the pictures before it", file.string())};
    }
    const rt::MutableImageView grey{pixels.data(), out.width, out.height, out.width};
    decoder.write_grey(grey);
    out.add(board, grey, time_of(file.stem()), file.filename());
    out.tell("");
  }
  out.tell("\n");
  if (files.empty()) return rt::Error{from.string() + ": no PNG or JPEG is there"};
  return out;
}

rt::Result<Seen> look_live(const CalibrateArguments& arguments, const Board& board, const std::atomic<bool>& stop) {
  const auto& a = arguments.camera;
  if (a.config.empty() || a.size.empty()) {
    return rt::Error{"a folder of pictures, or --config and --size for the live camera, is needed"};
  }
  Seen out;
  char* end = nullptr;
  out.width = static_cast<int>(std::strtol(a.size.c_str(), &end, 10));
  if (*end == 'x') out.height = static_cast<int>(std::strtol(end + 1, &end, 10));
  if (*end != '\0' || out.width < 64 || out.height < 48 || out.width > rt::kMaxImageWidth ||
      out.height > rt::kMaxImageHeight) {
    return rt::Error{"--size: WIDTHxHEIGHT such as 640x480 is allowed"};
  }
  const ConfigReport report = load_config(a.config);
  if (!report.ok()) return rt::Error{report.mistakes.front()};
  auto opened = open_camera_of_size(report.config.camera, out.width, out.height, report.config.threads.camera,
                                    [](const std::string& text) { fmt::print(stderr, "\ngodwit: {}\n", text); });
  if (!opened) return opened.error();
  hal::Camera& camera = *opened.value();
  std::vector<std::uint8_t> pixels(out.width * out.height);
  const rt::MutableImageView grey{pixels.data(), out.width, out.height, out.width};
  const rt::TimeNs until = a.seconds > 0 ? rt::monotonic_now_ns() + static_cast<rt::TimeNs>(a.seconds * 1e9) : 0;
  std::string why;
  while (!stop.load(std::memory_order_relaxed) && (until == 0 || rt::monotonic_now_ns() < until)) {
    hal::CapturedFrame frame;
    const auto status = camera.next(grey, nullptr, 100 * rt::kNsPerMs, &frame, &why);
    if (status == hal::CameraStatus::kEnd) break;
    if (status != hal::CameraStatus::kFrame) continue;
    out.add(board, grey, frame.t_capture_ns, fmt::format("picture {}", frame.sequence));
    out.tell("");
    if (until == 0 && out.coverage.share() >= kEnoughCoverage && out.views.size() >= kEnoughViews) break;
  }
  out.tell("\n");
  return out;
}

std::string report(const CalibratedCamera& c) {
  const hal::CameraCalibration& k = c.calibration;
  std::string out = fmt::format(
      "{} pictures, {} points ({} left out); reprojection error {:.3f} pixels, {:.3f} in the worst picture ({})\n"
      "focal length {:.3f} {:.3f}, centre {:.3f} {:.3f}; the halves differ by {:.3f} %; tilted by up to {:.0f} "
      "degrees\n"
      "seen where (# enough, : little, . not):\n",
      c.pictures, c.points, c.points_left_out, c.rms_px, c.worst_picture_px, c.worst_picture, k.fx, k.fy, k.cx, k.cy,
      100 * c.halves_differ, c.most_tilt_deg);
  for (const std::string& line : c.coverage.drawing()) out += "  " + line + "\n";
  return out;
}

std::string readout_text(const std::optional<Readout>& readout, double fps, hal::CameraCalibration* c) {
  if (!readout) return "readout: the motion does not show it\n";
  const bool rolling = readout->rolling();
  if (rolling && fps > 0) {
    c->fps = fps;
    c->readout_frames = std::min(1.0, readout->seconds * fps);
  }
  return fmt::format("readout: {:.2f} ms, give or take {:.2f}, by {} pictures: a {} shutter{}\n",
                     1e3 * readout->seconds, 1e3 * readout->sigma_s, readout->pictures, rolling ? "rolling" : "global",
                     rolling && !(fps > 0) ? "; with --fps it is written into the file" : "");
}

#endif

}  // namespace

#if GODWIT_CALIBRATES_CAMERAS

int run_calibrate_camera(const CalibrateArguments& arguments, const std::atomic<bool>& stop) {
  const auto& a = arguments.camera;
  const auto board = parse_board(a.board);
  if (!board) return stopped(board.error().message, kExitRefused);
  const auto seen =
      a.folder.empty() ? look_live(arguments, board.value(), stop) : look_into(a.folder, board.value(), stop);
  if (!seen) return stopped(seen.error().message, kExitRefused);
  const Seen& s = seen.value();
  using Distortion = hal::CameraCalibration::Distortion;
  fmt::print(stderr, "calibrating ..\n");
  auto done =
      calibrate_camera_and_readout(board.value(), s.views, s.width, s.height,
                                   a.model == "radtan" ? Distortion::kRadTan : Distortion::kKannalaBrandt4, kMostGapS);
  if (!done) return stopped(done.error().message, kExitFailed);
  CalibratedCamera& c = done.value().camera;
  std::string text = report(c);
  text += readout_text(done.value().readout, a.fps, &c.calibration);
  const auto wrong = verdict(c);
  text += wrong.empty() ? "verdict: good\n" : "verdict: not good enough to fly\n";
  for (const std::string& reason : wrong) text += "  " + reason + "\n";
  fmt::print("{}", text);
  if (!a.out.empty()) {
    std::string comment = "# godwit calibrate camera, board " + a.board + "\n";
    for (std::size_t at = 0; at < text.size();) {
      const std::size_t end = text.find('\n', at);
      comment += "# " + text.substr(at, end - at) + "\n";
      at = end + 1;
    }
    hal::AtomicFile file;
    auto written = file.open(a.out);
    if (written) written = file.write(hal::calibration_toml(c.calibration, comment));
    if (written) written = file.commit();
    if (!written) return stopped(written.error().message, kExitFailed);
    fmt::print("{}\n", a.out);
  }
  return wrong.empty() ? kExitDone : kExitFailed;
}

#else

int run_calibrate_camera(const CalibrateArguments& /*arguments*/, const std::atomic<bool>& /*stop*/) {
  return stopped(
      "this build cannot calibrate cameras: it was made without OpenCV's calib3d and aruco. Record the board with "
      "godwit "
      "record, and calibrate on a computer that has them (Debian's libopencv-dev)",
      kExitRefused);
}

#endif

}  // namespace godwit::app
