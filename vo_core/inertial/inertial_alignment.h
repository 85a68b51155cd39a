// Where a flight begins to know metres and the vertical: from what vision saw over a second or two, and what the
// inertial sensor measured meanwhile. Two closed forms from the literature; InertialSmoother refines what they give.
#pragma once

#include <span>

#include "vo_core/inertial/inertial_smoother.h"

namespace godwit::vo {

enum class AlignmentMethod {
  /// Qin, Li, Shen, "VINS-Mono", TRO 2018, section V-B: a velocity for each moment, gravity and scale by linear least
  /// squares over the steps between neighbours. Accelerometer bias left out.
  kStepwise,
  /// Dong-Si, Mourikis, "Estimator initialization in vision-aided inertial navigation", IROS 2012, and Martinelli, IJCV
  /// 2014, in their manner: one velocity, gravity, scale and the accelerometer's bias, each moment's place against the
  /// first by one long integral.
  kWhole,
};

struct Alignment {
  bool ok = false;
  double log_scale = 0;
  Vec3 up = Vec3::Zero();        ///< along the map's axes, unit length
  Vec3 velocity = Vec3::Zero();  ///< of the body at the first moment, along the map's axes [m/s]
  ImuBias bias;
  double free_gravity_m_s2 = 0;  ///< what gravity's strength came out as before it was set to what it is
};

/// What others say of the scale; sigma 0: nobody does.
struct ScaleHint {
  double log_scale = 0, sigma = 0;
};

/// Bias of the gyroscope by which the turns between neighbours agree with vision's (Qin, equation 15), starting from
/// `start` and held to it by sigma_rad_s. No allocation.
Vec3 align_gyro_bias(std::span<const InertialNode> nodes, const CameraMounting& mounting, const ImuBias& start,
                     double sigma_rad_s, double turn_sigma_rad);

/// Whether vision and gyroscope turn alike.
struct TurnAgreement {
  double cosine = 0;  ///< between both sequences of turns, each stacked into one vector; 0: nothing turned
  double best = 0;    ///< what it would be if one of them were turned or mirrored as a whole so that it fits best
  /// Measured: with right axes the cosine was above 0.9995 in 240 windows of euroc_mh01 and simulated flights; an axis
  /// flipped or two swapped were below 0.95 in most. A mounting that is 5 degrees off still has 0.996.
  static constexpr double kSameAxes = 0.95, kMeasured = 0.98;
  /// The turns are large enough to be measured, and fit about other axes than the configured ones only.
  bool about_other_axes() const { return cosine < kSameAxes && best >= kMeasured; }
};

/// Turns between neighbours along the body's axes, by vision through the mounting and by the gyroscope with `bias`. A
/// steady turn is left out of both: it may be the gyroscope's bias. The best fit by Kabsch, Acta Crystallographica A32,
/// 1976, mirror images allowed. No allocation.
TurnAgreement agreement_of_turns(std::span<const InertialNode> nodes, const CameraMounting& mounting,
                                 const ImuBias& bias);

/// The rest, given it. At least four moments; the first one's since_last is not looked at. The strength of gravity is a
/// constraint (a Lagrange multiplier, found by bisection of the secular equation). Not ok: the moments do not say, or
/// the scale would be negative. A hint weighs as much as its sigma says. No allocation; time in proportion to the
/// moments.
Alignment align(std::span<const InertialNode> nodes, const CameraMounting& mounting, const ImuBias& bias,
                double gravity_m_s2, AlignmentMethod method, const ScaleHint& hint = {});

}  // namespace godwit::vo
