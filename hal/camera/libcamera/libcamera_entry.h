// The one function by which godwit-libcamera.so is entered.
#pragma once

#include "hal/camera/libcamera/libcamera_system.h"

namespace godwit::hal {

/// Null: *why says it, static text.
using LibcameraEntry = LibcameraSystem* (*)(const char** why);
/// Its name; changes with libcamera_system.h, so that a library of another godwit is refused.
constexpr const char* kLibcameraEntry = "godwit_libcamera_1";

}  // namespace godwit::hal
