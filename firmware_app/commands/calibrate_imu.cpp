#include <algorithm>
#include <cmath>
#include <fmt/format.h>

#include "firmware_app/commands/record_command.h"
#include "firmware_app/program/exit_code.h"
#include "firmware_app/program/numbers.h"
#include "hal/atomic_file.h"
#include "hal/imu/allan.h"
#include "hal/imu/replay/imu_record.h"

namespace godwit::app {
namespace {

/// Both axes by decades: one panel of the plot.
std::string panel(const hal::ImuNoise& noise, std::size_t first, double x0, const char* title) {
  constexpr double kWide = 420, kHigh = 360;
  constexpr const char* kColours[3] = {"#c22", "#282", "#22c"};
  double low_t = 1e9, high_t = 0, low = 1e9, high = 0;
  for (std::size_t a = first; a < first + 3; ++a) {
    for (const hal::AllanPoint& p : noise.points[a]) {
      if (!(p.deviation > 0)) continue;
      low_t = std::min(low_t, p.tau_s);
      high_t = std::max(high_t, p.tau_s);
      low = std::min(low, p.deviation);
      high = std::max(high, p.deviation);
    }
  }
  const double t0 = std::floor(std::log10(low_t)), t1 = std::ceil(std::log10(high_t));
  const double v0 = std::floor(std::log10(low)), v1 = std::ceil(std::log10(high));
  const auto x = [&](double tau) { return x0 + kWide * (std::log10(tau) - t0) / (t1 - t0); };
  const auto y = [&](double v) { return 40 + kHigh * (v1 - std::log10(v)) / (v1 - v0); };
  std::string out = fmt::format("<text x=\"{}\" y=\"24\">{}</text>\n", x0, title);
  for (double d = t0; d <= t1; ++d) {
    const double at = x(std::pow(10, d));
    out += fmt::format("<path d=\"M{:.1f} 40v{}\" stroke=\"#ddd\"/><text x=\"{:.1f}\" y=\"416\">1e{:.0f} s</text>\n",
                       at, kHigh, at, d);
  }
  for (double d = v0; d <= v1; ++d) {
    const double at = y(std::pow(10, d));
    out += fmt::format("<path d=\"M{} {:.1f}h{}\" stroke=\"#ddd\"/><text x=\"{}\" y=\"{:.1f}\">1e{:.0f}</text>\n", x0,
                       at, kWide, x0 - 36, at + 4, d);
  }
  for (std::size_t a = 0; a < 3; ++a) {
    std::string line;
    for (const hal::AllanPoint& p : noise.points[first + a]) {
      if (p.deviation > 0) line += fmt::format("{}{:.1f} {:.1f}", line.empty() ? "M" : "L", x(p.tau_s), y(p.deviation));
    }
    out += fmt::format("<path d=\"{}\" fill=\"none\" stroke=\"{}\"/>\n", line, kColours[a]);
  }
  return out;
}

std::string plot(const hal::ImuNoise& noise) {
  return "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"1000\" height=\"430\" font-family=\"sans-serif\" "
         "font-size=\"12\"><rect width=\"1000\" height=\"430\" fill=\"white\"/>\n" +
         panel(noise, 0, 50, "Allan deviation of the gyroscope [rad/s]: x red, y green, z blue") +
         panel(noise, 3, 550, "of the accelerometer [m/s^2]") + "</svg>\n";
}

rt::Result<void> write(const std::string& file, const std::string& text) {
  hal::AtomicFile out;
  if (auto r = out.open(file); !r) return r;
  if (auto r = out.write(text); !r) return r;
  return out.commit();
}

void tell(const char* what, const hal::NoiseFigures& f, const char* unit) {
  fmt::print("{}: noise density {:.3g} {}/sqrt(Hz), bias instability {:.3g} {}, random walk {:.3g} {}/s/sqrt(Hz)\n",
             what, f.density, unit, f.bias_instability, unit, f.random_walk, unit);
}

}  // namespace

void add_calibrate_command(CLI::App* app, CalibrateArguments* a) {
  CLI::App* const c = app->add_subcommand("calibrate", "Calibrate sensors from recordings");
  c->require_subcommand(1);
  CLI::App* const imu = c->add_subcommand("imu", "Noise figures of an IMU from a recording in which it lies still");
  imu->add_option("RECORDING", a->recording, "Folder of godwit record --no-camera, EuRoC's or TUM's")->required();
  imu->add_option("--out", a->out, "Write Kalibr's imu.yaml")->type_name("FILE");
  imu->add_option("--plot", a->plot, "Write a plot (SVG) of the Allan deviations")->type_name("FILE");
  CLI::App* const camera = c->add_subcommand("camera", "Calibration of a camera from pictures of a board");
  a->camera_command = camera;
  camera->add_option("FOLDER", a->camera.folder, "Pictures (PNG, JPEG), or a recording; without it the live camera");
  camera
      ->add_option("--board", a->camera.board,
                   "aprilgrid:6x6:0.088:0.3 or chessboard:9x6:0.025 (inner corners); metres")
      ->required();
  camera->add_option("--model", a->camera.model, "Of the lens")->check(CLI::IsMember({"radtan", "equidistant"}));
  camera->add_option("--out", a->camera.out, "Write the calibration (TOML)")->type_name("FILE");
  camera->add_option("--config", a->camera.config, "The live camera is that of [camera]")->type_name("FILE");
  camera->add_option("--size", a->camera.size, "Of the live camera's pictures: WIDTHxHEIGHT");
  camera->add_option("--seconds", a->camera.seconds, "How long to look; without it until Ctrl-C or enough was seen")
      ->check(number(1e-3, kLongSeconds));
  camera->add_option("--fps", a->camera.fps, "Pictures a second, where the readout of a rolling shutter is to be told")
      ->check(number(1e-3, kMostFps));
}

int run_calibrate(const CalibrateArguments& a, const std::atomic<bool>& stop) {
  return a.camera_command->parsed() ? run_calibrate_camera(a, stop) : run_calibrate_imu(a);
}

int run_calibrate_imu(const CalibrateArguments& a) {
  const auto failed = [](const std::string& message, ExitCode code) -> int {
    fmt::print(stderr, "godwit: {}\n", message);
    return code;
  };
  const auto record = hal::read_imu_record(a.recording);
  if (!record) return failed(record.error().message, kExitRefused);
  for (const std::string& words : record.value().warnings(a.recording))
    fmt::print(stderr, "godwit: warning: {}\n", words);
  const auto noise = hal::analyse_still(record.value().samples);
  if (!noise) return failed(a.recording + ": " + noise.error().message, kExitRefused);
  const hal::ImuNoise& n = noise.value();
  fmt::print("{:.0f} s at {:.2f} Hz; the worst axis of each:\n", n.seconds, n.rate_hz);
  tell("gyroscope", n.gyro, "rad/s");
  tell("accelerometer", n.accel, "m/s^2");
  if (n.seconds < 3600) {
    fmt::print("shorter than an hour: bias instability and random walk rest on few independent spans\n");
  }
  for (const auto& [file, text] : {std::pair{a.out, hal::imu_yaml(n)}, {a.plot, plot(n)}}) {
    if (file.empty()) continue;
    if (auto r = write(file, text); !r) return failed(r.error().message, kExitFailed);
    fmt::print("{}\n", file);
  }
  return kExitDone;
}

}  // namespace godwit::app
