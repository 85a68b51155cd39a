#include "firmware_app/commands/doctor_power.h"

#include <filesystem>
#include <fstream>
#include <sstream>

#include "hal/machine/machine_state.h"

namespace godwit::app {
namespace {
namespace fs = std::filesystem;

/// The first line without what ends it; empty: not there.
std::string line_of(const fs::path& file) {
  std::string line;
  std::ifstream in(file);
  std::getline(in, line);
  while (!line.empty() && (line.back() == '\0' || line.back() == ' ')) line.pop_back();
  return line;
}

/// How many processors a list of the kernel names: "0-3,6".
int count_of(const std::string& list) {
  int count = 0;
  std::stringstream parts(list);
  for (std::string part; std::getline(parts, part, ',');) {
    int first = 0, last = 0;
    char dash = 0;
    std::stringstream range(part);
    if (!(range >> first)) continue;
    last = range >> dash >> last ? last : first;
    count += last - first + 1;
  }
  return count;
}

/// "0 (MAXN)" from nvpmodel's saved status "pmode:0000" and its table of modes; empty: no such board.
std::string power_mode(const fs::path& root) {
  const std::string status = line_of(root / "var/lib/nvpmodel/status");
  const std::string key = "pmode:";
  const auto at = status.find(key);
  int mode = 0;
  if (at == std::string::npos || !(std::stringstream(status.substr(at + key.size())) >> mode)) return "";
  std::ifstream table(root / "etc/nvpmodel.conf");
  for (std::string line; std::getline(table, line);) {
    // "< POWER_MODEL ID=0 NAME=MAXN >"
    std::stringstream words(line);
    std::string open, what, id, name;
    if (words >> open >> what >> id >> name && what == "POWER_MODEL" && id == "ID=" + std::to_string(mode) &&
        name.starts_with("NAME="))
      return std::to_string(mode) + " (" + name.substr(5) + ")";
  }
  return std::to_string(mode);
}

struct Clocks {
  int processors = 0;
  int capped = 0;  ///< may not reach what the chip can
  int late = 0;    ///< may fall below their highest, and are raised when work is there already
  std::string governor;
};

Clocks read_clocks(const fs::path& root) {
  Clocks out;
  std::error_code missing;
  for (const auto& entry : fs::directory_iterator(root / "sys/devices/system/cpu", missing)) {
    const fs::path folder = entry.path() / "cpufreq";
    long lowest = 0, highest = 0, possible = 0;
    if (!(std::ifstream(folder / "scaling_min_freq") >> lowest) ||
        !(std::ifstream(folder / "scaling_max_freq") >> highest) ||
        !(std::ifstream(folder / "cpuinfo_max_freq") >> possible))
      continue;
    ++out.processors;
    out.governor = line_of(folder / "scaling_governor");
    if (highest < possible) ++out.capped;
    if (lowest < highest && out.governor != "performance") ++out.late;
  }
  return out;
}

void examine_temperature(const fs::path& root, DoctorReport* report) {
  const hal::MachineMonitor machine((root / "sys").string());
  if (machine.zones().empty()) {
    report->note("power: no thermal zone tells this machine's temperature: scheduler.temperature_c sheds nothing");
  } else {
    report->note(fmt::format("power: the temperature is the hottest of {}: {:.1f} degrees now", machine.zones(),
                             machine.read().temperature_c));
  }
}

}  // namespace

void examine_power(const std::string& root, DoctorReport* report) {
  const fs::path base = root;
  const std::string model = line_of(base / "proc/device-tree/model");
  const bool jetson = model.find("Jetson") != std::string::npos;
  const auto doubtful = [&](const std::string& words, const std::string& mend) {
    if (jetson) {
      report->wrong("power: " + words + ": " + mend);
    } else {
      report->note("power: " + words);
    }
  };
  const int before = report->wrong_count();
  const std::string mode = power_mode(base);
  if (!model.empty()) report->note("power: " + model + (mode.empty() ? "" : ", nvpmodel mode " + mode));
  const fs::path processors = base / "sys/devices/system/cpu";
  const int present = count_of(line_of(processors / "present")), online = count_of(line_of(processors / "online"));
  if (online < present)
    doubtful(fmt::format("{} of {} processors are off", present - online, present), "nvpmodel -m 0 (docs/jetson.md)");
  const Clocks clocks = read_clocks(base);
  if (clocks.capped > 0)
    doubtful(fmt::format("{} of {} processors are held below their highest clock", clocks.capped, clocks.processors),
             "nvpmodel -m 0");
  if (clocks.late > 0)
    doubtful(fmt::format("{} of {} processors raise their clock only when work is there (governor {})", clocks.late,
                         clocks.processors, clocks.governor),
             "jetson_clocks");
  const std::string isolated = line_of(processors / "isolated");
  if (jetson && isolated.empty())
    report->note("power: no processor is isolated (isolcpus, docs/jetson.md): other programs may delay a frame");
  if (!isolated.empty()) report->note("power: processors kept free of other programs: " + isolated);
  if (clocks.processors > 0 && clocks.capped == 0 && clocks.late == 0 && report->wrong_count() == before)
    report->fits(fmt::format("power: {} processors keep their highest clock", clocks.processors));
  examine_temperature(base, report);
}

}  // namespace godwit::app
