#include "hal/machine/machine_state.h"

#include <algorithm>
#include <filesystem>
#include <fstream>

namespace godwit::hal {
namespace {
namespace fs = std::filesystem;

bool starts_with(const std::string& text, const char* head) {
  return text.rfind(head, 0) == 0;
}
}  // namespace

MachineMonitor::MachineMonitor(const std::string& sys) {
  std::error_code missing;
  for (const auto& entry : fs::directory_iterator(sys + "/class/thermal", missing)) {
    const std::string name = entry.path().filename();
    std::string type;
    std::ifstream(entry.path() / "type") >> type;
    // Jetson's zone of the power chip has no sensor behind it and always says 100 degrees.
    if (starts_with(name, "thermal_zone") && !starts_with(type, "PMIC-Die"))
      temperatures_.push_back(entry.path() / "temp");
    if (!starts_with(name, "cooling_device")) continue;
    // x86: "Processor"; device trees: "cpufreq-cpu0", "thermal-cpufreq-0", "cpu-balanced" (Jetson). Fans do not slow.
    std::transform(type.begin(), type.end(), type.begin(), [](unsigned char c) { return std::tolower(c); });
    if (starts_with(type, "processor") || starts_with(type, "cpu") || starts_with(type, "thermal-cpu"))
      coolers_.push_back(entry.path() / "cur_state");
  }
}

MachineState MachineMonitor::read() const {
  MachineState out;
  for (const std::string& file : temperatures_) {
    double millidegrees = 0;
    if (!(std::ifstream(file) >> millidegrees)) continue;  // a zone that is switched off cannot be read
    const double degrees = millidegrees * 1e-3;
    if (!(degrees <= out.temperature_c)) out.temperature_c = degrees;
  }
  for (const std::string& file : coolers_) {
    int state = 0;
    if (std::ifstream(file) >> state && state > 0) out.throttled = true;
  }
  return out;
}

}  // namespace godwit::hal
