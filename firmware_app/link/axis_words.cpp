#include "firmware_app/link/axis_words.h"

#include <array>

namespace godwit::link {

const char* axis_name(const Eigen::Vector3d& v) {
  constexpr std::array<const char*, 6> kNames{"front", "right", "down", "back", "left", "up"};
  Eigen::Index axis = 0;
  v.cwiseAbs().maxCoeff(&axis);
  return kNames[axis + (v(axis) < 0 ? 3 : 0)];
}

std::string mounting_words(const Eigen::Matrix3d& R_body_cam) {
  return std::string("the camera looks ") + axis_name(R_body_cam.col(2)) + ", the top of its picture is " +
         axis_name(-R_body_cam.col(1));
}

}  // namespace godwit::link
