// Which way is up in vision's map, where no inertial sensor of our own tells it: by somebody who flies along and has
// his own vertical, as an autopilot does. His heading is not asked for.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "vo_core/geometry/geometry.h"
#include "vo_core/inertial/map_correction.h"

namespace godwit::vo {

/// The attitude of the body without its heading, which may have come from us.
struct AttitudeReading {
  rt::TimeNs t_ns = 0;
  Vec3 up = Vec3::Zero();  ///< against gravity, along the body's axes, unit length
  /// What the source is off by, one sigma of an axis. Neighbours share it: it does not become less over many.
  double sigma_rad = 0;
};

struct MapVerticalOptions {
  /// How the camera sits on the source's body, one sigma of an axis: screwed on and levelled by hand, half a degree.
  double mounting_sigma_rad = 0.01;
  /// The mean is over so long: longer than the source's errors last (it leans in a turn or a long acceleration, some
  /// ten seconds), or each would lean the whole way flown.
  rt::TimeNs memory_ns = 60 * rt::kNsPerSecond;
  /// With fewer readings, over less time, nothing is known.
  std::uint64_t first = 8;
  rt::TimeNs first_ns = 500 * rt::kNsPerMs;
  double limit2 = 18.4;                    ///< sigmas squared, two degrees of freedom: by chance one in 10,000
  double time_sigma_s = 0.02;              ///< when it was measured is known to this: turning, that is an angle
  rt::TimeNs gap_ns = 300 * rt::kNsPerMs;  ///< attitudes between poses further apart are not known
  /// What contradicts for so long is not heard for as long as silent_ns, and nothing is known any more.
  rt::TimeNs contradicted_ns = 2 * rt::kNsPerSecond;
  rt::TimeNs silent_ns = 30 * rt::kNsPerSecond;
  double walk = 2e-4;  ///< of the map's vertical where the tracker says zero [rad/sqrt(s)]
};

/// One thread; readings in the order of their times, poses in the order of theirs, both in one clock. No allocation.
class MapVertical {
 public:
  MapVertical(const Mat3& R_body_cam, const MapVerticalOptions& options = {})
      : options_(options), R_cam_body_(R_body_cam.transpose()) {}

  /// Kept until the poses around its time have come. False: no number, no direction, out of order, or no room; it is
  /// passed over.
  bool take(const AttitudeReading& reading);
  /// stray_rate: how fast the map's rotation strays there [rad^2/s, an axis].
  void pose(rt::TimeNs t_ns, std::uint32_t map_id, const Mat3& R_map_cam, double stray_rate);
  /// The map was corrected. Attitudes seen while vision strayed turn by their share of it, those before stay, and the
  /// mean by what those weigh in it.
  void correct_map(const MapCorrection& correction);

  /// The rest means something.
  bool known() const { return count_ >= options_.first && t_heard_ns_ - t_first_ns_ >= options_.first_ns; }
  const Vec3& up() const { return up_; }     ///< along the map's axes, unit length
  double sigma_rad() const;                  ///< of an axis
  bool heard() const { return heard_ > 0; }  ///< ever, in any map
  /// The source contradicted the map and is not heard now.
  bool distrusted() const { return t_pose_ns_ < t_silent_until_ns_; }
  std::uint64_t contradictions() const { return contradictions_; }
  std::uint64_t given_up() const { return given_up_; }

 private:
  struct Place {
    rt::TimeNs t_ns = 0;
    Mat3 R_map_cam = Mat3::Identity();
  };
  /// What a reading weighs in the mean.
  struct Heard {
    rt::TimeNs t_ns = 0;
    double weight = 0;
  };
  /// Of readings as many as a correction reaches back over at 50 a second, and some: an autopilot's fastest.
  static constexpr std::size_t kWaiting = 32, kPlaces = 32, kHeard = 64;

  void forget();
  /// False: the poses around that time are missing.
  bool camera_at(rt::TimeNs t_ns, Mat3* R_map_cam, double* rate_rad_s) const;
  void hear(const AttitudeReading& reading, const Vec3& up, double rate_rad_s);

  const MapVerticalOptions options_;
  const Mat3 R_cam_body_;
  std::array<AttitudeReading, kWaiting> waiting_;
  std::size_t waiting_count_ = 0;
  std::array<Place, kPlaces> places_;  ///< of the last poses of this map, oldest first
  std::size_t place_count_ = 0;
  std::uint32_t map_id_ = 0;
  std::array<Heard, kHeard> recent_;  ///< the last of those in the mean, a ring: count_ is behind the newest
  Vec3 up_ = Vec3::Zero();
  double source_variance_ = 0;  ///< mean of the readings'
  double stray_rate_ = 0;
  std::uint64_t count_ = 0, heard_ = 0, contradictions_ = 0, given_up_ = 0;
  rt::TimeNs t_read_ns_ = 0, t_first_ns_ = 0, t_heard_ns_ = 0, t_pose_ns_ = 0;
  rt::TimeNs t_contradicted_ns_ = 0;  ///< since then each reading did; 0: the last one fitted
  rt::TimeNs t_silent_until_ns_ = 0;
};

}  // namespace godwit::vo
