// What the odometry says of itself, and how that is called.
#pragma once

#include <cstdint>

namespace godwit::vo {

/// INITIALISING: no map yet. TRACKING: this frame's picture gave the pose. COASTING: a pose from inertial measurements
/// alone, for a short time. RELOCALISING: there is a map, this frame was not found in it, or by too few features to
/// count. LOST: the map was given up, another one is being begun. The numbers go out over the bus (config/godwit.dbc).
enum class State : std::uint8_t { kInitialising = 0, kTracking = 1, kCoasting = 2, kRelocalising = 3, kLost = 4 };

/// The state has a pose, where its picture was not one that says nothing new.
constexpr bool claims_pose(State s) {
  return s == State::kTracking || s == State::kCoasting;
}

/// Static text.
constexpr const char* state_name(State s) {
  switch (s) {
    case State::kInitialising:
      return "INITIALISING";
    case State::kTracking:
      return "TRACKING";
    case State::kCoasting:
      return "COASTING";
    case State::kRelocalising:
      return "RELOCALISING";
    case State::kLost:
      return "LOST";
  }
  return "?";
}

}  // namespace godwit::vo
