// Scenarios for tests: as they are, or in small where a sanitizer makes worlds and pictures ten times as dear.
#pragma once

#include <gtest/gtest.h>
#include <string>
#include <utility>

#include "hal/sim/flight/scenario.h"

namespace godwit::sim::test {

#ifdef GODWIT_SMALL_WORLDS
constexpr bool kSmall = true;
#else
constexpr bool kSmall = false;
#endif

/// Half the picture's size with the same view, and ground painted a quarter as fine.
inline Scenario in_small(Scenario s) {
  Lens& lens = s.camera.rig.lens;
  lens.width /= 2;
  lens.height /= 2;
  lens.fx /= 2;
  lens.fy /= 2;
  lens.cx = (lens.cx + 0.5) / 2 - 0.5;
  lens.cy = (lens.cy + 0.5) / 2 - 0.5;
  s.world.ground_texels = 1024;
  return s;
}

/// A scenario of config/scenarios, in small under the sanitizers.
inline Scenario scenario(const std::string& name) {
  rt::Result<Scenario> read = find_scenario(name, GODWIT_SCENARIO_DIR);
  EXPECT_TRUE(read.ok()) << (read.ok() ? "" : read.error().message);
  Scenario s = std::move(read).value();
  return kSmall ? in_small(std::move(s)) : s;
}

}  // namespace godwit::sim::test
