// Where north is and where the navigation frame began, from satellites while they last: the frame's turn about the
// vertical and its place in the receiver's local frame. Nothing of it goes into the frame itself.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "hal/rt/time.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// What a receiver says of one moment, in a local frame that it keeps: x east, y north, z up.
struct SatelliteFix {
  rt::TimeNs t_ns = 0;
  Vec3 place_m = Vec3::Zero();
  double place_sigma_m = 0;  ///< one sigma of an axis
  Vec2 velocity_m_s = Vec2::Zero();
  double velocity_sigma_m_s = 0;  ///< the same; 0: it does not tell its velocity
};

/// What is told of a picture in the navigation frame.
struct NavigatedPlace {
  rt::TimeNs t_ns = 0;
  std::uint32_t frame_id = 0;
  SE3 T_nav_cam;
  Vec3 velocity_m_s = Vec3::Zero();
  double place_variance = 0;     ///< mean of the axes, since the frame began [m^2]
  double heading_variance = 0;   ///< [rad^2]
  double velocity_variance = 0;  ///< mean of the axes [m^2/s^2]
};

struct GeoreferenceOptions {
  /// A receiver's place errs by what wanders with the sky and with what reflects, and only little of it is new each
  /// time: a first-order Gauss-Markov process of this time, and so much of its sigma as white noise. Slower is said to
  /// be usual (minutes); faster counts ways as less sure than they are.
  rt::TimeNs wander_ns = 30 * rt::kNsPerSecond;
  double white_share = 0.3;
  /// Its velocity, by Doppler shift, is smoothed by the receiver: one in so long is new.
  rt::TimeNs velocity_ns = rt::kNsPerSecond;
  double arm_m = 0.15;             ///< antenna from camera: nobody says where it sits
  double begin_sigma_rad = 0.2;    ///< a first heading is worth something from here on: then a linear filter goes on
  double known_sigma_rad = 0.035;  ///< and it is told from here on: two degrees, what a good compass is worth
  double place_limit2 = 16.3, velocity_limit2 = 13.8;  ///< sigmas squared, 3 and 2 degrees of freedom: one in 1,000
  int contradictions = 25;  ///< so many fixes in a row beyond them: nobody knows who is wrong, it begins anew
  /// A navigation frame that had to begin anew goes on where the last one ended, by no less than this
  /// (NavigationOptions::broken_*).
  double broken_sigma_m = 5, broken_heading_rad = 0.35;
  rt::TimeNs gap_ns = 300 * rt::kNsPerMs;  ///< places between pictures further apart are not known
};

/// Extended Kalman filter of heading, place, and the receiver's wandering error. What vision strays by between two
/// fixes, by its own covariance, is the process noise: where satellites end the heading stays and becomes less sure
/// as the frame itself does. One thread; fixes and places each in the order of their times; no allocation.
class Georeference {
 public:
  explicit Georeference(const GeoreferenceOptions& options = {}) : options_(options) {}

  /// Kept until places around its time are known. False: no number, out of order, or no room; it is passed over.
  bool take(const SatelliteFix& fix);
  void pose(const NavigatedPlace& place);

  /// The heading was known to known_sigma_rad once. From then on it is told, with what sigma it has.
  bool known() const { return known_; }
  double heading() const { return heading_; }  ///< of the frame's x axis, from east towards north [rad]
  double heading_sigma() const { return std::sqrt(P_(kHeading, kHeading)); }
  Vec3 origin_m() const { return place_ - turn() * reference_; }  ///< of the frame, where the receiver has it
  /// One sigma of an axis, of where it has the camera now [m].
  double place_sigma_m() const { return std::sqrt(P_.block<3, 3>(kPlace, kPlace).trace() / 3); }
  std::uint64_t used() const { return used_; }
  std::uint64_t refused() const { return refused_; }    ///< beyond the limits
  std::uint64_t given_up() const { return given_up_; }  ///< how often it began anew for them

 private:
  enum : Eigen::Index { kHeading = 0, kPlace = 1, kWander = 4, kSize = 7 };
  template <int N>
  using Rows = Eigen::Matrix<double, N, kSize>;

  Mat3 turn() const { return so3_exp(Vec3(0, 0, heading_)); }
  /// Where the camera was and how it moved; false: no two places are near enough around that time.
  bool place_at(rt::TimeNs t_ns, NavigatedPlace* out, double* turn_rate) const;
  void hear(const SatelliteFix& fix, const NavigatedPlace& at, double turn_rate);
  bool begin_heading(const SatelliteFix& fix, const NavigatedPlace& at, double velocity_variance);
  void advance(const NavigatedPlace& at);
  /// How far the camera's place there is off by what the receiver says, and what that is made of.
  double white_variance(const SatelliteFix& fix) const;
  template <int N>
  bool update(const Eigen::Matrix<double, N, 1>& innovation, const Rows<N>& H, double variance, double limit2);
  void contradicted();

  const GeoreferenceOptions options_;
  static constexpr std::size_t kWaiting = 16, kPlaces = 32;
  std::array<SatelliteFix, kWaiting> waiting_;
  std::size_t waiting_count_ = 0;
  rt::TimeNs t_fix_ns_ = 0;                     ///< of the last one taken
  std::array<NavigatedPlace, kPlaces> places_;  ///< of the last pictures in this frame, oldest first
  std::size_t place_count_ = 0;
  std::uint32_t frame_id_ = 0;

  bool begun_ = false, known_ = false;
  double heading_ = 0;
  Vec3 place_ = Vec3::Zero();      ///< of reference_, where the receiver has it
  Vec3 reference_ = Vec3::Zero();  ///< in the navigation frame: where the camera was with the last fix
  Vec3 wander_ = Vec3::Zero();
  Eigen::Matrix<double, kSize, kSize> P_ = Eigen::Matrix<double, kSize, kSize>::Zero();
  NavigatedPlace last_;  ///< with the last fix
  bool first_set_ = false;
  SatelliteFix first_;  ///< what a way is measured from, until the heading has begun
  Vec3 first_place_ = Vec3::Zero();
  rt::TimeNs t_velocity_ns_ = 0;
  int contradictions_ = 0;
  std::uint64_t used_ = 0, refused_ = 0, given_up_ = 0;
};

}  // namespace godwit::vo
