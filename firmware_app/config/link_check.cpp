#include "firmware_app/config/link_check.h"

#include <Eigen/LU>
#include <cmath>
#include <string>

#include "firmware_app/link/byte_port.h"
#include "hal/can/can_bus.h"

namespace godwit::app {
namespace {

using Matrix4 = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

constexpr double kRotationTolerance = 1e-3;  // what was written with four digits will do

/// How far from a rotation.
double rotation_error(const Eigen::Matrix3d& R) {
  if (R.determinant() <= 0) return 1;
  return (R * R.transpose() - Eigen::Matrix3d::Identity()).norm();
}

}  // namespace

void check_link(ConfigReport* report) {
  const Config& c = report->config;
  if (!c.can.bus.empty()) {
    if (const auto r = hal::check_can_address(c.can.bus); !r.ok()) report->mistake("can.bus", r.error().message);
  }
  if (!c.link.mavlink.empty()) {
    if (const auto r = link::check_byte_port_address(c.link.mavlink); !r.ok()) {
      report->mistake("link.mavlink", r.error().message);
    }
  }
  if (c.link.profile == Config::Link::Profile::kPx4 && !c.can.bus.empty() && c.link.mavlink.empty()) {
    report->mistake("link.profile", "PX4 takes no MAVLink through CAN: give it link.mavlink as well");
  }
  if (c.link.between_pictures && !c.imu.flown_by()) {
    report->mistake(
        "link.between_pictures",
        "an inertial sensor carries poses on: with imu.source = \"none\" or imu.enabled = false only false is "
        "allowed");
  }
  if (c.can.node_id == c.can.autopilot_node) {
    report->mistake("can.node_id", std::to_string(c.can.node_id) + " is can.autopilot_node as well");
  }
  if (!c.link.T_body_cam.empty()) {
    const Eigen::Map<const Matrix4> T(c.link.T_body_cam.data());
    const Eigen::Vector4d last = T.row(3).transpose();
    if (rotation_error(T.topLeftCorner<3, 3>()) > kRotationTolerance || last != Eigen::Vector4d(0, 0, 0, 1)) {
      report->mistake("link.T_body_cam",
                      "its first three rows and columns must be a right-handed rotation, its last row 0, 0, 0, 1");
    }
  }
  if (!c.link.origin.empty() && (std::abs(c.link.origin[0]) > 90 || std::abs(c.link.origin[1]) > 180)) {
    report->mistake("link.origin",
                    "latitude, longitude, height: -90 to 90, -180 to 180 degrees and metres are allowed");
  }
}

}  // namespace godwit::app
