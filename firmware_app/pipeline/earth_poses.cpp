#include "firmware_app/pipeline/earth_poses.h"

#include <Eigen/Geometry>

namespace godwit::app {
namespace {

/// Places by dead reckoning alone are not compared: what they stray by is not what vision strays by.
vo::NavigatedPlace place_of(const FrameRecord& r) {
  vo::NavigatedPlace p;
  p.t_ns = r.t_capture_ns;
  p.frame_id = r.frame_id;
  p.T_nav_cam.R = Eigen::Quaterniond(r.q_world_cam[3], r.q_world_cam[0], r.q_world_cam[1], r.q_world_cam[2])
                      .normalized()
                      .toRotationMatrix();
  p.T_nav_cam.t = Eigen::Vector3d(r.t_world_cam.data());
  p.velocity_m_s = Eigen::Vector3d(r.velocity.data());
  // Along the camera's axes; upper triangle by rows.
  const auto& c = r.covariance;
  p.place_variance = (c[0] + c[6] + c[11]) / 3;
  const vo::Mat3 turns{{c[15], c[16], c[17]}, {c[16], c[18], c[19]}, {c[17], c[19], c[20]}};
  p.heading_variance = (p.T_nav_cam.R * turns * p.T_nav_cam.R.transpose())(2, 2);
  p.velocity_variance = (r.velocity_covariance[0] + r.velocity_covariance[3] + r.velocity_covariance[5]) / 3;
  return p;
}

}  // namespace

void EarthPoses::take(const hal::AidSample& s) {
  if (s.kind != hal::AidKind::kSatellites) return;
  ++fixes_;
  georeference_.take(
      {s.t_ns, Eigen::Vector3d(s.value.data()), s.sigma, Eigen::Vector2d(s.velocity.data()), s.velocity_sigma});
}

void EarthPoses::tell(FrameRecord* record) {
  if (!record->metric) return;
  if (record->map_moved) {
    const Eigen::Map<const Eigen::Vector3d> moved(record->moved_by.data());
    georeference_.corrected(record->turned_by[2], moved.norm());
  }
  if (record->tracked) georeference_.pose(place_of(*record));
  EarthRecord& earth = record->earth;
  earth.known = georeference_.known();
  earth.held = georeference_.held();
  earth.broken = georeference_.broken();
  earth.fixes = fixes_;
  earth.fixes_used = static_cast<std::uint32_t>(georeference_.used());
  earth.fixes_refused = static_cast<std::uint32_t>(georeference_.refused());
  if (!earth.known) return;
  earth.heading = georeference_.heading();
  earth.heading_sigma = georeference_.heading_sigma();
  Eigen::Map<Eigen::Vector3d>(earth.origin_m.data()) = georeference_.origin_m();
  earth.place_sigma_m = georeference_.place_sigma_m();
}

}  // namespace godwit::app
