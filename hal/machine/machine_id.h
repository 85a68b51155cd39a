// Which computer this is.
#pragma once

#include <array>
#include <cstdint>

#include "hal/rt/result.h"

namespace godwit::hal {

using MachineId = std::array<std::uint8_t, 16>;

/// A stable id of this computer for godwit alone, made by libsystemd of /etc/machine-id, which is confidential and
/// cannot be told from it (sd_id128_get_machine_app_specific). Never all zeros. Reads files. Error: with the remedy.
rt::Result<MachineId> machine_id();

}  // namespace godwit::hal
