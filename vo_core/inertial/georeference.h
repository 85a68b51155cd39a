// Where north is and where the navigation frame began, from satellites while they last: the frame's turn about the
// vertical and its place in the receiver's local frame. Nothing of it goes into the frame itself.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
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
  /// time: a first-order Gauss-Markov process of this time, and so much of its sigma as white noise. Not measured: the
  /// simulator's is the same; real ones are said to be slower (minutes), which makes ways surer than they count here.
  rt::TimeNs wander_ns = 30 * rt::kNsPerSecond;
  double white_share = 0.3;
  /// Its velocity, by Doppler shift, is smoothed by the receiver: one in so long is new. Beside that it has an error of
  /// this sigma that wanders as the place's does: in steady flight a wrong heading. Not measured: what a data sheet
  /// (u-blox NEO-M8) says of the whole, once more.
  rt::TimeNs velocity_ns = rt::kNsPerSecond;
  double velocity_bias_m_s = 0.05;
  double least_velocity_sigma_m_s = 0.05, least_place_sigma_m = 0.3;  ///< whoever says less is not believed
  /// What a receiver's stamps are late by and nobody says: one sigma of what stays the same, which in a steady turn is
  /// a wrong heading for as long as the turn lasts. Not measured: ArduPilot reckons with 0.12 s for u-blox 7 and later,
  /// with 0.22 for older ones. And of what is new with each fix.
  double lag_s = 0.15, jitter_s = 0.1;
  double arm_m = 0.15;             ///< antenna from camera: nobody says where it sits
  double begin_sigma_rad = 0.2;    ///< a first heading is worth something from here on: then a linear filter goes on
  double known_sigma_rad = 0.035;  ///< and it is told from here on: two degrees, what a good compass is worth
  /// Once known it moves no further than this, in its sigmas then and what vision strayed by since: who turns it on has
  /// a receiver that lies, however slowly.
  double most_moved = 3;
  double contradicted_s = 5;  ///< fixes that contradict it for so long are not heard until they agree with it again
  double level_limit2 = 13.8, height_limit2 = 10.8;  ///< sigmas squared, 2 and 1 degrees of freedom: one in 1,000
  /// A navigation frame that had to begin anew goes on where the last one ended, and is told as sure as this
  /// (NavigationOptions::broken_*). It may have turned further: fixes that agree among themselves are believed then.
  double broken_sigma_m = 5, broken_heading_rad = 0.35;
  rt::TimeNs gap_ns = 300 * rt::kNsPerMs;  ///< places between pictures further apart are not known
};

/// Extended Kalman filter of heading, place, what the receiver's place and velocity are off by for a while, and how
/// late its stamps are. What vision strays by between two fixes, by its own covariance, is the process noise: where
/// satellites end the heading stays and becomes less sure as the frame itself does. A heading that was known is never
/// given up for another: fixes that contradict it for long begin one beside it, which is taken over only where it
/// agrees with the one held. One thread; fixes and places each in the order of their times; no allocation.
class Georeference {
 public:
  explicit Georeference(const GeoreferenceOptions& options = {}) : options_(options) {}

  /// Kept until places around its time are known; the oldest makes room. False: no number, absurd, out of order, or far
  /// ahead of the pictures; it is passed over.
  bool take(const SatelliteFix& fix);
  void pose(const NavigatedPlace& place);
  /// The frame's last pose was corrected: by so much less is known how the frame lies.
  void corrected(double turned_rad, double moved_m);

  /// The heading was known to known_sigma_rad once. From then on it is told, with what sigma it has.
  bool known() const { return known_; }
  /// Fixes contradict it, or did and have not agreed with it since: what was known is told.
  bool held() const { return suspended_; }
  /// The frame began anew and nothing has shown since how far it turned.
  bool broken() const { return broken_; }
  double heading() const { return state().heading; }  ///< of the frame's x axis, from east towards north [rad]
  /// With the last picture: what vision strayed by since the last fix is in it.
  double heading_sigma() const;
  /// Of the frame, where the receiver has it.
  Vec3 origin_m() const { return state().place - turn_of(state().heading) * state().reference; }
  /// One sigma of an axis, of where the receiver has the camera, with the last picture [m].
  double place_sigma_m() const;
  std::uint64_t used() const { return used_; }
  std::uint64_t refused() const { return refused_; }    ///< beyond the limits, in part at least
  std::uint64_t given_up() const { return given_up_; }  ///< how often they contradicted for long

