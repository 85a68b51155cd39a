#include "firmware_app/link/tilt_test.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "firmware_app/link/axis_words.h"

namespace godwit::link {
namespace {

Eigen::Matrix3d rotation_of(const Eigen::Vector4d& q) {
  return Eigen::Quaterniond(q(0), q(1), q(2), q(3)).normalized().toRotationMatrix();
}

Eigen::Vector3d turn_between(const Eigen::Vector4d& from, const Eigen::Vector4d& to) {
  const Eigen::AngleAxisd turn(rotation_of(from).transpose() * rotation_of(to));
  return turn.angle() * turn.axis();
}

// Roll and pitch [degree] of an attitude.
Eigen::Vector2d tilt(const Eigen::Vector4d& q) {
  const Eigen::Matrix3d R = rotation_of(q);
  return Eigen::Vector2d(std::atan2(R(2, 1), R(2, 2)), -std::asin(std::clamp(R(2, 0), -1.0, 1.0))) * (180 / M_PI);
}

}  // namespace

const char* TiltTest::instruction(Step step) {
  switch (step) {
    case Step::kLevel:
      return "Hold the vehicle level and still.";
    case Step::kNoseUp:
      return "Raise the nose by 20 to 60 degrees, without turning or rolling, and hold it still.";
    case Step::kRightDown:
      return "From level again, lower the right side by 20 to 60 degrees and hold it still.";
    case Step::kDone:
      return "Done.";
  }
  return "";
}

rt::Result<void> TiltTest::hold(const Eigen::Vector4d& autopilot, const Eigen::Vector4d& ours) {
  if (!autopilot.allFinite() || !ours.allFinite() || autopilot.norm() < 0.5 || ours.norm() < 0.5) {
    return rt::Error{"tilt test: no attitude from the autopilot or from the camera"};
  }
  if (step_ == Step::kLevel) {
    if (tilt(autopilot).norm() > 10) return rt::Error{"tilt test: the autopilot does not see the vehicle level"};
    autopilot_level_ = autopilot;
    our_level_ = ours;
    step_ = Step::kNoseUp;
    return {};
  }
  if (step_ == Step::kDone) return {};
  const Eigen::Index index = step_ == Step::kNoseUp ? 0 : 1;
  const Eigen::Vector3d turn = turn_between(autopilot_level_, autopilot);
  const Eigen::Vector3d asked = step_ == Step::kNoseUp ? Eigen::Vector3d::UnitY() : Eigen::Vector3d::UnitX();
  const double degrees = turn.norm() * 180 / M_PI;
  if (degrees < 15 || degrees > 70 || turn.normalized().dot(asked) < 0.85) {
    return rt::Error{std::string("tilt test: the autopilot saw another movement. ") + instruction(step_)};
  }
  autopilot_turns_.col(index) = turn;
  our_turns_.col(index) = turn_between(our_level_, ours);
  step_ = step_ == Step::kNoseUp ? Step::kRightDown : Step::kDone;
  return {};
}

std::vector<std::string> TiltTest::result() const {
  std::vector<std::string> out;
  if (step_ != Step::kDone) return {"The tilt test is not finished."};
  // The rotation of axes that makes our turns those of the autopilot: the identity where the mounting is right.
  const auto error = [&](const Eigen::Matrix3d& S) {
    return (S * our_turns_ - autopilot_turns_).norm() / autopilot_turns_.norm();
  };
  Eigen::Matrix3d best = Eigen::Matrix3d::Identity();
  for (int x = 0; x < 6; ++x) {
    for (int y = 0; y < 6; ++y) {
      const Eigen::Vector3d a = (x < 3 ? 1.0 : -1.0) * Eigen::Vector3d::Unit(x % 3);
      const Eigen::Vector3d b = (y < 3 ? 1.0 : -1.0) * Eigen::Vector3d::Unit(y % 3);
      if (std::abs(a.dot(b)) > 0.5) continue;
      Eigen::Matrix3d S;
      S << a, b, a.cross(b);
      if (error(S) < error(best) - 1e-9) best = S;
    }
  }
  constexpr double kFits = 0.25;
  if (error(best) > kFits) {
    for (Eigen::Index i = 0; i < 2; ++i) {
      if (our_turns_.col(i).norm() < 0.5 * autopilot_turns_.col(i).norm()) {
        out.push_back(std::string("The camera hardly saw the vehicle ") +
                      (i == 0 ? "raise its nose" : "lower its right side") +
                      ": is there texture in view, and is it tracking?");
      }
    }
    if (out.empty()) {
      out.push_back(
          "No rotation of axes explains what the camera saw: is the picture mirrored, or is the calibration of another "
          "camera?");
    }
    return out;
  }
  if (!best.isIdentity(1e-9)) {
    out.push_back("The axes of T_body_cam are wrong: what godwit takes for front is " +
                  std::string(axis_name(best.col(0))) + ", right is " + axis_name(best.col(1)) + ", down is " +
                  axis_name(best.col(2)) + ".");
    return out;
  }
  const Eigen::Vector2d off = tilt(our_level_) - tilt(autopilot_level_);
  constexpr double kAngleDegrees = 3;
  const auto tell = [&](const char* name, double degrees) {
    if (std::abs(degrees) <= kAngleDegrees) return;
    char tenths[16];
    std::snprintf(tenths, sizeof(tenths), "%g", std::round(degrees * 10) / 10);
    out.push_back(std::string("Held level, the ") + name + " by the camera is " + tenths +
                  " degrees from the autopilot's: correct T_body_cam by that angle.");
  };
  tell("roll", off.x());
  tell("pitch", off.y());
  return out;
}

}  // namespace godwit::link
