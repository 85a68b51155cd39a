// The [can] and [link] sections as the link takes them.
#pragma once

#include <array>
#include <optional>

#include "firmware_app/config/config.h"
#include "firmware_app/link/link_service.h"

namespace godwit::app {

/// A link is wanted at all.
bool wants_link(const Config& config);

/// Looks at [can] and [link] for what is wrong beyond each key's own range: addresses that mean nothing, a mounting
/// that is no rotation, places that are not on Earth, keys that cannot stand together.
void check_link(ConfigReport* report);

/// T_body_cam: of the calibration, where it says one; the configuration's own wins. Precondition: check_link found
/// nothing.
link::LinkSettings link_settings(const Config& config, const std::optional<std::array<double, 16>>& T_body_cam);

/// Where the camera looks and which way its picture stands, in words, so that a wrong mounting is seen: "the camera
/// looks front, the top of its picture is up".
std::string mounting_words(const Eigen::Matrix3d& R_body_cam);

}  // namespace godwit::app