 private:
  enum : Eigen::Index { kHeading = 0, kPlace = 1, kWander = 4, kDrift = 7, kLag = 9, kSize = 10 };
  using MatN = Eigen::Matrix<double, kSize, kSize>;
  using StateVec = Eigen::Matrix<double, kSize, 1>;
  template <int N>
  using Rows = Eigen::Matrix<double, N, kSize>;
  /// What is known with one fix.
  struct State {
    bool begun = false;
    double heading = 0;
    Vec3 place = Vec3::Zero();      ///< of reference, where the receiver has it
    Vec3 reference = Vec3::Zero();  ///< in the navigation frame: where the camera was
    Vec3 wander = Vec3::Zero();     ///< of the receiver's place
    Vec2 drift = Vec2::Zero();      ///< of its velocity [m/s]
    double lag = 0;                 ///< of its stamps [s]
    MatN P = MatN::Zero();
    NavigatedPlace last;
  };
  /// Where the camera was at a fix, and how it moved [rad/s]; the acceleration [m/s^2] is the mean of the time before
  /// it.
  struct Moment {
    NavigatedPlace at;
    double turn_rate = 0;
    Vec3 acceleration = Vec3::Zero();
  };

  static Mat3 turn_of(double heading) { return so3_exp(Vec3(0, 0, heading)); }
  const State& state() const { return suspended_ ? held_ : x_; }
  /// False: no two places are near enough around that time.
  bool moment_at(rt::TimeNs t_ns, Moment* out) const;
  void new_frame(const NavigatedPlace& place);
  void hear(const SatelliteFix& fix, const Moment& m);
  bool begin(const SatelliteFix& fix, const Moment& m, double velocity_variance);
  void begin_at(const SatelliteFix& fix, const Moment& m, double heading, double variance, bool by_speed);
  void advance(const SatelliteFix& fix, const NavigatedPlace& at);
  /// Of what is new in each place told.
  double white_variance(const SatelliteFix& fix, const NavigatedPlace& at) const;
  template <int N>
  bool update(const Eigen::Matrix<double, N, 1>& innovation, const Rows<N>& H, double variance, double limit2);
  bool weigh(const SatelliteFix& fix, const Moment& m, double velocity_variance);
  /// Of the heading as it was first known.
  bool within_reach(double heading) const;
  void suspend(const State& held);
  void take_over_if_it_agrees();
  void know();
  double seen_variance(const State& s, double NavigatedPlace::*variance) const {
    return place_count_ > 0 ? std::max(0.0, places_[place_count_ - 1].*variance - s.last.*variance) : 0;
  }

  const GeoreferenceOptions options_;
  static constexpr std::size_t kWaiting = 16, kPlaces = 64;
  std::array<SatelliteFix, kWaiting> waiting_;
  std::size_t waiting_count_ = 0;
  rt::TimeNs t_fix_ns_ = 0;                     ///< of the last one taken
  std::array<NavigatedPlace, kPlaces> places_;  ///< of the last pictures in this frame, oldest first
  std::size_t place_count_ = 0;
  std::uint32_t frame_id_ = 0;

  bool known_ = false;
  bool broken_ = false;  ///< the frame began anew since: how far it turned meanwhile nobody knows
  State x_;
  bool suspended_ = false;  ///< held_ is told, and x_ has to agree with it first
  State held_;
  State first_known_;            ///< when the heading became known
  double strayed_variance_ = 0;  ///< what vision's heading strayed by since then [rad^2]
  bool first_set_ = false;
  SatelliteFix first_;  ///< what a way is measured from, until the heading has begun
  NavigatedPlace first_place_;
  rt::TimeNs t_heard_ns_ = 0;         ///< of the last fix that was compared
  rt::TimeNs t_contradicted_ns_ = 0;  ///< of the first one in a row that did not fit; 0: the last one did
  std::uint64_t used_ = 0, refused_ = 0, given_up_ = 0;
};

}  // namespace godwit::vo
