// How warm the machine is, and whether it slows its processors down.
#pragma once

#include <limits>
#include <string>
#include <vector>

namespace godwit::hal {

struct MachineState {
  double temperature_c =
      std::numeric_limits<double>::quiet_NaN();  ///< of the hottest zone that counts; not-a-number: unknown
  bool throttled = false;                        ///< a cooling device that slows processors is at work
};

/// Reads the kernel's thermal zones of processors, chosen by their types, and cooling devices
/// (Documentation/driver-api/thermal/sysfs-api.rst). Opens files at each read: for a thread that may block. One thread.
class MachineMonitor {
 public:
  /// sys: where sysfs is mounted. What is not there is not read: a machine without sensors is in an unknown state, not
  /// a wrong one.
  explicit MachineMonitor(const std::string& sys = "/sys");
  MachineState read() const;
  /// The types of the zones that count, "cpu-therm, gpu-therm"; empty: there is none.
  const std::string& zones() const { return zones_; }

 private:
  std::string zones_;
  std::vector<std::string> temperatures_;  ///< files, millidegrees
  std::vector<std::string> coolers_;       ///< files, 0: idle
};

}  // namespace godwit::hal
