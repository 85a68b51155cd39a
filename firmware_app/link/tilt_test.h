// Whether the camera is mounted as the configuration says: `godwit doctor`'s tilt test. Pure logic; the command asks
// the user and the autopilot.
#pragma once

#include <Eigen/Geometry>
#include <string>
#include <vector>

#include "hal/rt/result.h"

namespace godwit::link {

/// The guided tilt test: hold the vehicle level, then nose up, then right side down, each by 20 to 60 degrees. Compares
/// how the autopilot and we see each turn.
class TiltTest {
 public:
  enum class Step : std::uint8_t { kLevel, kNoseUp, kRightDown, kDone };

  /// What to do now, in words.
  static const char* instruction(Step step);
  Step step() const { return step_; }
  /// The attitudes while the vehicle is held as asked: quaternions w x y z from body (front-right-down) to a level
  /// frame. Error, and the step stays: the autopilot itself saw another movement than the one asked for.
  rt::Result<void> hold(const Eigen::Vector4d& autopilot, const Eigen::Vector4d& ours);
  /// After kDone: what is wrong with the mounting, in words; empty: nothing.
  std::vector<std::string> result() const;

 private:
  Step step_ = Step::kLevel;
  Eigen::Vector4d autopilot_level_{1, 0, 0, 0}, our_level_{1, 0, 0, 0};
  Eigen::Matrix<double, 3, 2> autopilot_turns_, our_turns_;  // rotation vectors from level, body axes [rad]
};

}  // namespace godwit::link
