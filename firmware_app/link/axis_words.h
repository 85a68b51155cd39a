// Directions on the body in words, so that a wrong mounting is seen.
#pragma once

#include <Eigen/Core>
#include <string>

namespace godwit::link {

/// The body's axis (front, right, down, back, left, up) that v points along most.
const char* axis_name(const Eigen::Vector3d& v);

/// Where the camera looks and which way its picture stands: "the camera looks front, the top of its picture is up".
std::string mounting_words(const Eigen::Matrix3d& R_body_cam);

}  // namespace godwit::link
