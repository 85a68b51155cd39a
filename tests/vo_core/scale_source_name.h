// Who told a length, in the words of a failed test.
#pragma once

#include "vo_core/inertial/scale_state.h"

namespace godwit::vo::test {

inline const char* scale_source_name(ScaleSource source) {
  constexpr const char* kNames[kScaleSources] = {"rangefinder", "barometer", "satellites", "configured height"};
  return kNames[scale_source_index(source)];
}

}  // namespace godwit::vo::test
