#include "firmware_app/commands/doctor_power.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <string>
#include <utility>

#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace doctor_power_test {

using test::TempFolder;
using test::write_file;
using testing::AllOf;
using testing::EndsWith;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

void put_processor(const TempFolder& root, int number, long lowest, long highest, long possible,
                   const std::string& governor) {
  const std::string folder = root / ("sys/devices/system/cpu/cpu" + std::to_string(number) + "/cpufreq/");
  write_file(folder + "scaling_min_freq", std::to_string(lowest) + "\n");
  write_file(folder + "scaling_max_freq", std::to_string(highest) + "\n");
  write_file(folder + "cpuinfo_max_freq", std::to_string(possible) + "\n");
  write_file(folder + "scaling_governor", governor + "\n");
}

void put_board(const TempFolder& root) {
  write_file(root / "proc/device-tree/model", std::string("Jetson-AGX\0", 11));
  write_file(root / "etc/nvpmodel.conf",
             "< POWER_MODEL ID=0 NAME=MAXN >\nCPU_ONLINE CORE_0 1\n< POWER_MODEL ID=2 NAME=MODE_15W >\n");
  write_file(root / "sys/devices/system/cpu/present", "0-7\n");
}

std::string told(const TempFolder& root, int* wrong) {
  DoctorReport report;
  testing::internal::CaptureStdout();
  examine_power(root.path(), &report);
  *wrong = report.wrong_count();
  return testing::internal::GetCapturedStdout();
}

TEST(DoctorPower, AJetsonWithAllItsClocksFits) {
  const TempFolder root;
  put_board(root);
  write_file(root / "var/lib/nvpmodel/status", "pmode:0000 fmode:cool\n");
  write_file(root / "sys/devices/system/cpu/online", "0-7\n");
  write_file(root / "sys/devices/system/cpu/isolated", "4-7\n");
  for (int i = 0; i < 8; ++i) put_processor(root, i, 2265600, 2265600, 2265600, "schedutil");
  int wrong = 0;
  EXPECT_THAT(told(root, &wrong), AllOf(HasSubstr("Jetson-AGX, nvpmodel mode 0 (MAXN)"),
                                        HasSubstr("ok     power: 8 processors"), HasSubstr("other programs: 4-7")));
  EXPECT_EQ(wrong, 0);
}

TEST(DoctorPower, TheZonesThatCountAreNamed) {
  const TempFolder root;
  int wrong = 0, i = 0;
  for (const auto& [type, temperature] : {std::pair{"CPU-therm", "41500"}, {"PMIC-Die", "100000"}}) {
    const std::string zone = root / ("sys/class/thermal/thermal_zone" + std::to_string(i++));
    write_file(zone + "/type", std::string(type) + "\n");
    write_file(zone + "/temp", std::string(temperature) + "\n");
  }
  EXPECT_THAT(told(root, &wrong), HasSubstr("the temperature is the hottest of cpu-therm: 41.5 degrees now"));
  EXPECT_EQ(wrong, 0);
}

TEST(DoctorPower, AJetsonInASavingModeIsWrong) {
  const TempFolder root;
  put_board(root);
  write_file(root / "var/lib/nvpmodel/status", "pmode:0002 fmode:quiet\n");
  write_file(root / "sys/devices/system/cpu/online", "0-2,4\n");
  put_processor(root, 0, 1190400, 1190400, 2265600, "schedutil");
  put_processor(root, 1, 115200, 2265600, 2265600, "schedutil");
  int wrong = 0;
  EXPECT_THAT(told(root, &wrong),
              AllOf(HasSubstr("mode 2 (MODE_15W)"), HasSubstr("4 of 8 processors are off: nvpmodel -m 0"),
                    HasSubstr("1 of 2 processors are held below"), HasSubstr("1 of 2 processors raise their clock"),
                    HasSubstr("no processor is isolated"), Not(HasSubstr("ok   "))));
  EXPECT_EQ(wrong, 3);
}

TEST(DoctorPower, OtherMachinesAreOnlyTold) {
  const TempFolder root;
  put_processor(root, 0, 800000, 3000000, 4000000, "powersave");
  int wrong = 0;
  EXPECT_THAT(told(root, &wrong), AllOf(HasSubstr("governor powersave"), Not(HasSubstr("jetson_clocks"))));
  EXPECT_EQ(wrong, 0);
}

TEST(DoctorPower, WhereNothingIsKnownOnlyThatIsSaid) {
  const TempFolder root;
  int wrong = 0;
  EXPECT_THAT(told(root, &wrong), AllOf(StartsWith("note   power: no thermal zone"), EndsWith("sheds nothing\n")));
  EXPECT_EQ(wrong, 0);
}

}  // namespace doctor_power_test
}  // namespace godwit::app
