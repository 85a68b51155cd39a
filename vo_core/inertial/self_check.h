// Whether what is told still fits what others measure: normalised innovations over time.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "hal/rt/time.h"

namespace godwit::vo {

/// Who measures against vision.
enum class CheckedBy : std::uint8_t { kInertial, kBarometer, kRange, kSatellites };
constexpr std::size_t kCheckers = 4;

struct SelfCheckOptions {
  rt::TimeNs memory_ns = 5 * rt::kNsPerSecond;  ///< so fast innovations are forgotten
  /// Mean squared innovation a degree of freedom (1 where all is as it is told): from here on trust falls, linearly in
  /// its root, to the least.
  double doubt = 2.5;
  double lost = 9;  ///< and here it is at the least
  double least_trust = 0.1;
  rt::TimeNs patience_ns = 3 * rt::kNsPerSecond;  ///< so long beyond `lost`: what is told is given up
  double most = 50;  ///< a single innovation counts for no more than this: one outlier is none
  double few = 3;    ///< innovations before which nothing is said
};

/// Plain value; no allocation; time is an argument.
class SelfCheck {
 public:
  explicit SelfCheck(const SelfCheckOptions& options = {}) : options_(options) {}

  /// squared: an innovation squared in its own sigmas, with so many degrees of freedom. What is no number counts as the
  /// worst there is. True: what is told is to be given up; the reason is below. What begins anew has the least trust
  /// until innovations fit.
  bool add(CheckedBy by, double squared, int degrees, rt::TimeNs t_ns);
  /// The same from whom one can do without: he makes what is told be trusted less as long as he contradicts it, and
  /// never ends it, since nobody knows which of the two is wrong.
  void doubt(CheckedBy by, double squared, int degrees, rt::TimeNs t_ns) { remember(by, squared, degrees, t_ns); }
  /// Who said nothing for longer than that is forgotten.
  void forget_older(CheckedBy by, rt::TimeNs t_ns);
  /// 1: all fits; down to least_trust. Of the one that fits least.
  double trust() const;
  /// Mean squared innovation a degree of freedom; 1 where too few came.
  double mean(CheckedBy by) const;
  void reset();

  const char* reason() const { return reason_; }  ///< of the last giving up, static text; its figure: ten times value()
  double value() const { return value_; }         ///< its mean squared innovation

 private:
  struct One {
    double sum = 0, weight = 0;
    rt::TimeNs t_ns = 0, t_beyond_ns = 0;  ///< 0: not beyond
  };
  One& remember(CheckedBy by, double squared, int degrees, rt::TimeNs t_ns);

  const SelfCheckOptions options_;
  std::array<One, kCheckers> ones_;
  const char* reason_ = "";
  double value_ = 0;
};

}  // namespace godwit::vo
