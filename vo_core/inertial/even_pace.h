// Readings whose times scatter, laid at the even pace at which the sensor took them.
#pragma once

#include <array>
#include <cstddef>

#include "hal/rt/time.h"

namespace godwit::vo {

/// An inertial sensor converts by a clock of its own, in even steps; the times told are those at which somebody learnt
/// of it, and scatter. Of a shake of 60 m/s^2 at 85 Hz times that scatter by 0.3 ms make 6 mm of two seconds' way, the
/// same readings at an even pace 0.3 mm.
///
/// A line through the times told over the readings' numbers, by least squares over what came so far and with a memory
/// of a second from then on (an expanding-memory polynomial filter of the first degree; Morrison, Introduction to
/// Sequential Smoothing and Prediction, 1969, ch. 9). How many steps a reading lies after the one before is what is
/// likeliest where one in a hundred is lost; that one was lost unseen, or seen and not lost, shows in what follows: it
/// is a whole step off. Times that scatter by less than a microsecond stay as they are told. One thread; no allocation.
class EvenPace {
 public:
  /// The time of the reading after the last one. Increases, unless t_ns does not: then the last one's again. Until the
  /// pace is known (kStart readings), after a gap of more than a second and where the pace is lost: as told.
  rt::TimeNs lay(rt::TimeNs t_ns);
  /// One sigma of what a time told is off the pace [s]; 0 while it is not known.
  double scatter_s() const;

  static constexpr std::size_t kStart = 40;

 private:
  void begin(rt::TimeNs t_ns);
  void find_pace();
  bool shows_pace() const;
  /// By the pace; false: it is lost.
  bool follow(double told_ns);

  std::array<rt::TimeNs, kStart> first_{};  ///< as told, until the pace is known
  std::size_t gathered_ = 0;
  rt::TimeNs t_told_ns_ = 0, t_laid_ns_ = 0;  ///< of the last reading
  rt::TimeNs origin_ns_ = 0;                  ///< of the two below, which would lose nanoseconds as times
  double phase_ns_ = 0;                       ///< time of the last reading by its pace
  double step_ns_ = 0;                        ///< 0: not known
  double count_ = 0, square_ns2_ = 0;         ///< readings behind the pace, mean square off it
  double lag_ns_ = 0;                         ///< what the last few were off it in the mean
  int strays_ = 0;                            ///< readings in a row that were off by more than two steps
};

}  // namespace godwit::vo
