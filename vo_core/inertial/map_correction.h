// What bundle adjustment found out that vision had strayed by, and which part of it belongs to a moment before.
#pragma once

#include <algorithm>

#include "hal/rt/time.h"
#include "vo_core/geometry/geometry.h"

namespace godwit::vo {

/// What a correction of the map takes back vision strayed by over so long: as old as what bundle adjustment moves.
/// Chosen on euroc_mh01 with ten and twenty pictures a second and in the simulator between 0.5 and 1.5 s; with 3 s and
/// more lengths are off as if all moments moved alike.
constexpr rt::TimeNs kStrayedNs = 800 * rt::kNsPerMs;

/// A correction of the map. Plain value; no allocation.
struct MapCorrection {
  rt::TimeNs from_ns = 0, to_ns = 0;  ///< vision strayed over this time; not after each other: all moments move alike
  Vec3 pivot = Vec3::Zero();          ///< the camera at the end of it, and how that
  Vec3 turned_by = Vec3::Zero();      ///< turned, rotation vector along the map's axes,
  Vec3 moved_by = Vec3::Zero();       ///< and moved [map units]

  /// How much of it a moment of that time takes: all at the end of it, nothing before its begin.
  double share(rt::TimeNs t_ns) const {
    if (to_ns <= from_ns) return 1;
    return std::clamp(rt::to_seconds(t_ns - from_ns) / rt::to_seconds(to_ns - from_ns), 0.0, 1.0);
  }
  /// Vision strayed at that time, at a rate that nobody knew before: variance of an axis and second of the walk that
  /// ended at `by`, the correction's turn or move.
  bool strayed_at(rt::TimeNs t_ns) const { return from_ns < to_ns && t_ns > from_ns; }
  double rate(const Vec3& by) const { return by.squaredNorm() / (3 * rt::to_seconds(to_ns - from_ns)); }
  /// That share of its turn, and where a place seen at that time is in the corrected map.
  Mat3 turn(rt::TimeNs t_ns) const { return so3_exp(share(t_ns) * turned_by); }
  Vec3 moved(rt::TimeNs t_ns, const Vec3& place) const {
    return pivot + turn(t_ns) * (place - pivot) + share(t_ns) * moved_by;
  }
};

}  // namespace godwit::vo
