// From what stands beside the camera to readings of the map's scale: which way, climb or height by vision belongs to
// which in metres, and when two of them are far enough apart to tell anything.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "vo_core/geometry/geometry.h"
#include "vo_core/inertial/map_correction.h"
#include "vo_core/inertial/scale_state.h"

namespace godwit::vo {

/// One reading of a sensor that knows metres.
struct AidReading {
  ScaleSource source = ScaleSource::kRange;
  rt::TimeNs t_ns = 0;
  /// Satellites: place in a frame with z up that the source keeps. Barometer: z, height above anything that stays.
  /// Rangefinder: z, distance along the beam. Starting height: z, of the camera above flat ground where the first map
  /// begins; told before it does. [m]
  Vec3 value_m = Vec3::Zero();
  double sigma_m = 0;  ///< one sigma of an axis
};

/// What vision and the inertial sensor know of one picture.
struct AidPose {
  rt::TimeNs t_ns = 0;
  std::uint32_t map_id = 0;
  Vec3 camera = Vec3::Zero();               ///< [map units]
  Vec3 up = Vec3::Zero();                   ///< along the map's axes, unit length; zero: not known
  double up_sigma = 0;                      ///< [rad]
  Vec3 beam = Vec3::Zero();                 ///< the rangefinder's direction along the map's axes, unit length
  double depth = 1;                         ///< of what is seen, median [map units]
  std::span<const Eigen::Vector3f> points;  ///< of the map, some of those that the picture shows [map units]
};

struct ScaleAidsOptions {
  ScaleOptions scale;
  /// What a place of vision is wrong by against another a few metres on: of the depth, and of the way.
  double depth_share = 3e-3, way_share = 5e-3;
  /// A length counts once its sigma is so much of it: at first, and where the scale is known. Short ones tell little
  /// each, but a map that is young has no others.
  double first_share = 0.12, share = 0.05;
  rt::TimeNs longest_ns = 30 * rt::kNsPerSecond;  ///< older moments are not compared with
  /// The air's pressure as a height wanders [m/sqrt(s)]: 20 Pa within five minutes.
  double pressure_walk = 0.13;
  double arm_m = 0.15;  ///< antenna from camera: nobody says where it sits
  /// Height above ground by vision: this quantile of how far below the camera its points lie, lowest last, and what
  /// that is wrong by as a share, one sigma: a bound. In the simulated street it was within 5 % of the true scale.
  double ground_quantile = 0.8, ground_share = 0.1;
  int ground_points = 12;                   ///< with fewer nothing is said
  rt::TimeNs ground_ns = rt::kNsPerSecond;  ///< the same ground is below for a while: one reading in so long
  rt::TimeNs gap_ns = 300 * rt::kNsPerMs;   ///< places between poses further apart are not known
};

/// One thread; readings in the order of their times, poses in the order of theirs. Both in one clock. No allocation.
class ScaleAids {
 public:
  explicit ScaleAids(const ScaleAidsOptions& options = {}) : options_(options), state_(options.scale) {}

  /// Kept until the next pose. One that comes late, as over a bus, is compared with the poses around its own time, as
  /// far as they are kept (kPlaces of them). False: no number, out of order, or no room; it is passed over.
  bool take(const AidReading& reading);
  /// Compares what was read since the last pose.
  void pose(const AidPose& pose);
  /// The map was corrected: places seen while vision strayed move by their share of it, those before stay, so that the
  /// ways between them become those of the corrected map.
  void correct_map(const MapCorrection& correction);

  const ScaleState& state() const { return state_; }

 private:
  /// A moment that a later one of the same source is compared with.
  struct Moment {
    bool set = false;
    rt::TimeNs t_ns = 0;
    Vec3 value_m = Vec3::Zero(), camera = Vec3::Zero();
    double sigma_m = 0;
  };
  struct Place {
    rt::TimeNs t_ns = 0;
    Vec3 camera = Vec3::Zero();
  };
  static constexpr std::size_t kWaiting = 32, kPlaces = 32;

  bool take_start(const AidReading& reading);
  /// How far what the picture shows lies below a place of the camera, by its lowest points [map units]. False: the
  /// vertical is not known, or too few are seen.
  bool height_above_ground(const AidPose& pose, const Vec3& camera, double* units) const;
  void above_start(const AidPose& pose);
  /// Where the camera was; false: no two poses are near enough around that time.
  bool camera_at(rt::TimeNs t_ns, Vec3* camera) const;
  void keep_place(const AidPose& pose);
  void compare(const AidReading& reading, const AidPose& pose, const Vec3& camera);
  bool lengths(const AidReading& reading, const AidPose& pose, const Vec3& camera, const Moment& from,
               ScaleReading* out) const;
  void above_ground(const AidReading& reading, const AidPose& pose, const Vec3& camera);

  const ScaleAidsOptions options_;
  ScaleState state_;
  std::array<AidReading, kWaiting> waiting_;
  std::size_t waiting_count_ = 0;
  std::array<rt::TimeNs, kScaleSources> t_read_ns_{};
  std::array<Moment, kScaleSources> moments_;
  rt::TimeNs t_ground_ns_ = 0;
  /// The configured height above ground, until it was compared; where the first map began.
  Moment start_;
  std::uint32_t map_id_ = 0;
  std::array<Place, kPlaces> places_;  ///< of the last poses of this map, oldest first
  std::size_t place_count_ = 0;
  rt::TimeNs t_told_ns_ = 0;  ///< the newest time that the state knows of
};

}  // namespace godwit::vo
