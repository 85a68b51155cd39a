// How many metres a unit of vision's map is, where no inertial sensor tells it or beside one: lengths that a
// rangefinder, a barometer, satellites or a configured height know in metres and vision in its own unit.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "hal/rt/time.h"

namespace godwit::vo {

enum class ScaleSource : std::uint8_t {
  kRange,        ///< height above what is below, by a rangefinder
  kBarometer,    ///< climb between two moments, by the pressure
  kSatellites,   ///< way between two moments, by GNSS
  kStartHeight,  ///< height above ground at the start, as configured
};
constexpr std::size_t kScaleSources = 4;
constexpr std::size_t scale_source_index(ScaleSource source) {
  return static_cast<std::size_t>(source);
}

/// The same length twice. For climbs and ways: signed along one direction, or both positive.
struct ScaleReading {
  ScaleSource source = ScaleSource::kRange;
  rt::TimeNs t_ns = 0;
  double metres = 0, metres_sigma = 0;  ///< by the source [m]
  double units = 0, units_sigma = 0;    ///< by vision [map units]
};

struct ScaleOptions {
  /// How far off a source may be as a whole, one sigma of the logarithm: unevenness of the ground and mounting; weather
  /// and the hole that the pressure is taken at; antenna and reflections; whoever configured it.
  std::array<double, kScaleSources> bias_sigma = {0.05, 0.08, 0.02, 0.15};
  double bias_walk = 2e-3;    ///< of each of those [1/sqrt(s)]
  double scale_walk = 1e-3;   ///< of the map's scale [1/sqrt(s)]
  double known_sigma = 0.15;  ///< of the logarithm: below this there is a scale
  double most_sigma = 0.5;    ///< a reading surer than this at least says something: others are too short
  double limit2 = 11;         ///< sigmas squared, one degree of freedom: by chance one in 1,000
  int frozen = 25;            ///< so many equal readings in a row while vision's length changed by 3 of its sigmas
  int distrusted = 20;        ///< so many beyond that limit in a row
  rt::TimeNs silent_ns = 30 * rt::kNsPerSecond;  ///< a source that is distrusted is not heard for so long
};

/// What became of a reading.
enum class ScaleVerdict : std::uint8_t {
  kUsed,
  kNoNumber,     ///< not finite, negative sigmas, or a time before the last one
  kTooShort,     ///< a length of which too little is known
  kContradicts,  ///< it contradicts what is known
  kFrozen,       ///< the source repeats itself while vision moves
  kDistrusted,   ///< it contradicted too often and is not heard for a while
};

/// One state, the logarithm of the metres in a map unit, and with each source what it is off by as a whole: a scale is
/// never surer than its sources are as wholes. Where two contradict each other nobody can tell who is right: then by
/// how much they do is in the sigma. Where two agree against a third, that one is wrong. Extended Kalman filter that
/// leaves out what contradicts. Plain value; no allocation; time is an argument.
class ScaleState {
 public:
  explicit ScaleState(const ScaleOptions& options = {});

  ScaleVerdict take(const ScaleReading& reading);
  /// No measurement: it becomes less sure with time.
  void advance(rt::TimeNs t_ns);
  /// A new map has another unit, about which nothing is known; what the sources are off by stays.
  void new_map();

  bool known() const;
  double scale() const;                    ///< [m per map unit]
  double log_sigma() const;                ///< of its logarithm, what sources contradict each other by included
  double share(ScaleSource source) const;  ///< of what was learned, 0 to 1; of all together 1, or 0 where nothing was
  std::uint64_t count(ScaleSource source, ScaleVerdict verdict) const;
  /// How often all sources contradicted what was held for true, so that it was given up.
  std::uint64_t given_up() const { return given_up_; }
  const char* reason() const { return reason_; }  ///< of the last giving up; static text

 private:
  static constexpr std::size_t kStates = 1 + kScaleSources;
  struct Source {
    double last_metres = 0, units_then = 0;
    int equal = 0, contradictions = 0;
    rt::TimeNs silent_until_ns = 0, t_used_ns = 0;
    double information = 0;
    std::array<std::uint64_t, 6> counts{};
  };
  ScaleVerdict judge(const ScaleReading& reading, Source* source);
  bool heard(const Source& source) const;  ///< it was used in the last seconds
  int others_heard(std::size_t source) const;

  const ScaleOptions options_;
  std::array<double, kStates> x_{};  ///< log scale, then each source's own
  std::array<std::array<double, kStates>, kStates> P_{};
  std::array<Source, kScaleSources> sources_;
  rt::TimeNs t_ns_ = 0;
  bool begun_ = false;   ///< t_ns_ is set
  double dispute2_ = 0;  ///< by how much two sources contradict each other, squared; forgotten with time
  std::uint64_t given_up_ = 0;
  const char* reason_ = "";
};

}  // namespace godwit::vo
