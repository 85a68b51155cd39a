#include "hal/machine/machine_state.h"

#include <cmath>
#include <gtest/gtest.h>

#include "tests/support/temp_folder.h"

namespace godwit::hal::machine_state_test {
namespace {

using test::TempFolder;
using test::write_file;

TEST(MachineMonitor, TheHottestZoneCounts) {
  const TempFolder sys;
  write_file(sys / "class/thermal/thermal_zone0/temp", "45000\n");
  write_file(sys / "class/thermal/thermal_zone1/temp", "71500\n");
  write_file(sys / "class/thermal/thermal_zone2/temp", "");  // switched off
  const MachineMonitor monitor(sys.path());
  EXPECT_DOUBLE_EQ(monitor.read().temperature_c, 71.5);
  EXPECT_FALSE(monitor.read().throttled);
  write_file(sys / "class/thermal/thermal_zone0/temp", "90000\n");
  EXPECT_DOUBLE_EQ(monitor.read().temperature_c, 90) << "read anew each time";
}

TEST(MachineMonitor, AZoneWithoutASensorDoesNotCount) {
  const TempFolder sys;
  write_file(sys / "class/thermal/thermal_zone0/type", "CPU-therm\n");
  write_file(sys / "class/thermal/thermal_zone0/temp", "45500\n");
  write_file(sys / "class/thermal/thermal_zone1/type", "PMIC-Die\n");  // Jetson
  write_file(sys / "class/thermal/thermal_zone1/temp", "100000\n");
  EXPECT_DOUBLE_EQ(MachineMonitor(sys.path()).read().temperature_c, 45.5);
}

TEST(MachineMonitor, AJetsonsConstantZoneIsNoTemperature) {
  const TempFolder sys;
  const std::pair<const char*, const char*> zones[] = {{"AO-therm", "38000"},
                                                       {"CPU-therm", "41500"},
                                                       {"GPU-therm", "39000"},
                                                       {"PMIC-Die", "100000"},
                                                       {"thermal-fan-est", "99000"}};
  int i = 0;
  for (const auto& [type, temperature] : zones) {
    const std::string zone = "class/thermal/thermal_zone" + std::to_string(i++);
    write_file(sys / (zone + "/type"), std::string(type) + "\n");
    write_file(sys / (zone + "/temp"), std::string(temperature) + "\n");
  }
  const MachineMonitor monitor(sys.path());
  EXPECT_DOUBLE_EQ(monitor.read().temperature_c, 41.5);
  EXPECT_EQ(monitor.zones(), "ao-therm, cpu-therm, gpu-therm");
}

TEST(MachineMonitor, WhereNoZoneIsTheProcessorsAConstantOneDoesNotCountEither) {
  const TempFolder sys;
  write_file(sys / "class/thermal/thermal_zone0/type", "PMIC-Die\n");
  write_file(sys / "class/thermal/thermal_zone0/temp", "100000\n");
  EXPECT_TRUE(std::isnan(MachineMonitor(sys.path()).read().temperature_c));
  write_file(sys / "class/thermal/thermal_zone1/type", "board\n");
  write_file(sys / "class/thermal/thermal_zone1/temp", "40000\n");
  EXPECT_DOUBLE_EQ(MachineMonitor(sys.path()).read().temperature_c, 40);
}

TEST(MachineMonitor, ProcessorsSlowedDownAreThrottlingAFanIsNot) {
  const TempFolder sys;
  write_file(sys / "class/thermal/cooling_device0/type", "pwm-fan\n");
  write_file(sys / "class/thermal/cooling_device0/cur_state", "3\n");
  write_file(sys / "class/thermal/cooling_device1/type", "cpufreq-cpu0\n");
  write_file(sys / "class/thermal/cooling_device1/cur_state", "0\n");
  write_file(sys / "class/thermal/cooling_device2/type", "Processor\n");
  write_file(sys / "class/thermal/cooling_device2/cur_state", "0\n");
  const MachineMonitor monitor(sys.path());
  EXPECT_FALSE(monitor.read().throttled);
  write_file(sys / "class/thermal/cooling_device2/cur_state", "1\n");
  EXPECT_TRUE(monitor.read().throttled);
}

TEST(MachineMonitor, AMachineWithoutSensorsIsUnknownNotHot) {
  const TempFolder sys;
  const MachineMonitor monitor(sys.path());
  EXPECT_TRUE(std::isnan(monitor.read().temperature_c));
  EXPECT_FALSE(monitor.read().throttled);
}

}  // namespace
}  // namespace godwit::hal::machine_state_test
