#include "firmware_app/commands/doctor_imu.h"

#include <Eigen/Core>
#include <cmath>
#include <filesystem>
#include <fmt/format.h>
#include <fstream>
#include <string>
#include <vector>

#include "firmware_app/flight/devices.h"

namespace godwit::app {
namespace {

constexpr rt::TimeNs kListenNs = 1500 * rt::kNsPerMs;
constexpr double kImuRateTolerance = 0.1;
constexpr double kGravity = 9.81, kGravityTolerance = 0.8;  // [m/s^2]
constexpr double kTurning = 0.1;                            // [rad/s]

/// What /sys and /dev show that may be one.
std::string sensors_of(const std::string& root) {
  namespace fs = std::filesystem;
  std::vector<std::string> found;
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator(root + "/sys/bus/iio/devices", ignored)) {
    std::string name;
    std::ifstream(entry.path() / "name") >> name;
    const bool turns = fs::exists(entry.path() / "in_anglvel_x_raw", ignored);
    if (turns) found.push_back("IIO device " + entry.path().filename().string() + " (" + name + ")");
  }
  for (const auto& entry : fs::directory_iterator(root + "/dev", ignored)) {
    const std::string name = entry.path().filename();
    if (name.starts_with("spidev")) found.push_back("SPI port /dev/" + name);
  }
  std::string list;
  for (const std::string& one : found) list += (list.empty() ? "" : ", ") + one;
  return list.empty() ? "none" : list;
}

/// The body's axis along which gravity pulls: the specific force of a body at rest points up.
const char* down_of(const Eigen::Vector3d& force) {
  constexpr const char* kNames[] = {"back", "left", "up", "front", "right", "down"};
  Eigen::Index axis = 0;
  force.cwiseAbs().maxCoeff(&axis);
  return kNames[axis + (force(axis) < 0 ? 3 : 0)];
}

}  // namespace

void judge_imu(const std::string& name, double rate_hz, hal::Imu* imu, DoctorReport* report) {
  int readings = 0, saturated = 0;
  rt::TimeNs first = 0, last = 0;
  Eigen::Vector3d force = Eigen::Vector3d::Zero(), turn = Eigen::Vector3d::Zero();
  const rt::TimeNs give_up = rt::monotonic_now_ns() + kListenNs;
  while (rt::monotonic_now_ns() < give_up) {
    hal::ImuSample s;
    const hal::ImuStatus status = imu->next(&s, 50 * rt::kNsPerMs);
    if (status == hal::ImuStatus::kEnd) break;
    if (status != hal::ImuStatus::kSample) continue;
    if (readings++ == 0) first = s.t_ns;
    last = s.t_ns;
    force += Eigen::Vector3d(s.accel_m_s2.data());
    turn += Eigen::Vector3d(s.gyro_rad_s.data());
    saturated += (s.flags & (hal::kImuGyroSaturated | hal::kImuAccelSaturated)) != 0 ? 1 : 0;
  }
  if (readings < 2) {
    report->wrong(name + ": no readings came within 1.5 s");
    return;
  }
  force /= readings;
  turn /= readings;
  const double rate = last > first ? (readings - 1) / rt::to_seconds(last - first) : 0;
  report->fits(fmt::format("{}: {:.0f} readings a second", name, rate));
  if (rate_hz > 0 && std::abs(rate / rate_hz - 1) > kImuRateTolerance) {
    report->wrong(fmt::format("{}: {:.0f} readings a second, {:.0f} were asked for: set imu.rate_hz to what it gives",
                              name, rate, rate_hz));
  }
  if (saturated > 0) {
    report->wrong(
        fmt::format("{}: {} readings at the end of its range: set imu.gyro_range_deg_s and "
                    "imu.accel_range_g higher",
                    name, saturated));
  }
  if (!(turn.norm() < kTurning)) {
    report->wrong(
        fmt::format("{}: it turns by {:.2f} rad/s: hold it still, or the sensor is off by that", name, turn.norm()));
  } else if (!(std::abs(force.norm() - kGravity) < kGravityTolerance)) {
    report->wrong(fmt::format("{}: gravity is {:.2f} m/s^2 by it, not 9.81: another range or unit than it has", name,
                              force.norm()));
  } else {
    report->fits(
        fmt::format("{}: by it the body's {} is down; if it stands level and that is not \"down\", mend "
                    "imu.axes",
                    name, down_of(force)));
  }
}

void examine_imu(const Config& config, const std::string& root, DoctorReport* report) {
  using Source = Config::Imu::Source;
  const std::string name = "inertial sensor";
  switch (config.imu.source) {
    case Source::kNone:
      report->note(name +
                   ": none is configured (imu.source): poses have no metres, and their quality stays -1; this "
                   "machine has " +
                   sensors_of(root));
      return;
    case Source::kReplay:
    case Source::kSim:
      report->note(name + ": that of the recording or scenario");
      break;
    case Source::kMpu6000:
    case Source::kIio: {
      std::string trouble;
      const auto imu = open_imu(config.imu, [&](const std::string& text) { trouble = text; });
      if (!imu) {
        report->wrong(name + ": " + imu.error().message);
        return;
      }
      if (!trouble.empty()) {
        report->wrong(name + ": " + trouble + "; this machine has " + sensors_of(root));
        return;
      }
      judge_imu(name + " " + config.imu.device, config.imu.rate_hz, imu.value().get(), report);
      break;
    }
  }
  if (!config.imu.enabled) report->note(name + ": watched, not flown by (imu.enabled is false)");
}

}  // namespace godwit::app
