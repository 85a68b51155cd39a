#include "hal/machine/installed_data.h"

#include <filesystem>

namespace godwit::hal {
namespace {

/// The folder that holds the programs' folder.
std::filesystem::path prefix() {
  std::error_code no_proc;
  const std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", no_proc);
  return program.parent_path().parent_path();
}

}  // namespace

std::string installed_data(const std::string& name) {
  return (prefix() / "share" / "godwit" / name).string();
}

std::string installed_library(const std::string& name) {
  return (prefix() / "lib" / "godwit" / name).string();
}

}  // namespace godwit::hal
