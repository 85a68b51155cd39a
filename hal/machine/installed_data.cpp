#include "hal/machine/installed_data.h"

#include <filesystem>

namespace godwit::hal {

std::string installed_data(const std::string& name) {
  std::error_code no_proc;
  const std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", no_proc);
  return (program.parent_path().parent_path() / "share" / "godwit" / name).string();
}

}  // namespace godwit::hal
