// One measure of whether a pose is right: the logarithm of how much likelier what was looked for in the picture would
// have ended as it did if the pose were right than if it were any other. Adds up over frames that follow each other.
#pragma once

#include <algorithm>

#include "vo_core/tracking/pose_optimizer.h"

namespace godwit::vo {

/// Of 5,300 poses within 2 cm of the truth and 140 that were off by more than 8 cm, among walkers (tum_fr1_xyz with those
/// of eight seeds, all attempts of the tracker counted): a point that was looked for was found and agreed in 55 and 16 %
/// of the trials; of what was found 15 and 30 % did not agree; not found were 35 and 78 %. Right, a point's place has the
/// stated noise; wrong, it is anywhere within the three sigmas that make an inlier. By the sum of it 99.4 % of the right
/// ones have more than 10, two of the wrong.
struct EvidenceModel {
  double agrees = 1.27;         ///< ln(0.55 / 0.16)
  double corner_place = 1.50;   ///< ln of the normal distribution's height over that of 1 / (9 pi sigma^2)
  double edgelet_place = 0.87;  ///< over that of 1 / (6 sigma)
  double disagrees = -0.7;      ///< ln(0.15 / 0.30)
  /// ln(0.35 / 0.78) is -0.8 for one alone. But blur or a step of the light takes many at once, and says no more then.
  double not_found = -0.5;
  double least_not_found = -50.0;
};

/// Nats for the pose that `fit` ended with. `not_found`: trials without a match, of points that nothing is known to hide.
inline double pose_evidence(const PoseOptimizerResult& fit, int not_found, const EvidenceModel& model = {}) {
  if (!fit.ok) return 0.0;
  const int corners = fit.freedom + 6 - fit.inliers;
  const int edgelets = fit.inliers - corners;
  return corners * (model.agrees + model.corner_place) + edgelets * (model.agrees + model.edgelet_place) -
         0.5 * fit.chi_square + (fit.measurements - fit.inliers) * model.disagrees +
         std::max(not_found * model.not_found, model.least_not_found);
}

}  // namespace godwit::vo
