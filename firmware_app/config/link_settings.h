// The [can] and [link] sections as the link takes them.
#pragma once

#include <array>
#include <optional>

#include "firmware_app/config/config.h"
#include "firmware_app/link/link_service.h"

namespace godwit::app {

/// A link is wanted at all.
bool wants_link(const Config& config);

/// T_body_cam: of the calibration, where it says one; the configuration's own wins. Precondition: check_link found
/// nothing.
link::LinkSettings link_settings(const Config& config, const std::optional<std::array<double, 16>>& T_body_cam);

}  // namespace godwit::app
