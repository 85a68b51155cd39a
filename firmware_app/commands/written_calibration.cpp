#include "firmware_app/commands/written_calibration.h"

#include <cmath>
#include <fmt/format.h>

#include "hal/atomic_file.h"
#include "hal/camera/calibration_toml.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::app {
namespace {

/// Fewer and it is no measurement: as FrameRecord::tracked, which with an inertial sensor says more.
constexpr std::int32_t kLeastFeatures = 30;
/// Vision errs in a turn by as much whether it takes one picture or four; what a time offset does to it grows with
/// them.
constexpr rt::TimeNs kSpanNs = 140 * rt::kNsPerMs;
/// More than this the written file says with the figures.
constexpr double kSureTurnRad = 0.003, kSureTimeS = 1e-3;

bool seen(const FrameRecord& r) {
  return r.fate == FrameFate::kProcessed && r.reference_id != 0 && r.features >= kLeastFeatures && !r.repeated;
}

Eigen::Matrix3d rotation(const std::array<double, 16>& T) {
  Eigen::Matrix3d out;
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) out(row, column) = T[4 * row + column];
  }
  return out;
}

}  // namespace

rt::Result<void> TurnListener::take(const FrameRecord& r) {
  if (!seen(r) || r.map_id != map_id_ || r.reference_id != reference_id_) moments_.clear();
  if (!seen(r)) return {};
  map_id_ = r.map_id;
  reference_id_ = r.reference_id;
  while (!moments_.empty() && r.t_source_ns - moments_.front().t_ns > kSpanNs) moments_.pop_front();
  const Eigen::Quaterniond turn = Eigen::Quaterniond(Eigen::Vector4d(r.q_ref_cam.data())).normalized();
  if (!moments_.empty() && r.t_source_ns > moments_.back().t_ns) {
    const Moment& from = moments_.front();
    turns_.push_back({from.t_ns, r.t_source_ns, (from.turn.conjugate() * turn).toRotationMatrix()});
  }
  moments_.push_back({r.t_source_ns, turn});
  return {};
}

rt::Result<void> write_camera_imu(const std::string& file, const hal::CameraCalibration& calibration,
                                  const std::vector<SeenTurn>& turns, const std::vector<hal::ImuSample>& readings) {
  const auto fitted = fit_camera_imu(turns, readings);
  if (!fitted) return fitted.error();
  const CameraImuFit& fit = fitted.value();
  constexpr double kDeg = 180 / M_PI;
  std::string text = fmt::format(
      "camera and IMU, by {} turns ({} left out), {:.2f} mrad each: time offset {:+.2f} ms, give or take "
      "{:.2f}; rotation give or take {:.3f} degrees\n",
      fit.turns, fit.turns_left_out, 1e3 * fit.rms_rad, 1e3 * fit.time_offset_s, 1e3 * fit.time_sigma_s,
      kDeg * fit.turn_sigma_rad);
  if (calibration.T_body_cam) {
    const double off = vo::so3_log(rotation(*calibration.T_body_cam).transpose() * fit.R_body_cam).norm();
    text += fmt::format("the rotation differs by {:.2f} degrees from that of the sequence's calibration\n", kDeg * off);
  } else {
    text += "where the camera sits on the IMU is not known: 0 0 0 is written; measure it by ruler\n";
  }
  if (fit.turn_sigma_rad > kSureTurnRad || fit.time_sigma_s > kSureTimeS) {
    text += "not certain enough to fly by: turn the camera more, about all three axes\n";
  }
  hal::CameraCalibration out = calibration;
  std::array<double, 16> T =
      out.T_body_cam.value_or(std::array<double, 16>{0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1});
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) T[4 * row + column] = fit.R_body_cam(row, column);
  }
  out.T_body_cam = T;
  out.time_offset_s = fit.time_offset_s;
  std::string comment = "# godwit replay --write-calibration\n";
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = text.find('\n', at);
    comment += "# " + text.substr(at, end - at) + "\n";
    at = end + 1;
  }
  hal::AtomicFile to;
  if (auto r = to.open(file); !r) return r;
  if (auto r = to.write(hal::calibration_toml(out, comment)); !r) return r;
  if (auto r = to.commit(); !r) return r;
  fmt::print("{}{}\n", text, file);
  return {};
}

}  // namespace godwit::app
