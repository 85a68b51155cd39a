#include "firmware_app/config/link_settings.h"

#include <Eigen/SVD>
#include <cmath>

#include "firmware_app/config/version.h"

namespace godwit::app {
namespace {

using Matrix4 = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

Eigen::Matrix3d nearest_rotation(const Eigen::Matrix3d& R) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(R, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return svd.matrixU() * svd.matrixV().transpose();
}

}  // namespace

bool wants_link(const Config& config) {
  return !config.can.bus.empty() || !config.link.mavlink.empty();
}

link::LinkSettings link_settings(const Config& config, const std::optional<std::array<double, 16>>& T_body_cam) {
  using link::Parameter;
  link::LinkSettings s;
  s.link.identity.software_major = major_of(version());
  s.link.identity.software_minor = minor_of(version());
  s.link.identity.vcs_commit = vcs_commit(version());
  s.can = config.can.bus;
  s.mavlink = config.link.mavlink;
  s.state_folder = config.link.state_folder;
  const auto set = [&](Parameter p, std::int64_t value) { s.link.parameters[static_cast<std::size_t>(p)] = value; };
  set(Parameter::kRate, config.link.rate);
  set(Parameter::kNodeId, config.can.node_id);
  set(Parameter::kSystemId, config.link.system_id);
  set(Parameter::kProfile, config.link.profile == Config::Link::Profile::kPx4 ? 1 : 0);
  set(Parameter::kAutopilotNode, config.can.autopilot_node);
  set(Parameter::kSerialIndex, config.can.serial_index);
  set(Parameter::kBaudRate, config.can.baud_rate);
  set(Parameter::kCanFd, config.can.fd ? 1 : 0);
  set(Parameter::kTelemetryRate, config.can.telemetry_rate);
  set(Parameter::kTelemetryBase, config.can.telemetry_base);
  set(Parameter::kTelemetryFd, config.can.telemetry_fd ? 1 : 0);
  set(Parameter::kRequirePose, config.link.arming == Config::Link::Arming::kRequirePose ? 1 : 0);

  s.link.write_rules.locked = config.can.lock_parameters;
  for (const int node : config.can.writers) {
    s.link.write_rules.only_nodes.push_back(static_cast<std::uint8_t>(node));
  }

  link::OdometryConfig& odometry = s.link.odometry;
  if (!config.link.T_body_cam.empty() || T_body_cam.has_value()) {
    const double* numbers = config.link.T_body_cam.empty() ? T_body_cam->data() : config.link.T_body_cam.data();
    const Eigen::Map<const Matrix4> T(numbers);
    odometry.R_body_cam = nearest_rotation(T.topLeftCorner<3, 3>());
    odometry.t_body_cam = T.topRightCorner<3, 1>();
  }
  odometry.world_heading_rad = config.link.world_heading_deg * M_PI / 180;
  odometry.north = config.link.north_by_satellites;
  odometry.bench_metric = config.link.bench_metric;
  odometry.inertial = config.imu.flown_by();
  s.link.imu_required = config.imu.flown_by();
  s.between_pictures = config.link.between_pictures;
  if (!config.link.origin.empty()) {
    s.link.mavlink.origin =
        link::mavlink::GlobalOrigin{config.link.origin[0], config.link.origin[1], config.link.origin[2]};
  }
  return s;
}

}  // namespace godwit::app
