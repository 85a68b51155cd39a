#include <dlfcn.h>
#include <filesystem>

#include "hal/camera/libcamera/libcamera_entry.h"
#include "hal/camera/libcamera/libcamera_system.h"
#include "hal/machine/installed_data.h"

namespace godwit::hal {

std::string libcamera_library() {
  return installed_library("godwit-libcamera.so");
}

rt::Result<std::unique_ptr<LibcameraSystem>> load_libcamera() {
  const std::string file = libcamera_library();
  std::error_code unreadable;
  if (!std::filesystem::exists(file, unreadable)) {
    return rt::Error{"this godwit was built without libcamera (" + file + " is missing); \"v4l2\" needs none"};
  }
  const auto words = [&] {
    const char* const said = dlerror();
    return rt::Error{"libcamera cannot be used: " + (said != nullptr ? std::string(said) : file)};
  };
  // Never closed: libcamera and what it stands on leave threads behind.
  void* const library = dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (library == nullptr) return words();
  const auto make = reinterpret_cast<LibcameraEntry>(dlsym(library, kLibcameraEntry));
  if (make == nullptr) return words();
  const char* why = "";
  std::unique_ptr<LibcameraSystem> out(make(&why));
  if (out == nullptr) return rt::Error{std::string("libcamera: ") + why};
  return out;
}

}  // namespace godwit::hal
