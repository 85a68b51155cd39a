#include "hal/machine/machine_state.h"

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <initializer_list>

namespace godwit::hal {
namespace {
namespace fs = std::filesystem;

bool starts_with(const std::string& text, const char* head) {
  return text.rfind(head, 0) == 0;
}

std::string lower_first_word(const fs::path& file) {
  std::string word;
  std::ifstream(file) >> word;
  std::transform(word.begin(), word.end(), word.begin(), [](unsigned char c) { return std::tolower(c); });
  return word;
}

bool holds_any(const std::string& text, std::initializer_list<const char*> words) {
  return std::any_of(words.begin(), words.end(), [&](const char* w) { return text.find(w) != std::string::npos; });
}

/// No sensor of what computes: a Jetson's PMIC-Die tells a constant 100 degrees, its fan's estimate and a charger or a
/// radio say nothing of the processors.
bool is_other(const std::string& type) {
  return holds_any(type, {"pmic", "fan-est", "fan_est", "battery", "charger", "wifi", "nvme", "pch"});
}

/// Processors and what lies on their die: Jetson CPU-therm, GPU-therm, AUX-therm, AO-therm, CV, SOC0, tj; x86_pkg_temp,
/// acpitz; cpu-thermal, soc_thermal of device trees.
bool is_processor(const std::string& type) {
  return holds_any(type, {"cpu", "gpu", "soc", "pkg_temp", "acpitz", "aux-therm", "ao-therm", "cv", "tj", "coretemp"});
}
}  // namespace

MachineMonitor::MachineMonitor(const std::string& sys) {
  struct Zone {
    std::string file, type;
    bool processor = false, usable = false;
  };
  std::vector<Zone> zones;
  std::error_code missing;
  for (const auto& entry : fs::directory_iterator(sys + "/class/thermal", missing)) {
    const std::string name = entry.path().filename();
    const std::string type = lower_first_word(entry.path() / "type");
    if (starts_with(name, "thermal_zone")) {
      const bool left_out = is_other(type);
      zones.push_back({entry.path() / "temp", type.empty() ? name : type, is_processor(type) && !left_out, !left_out});
    }
    if (!starts_with(name, "cooling_device")) continue;
    // x86: "Processor"; device trees: "cpufreq-cpu0", "thermal-cpufreq-0", "cpu-balanced" (Jetson). Fans do not slow.
    if (starts_with(type, "processor") || starts_with(type, "cpu") || starts_with(type, "thermal-cpu"))
      coolers_.push_back(entry.path() / "cur_state");
  }
  std::sort(zones.begin(), zones.end(), [](const Zone& a, const Zone& b) { return a.file < b.file; });
  // The processors' own zones where there are any; else all that may be one.
  const bool any = std::any_of(zones.begin(), zones.end(), [](const Zone& z) { return z.processor; });
  for (const Zone& zone : zones) {
    if (any ? !zone.processor : !zone.usable) continue;
    temperatures_.push_back(zone.file);
    zones_ += (zones_.empty() ? "" : ", ") + zone.type;
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
