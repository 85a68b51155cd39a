// Whether pictures that are to be held in memory have room there.
#pragma once

#include <cstdint>

#include "hal/rt/result.h"

namespace godwit::app {

/// Looked at before hours go into drawing them. Error: what they need and what is free, in words; a fifth is left to
/// the run itself and to others.
rt::Result<void> room_for_pictures(std::int64_t pictures, int width, int height);

}  // namespace godwit::app
