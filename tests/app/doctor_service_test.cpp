// What systemd will refuse, told from a machine's files.
#include "firmware_app/commands/doctor_service.h"

#include <filesystem>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include "tests/support/temp_folder.h"

namespace godwit::app {
namespace doctor_service_test {

using test::TempFolder;
using test::write_file;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

constexpr const char* kUnit =
    "[Service]\nUser=godwit\nSupplementaryGroups=video\nLimitRTPRIO=98\nLimitMEMLOCK=infinity\nDevicePolicy=closed\n"
    "DeviceAllow=char-video4linux rw\n";

/// A machine on which all is well: systemd with all capabilities, the unit, its user, a kernel without RT_GROUP_SCHED.
void put_machine(const TempFolder& root) {
  write_file(root / "proc/1/comm", "systemd\n");
  write_file(root / "proc/1/status", "Name:\tsystemd\nCapEff:\t000001ffffffffff\n");
  write_file(root / "proc/1/limits",
             "Limit                     Soft Limit           Hard Limit           Units\n"
             "Max locked memory         8388608              8388608              bytes\n"
             "Max realtime priority     0                    0\n");
  write_file(root / "proc/sys/kernel/osrelease", "6.1.0-18-amd64\n");
  write_file(root / "proc/sys/kernel/sched_rt_runtime_us", "950000\n");
  write_file(root / "boot/config-6.1.0-18-amd64", "CONFIG_A=y\n# CONFIG_RT_GROUP_SCHED is not set\n");
  write_file(root / "lib/systemd/system/godwitd.service", kUnit);
  write_file(root / "etc/passwd", "root:x:0:0::/root:/bin/sh\ngodwit:x:990:980::/var/lib/godwit:/bin/false\n");
  write_file(root / "etc/group", "root:x:0:\ngodwit:x:980:\nvideo:x:44:someone\n");
}

Config flying() {
  Config config;
  config.threads.lock_memory = true;
  config.threads.camera.priority = 60;
  return config;
}

std::string told(const TempFolder& root, const Config& config, int* wrong) {
  DoctorReport report;
  testing::internal::CaptureStdout();
  examine_service(root.path(), config, &report);
  *wrong = report.wrong_count();
  return testing::internal::GetCapturedStdout();
}

TEST(DoctorService, AMachineThatGrantsAllFits) {
  const TempFolder root;
  put_machine(root);
  int wrong = 0;
  EXPECT_THAT(told(root, flying(), &wrong),
              AllOf(HasSubstr("memory may be locked"), HasSubstr("priorities up to 60 may be had"),
                    HasSubstr("RT_GROUP_SCHED is off"), Not(HasSubstr("WRONG"))));
  EXPECT_EQ(wrong, 0);
}

TEST(DoctorService, ASystemdThatMayRaiseNoLimitIsTold) {
  const TempFolder root;
  put_machine(root);
  write_file(root / "proc/1/status", "CapEff:\t00000000a80425fb\n");  // as in a container
  int wrong = 0;
  EXPECT_THAT(told(root, flying(), &wrong),
              AllOf(HasSubstr("systemd may lock 8192 kB and raise no limit"),
                    HasSubstr("systemd may give 0 and raise no limit, 60 is configured")));
  EXPECT_EQ(wrong, 2);
}

TEST(DoctorService, AUnitThatAsksForTooLittleIsTold) {
  const TempFolder root;
  put_machine(root);
  write_file(root / "etc/systemd/system/godwitd.service.d/mine.conf", "[Service]\nLimitMEMLOCK=64M\nLimitRTPRIO=40\n");
  int wrong = 0;
  EXPECT_THAT(told(root, flying(), &wrong), AllOf(HasSubstr("LimitMEMLOCK=64M"), HasSubstr("LimitRTPRIO=40, 60")));
  EXPECT_EQ(wrong, 2);
}

TEST(DoctorService, GroupsWithoutRealTimeAreTold) {
  const TempFolder root;
  put_machine(root);
  write_file(root / "sys/fs/cgroup/cpu/cpu.rt_runtime_us", "950000\n");
  int wrong = 0;
  EXPECT_THAT(told(root, flying(), &wrong), HasSubstr("leaves the service its real time"));
  EXPECT_EQ(wrong, 0);
  write_file(root / "sys/fs/cgroup/cpu/system.slice/cpu.rt_runtime_us", "0\n");
  EXPECT_THAT(told(root, flying(), &wrong), AllOf(HasSubstr("RT_GROUP_SCHED"), HasSubstr("sched_rt_runtime_us=-1")));
  EXPECT_EQ(wrong, 1);
  write_file(root / "proc/sys/kernel/sched_rt_runtime_us", "-1\n");
  EXPECT_THAT(told(root, flying(), &wrong), HasSubstr("no group has a budget"));
  EXPECT_EQ(wrong, 0);
}

TEST(DoctorService, RealTimeGroupsUnderOneHierarchyAreTold) {
  const TempFolder root;
  put_machine(root);
  write_file(root / "boot/config-6.1.0-18-amd64", "CONFIG_A=y\nCONFIG_RT_GROUP_SCHED=y\n");
  write_file(root / "sys/fs/cgroup/cgroup.subtree_control", "memory pids\n");
  int wrong = 0;
  EXPECT_THAT(told(root, flying(), &wrong), HasSubstr("systemd leaves it alone"));
  EXPECT_EQ(wrong, 0);
  write_file(root / "sys/fs/cgroup/cgroup.subtree_control", "cpu memory pids\n");
  EXPECT_THAT(told(root, flying(), &wrong), HasSubstr("systemd uses the cpu controller"));
  EXPECT_EQ(wrong, 1);
}

TEST(DoctorService, DevicesAreHeldAgainstTheUnitAndItsUser) {
  const TempFolder root;
  put_machine(root);
  Config config = flying();
  config.camera.source = Config::Camera::Source::kV4l2;
  int wrong = 0;
  EXPECT_THAT(told(root, config, &wrong), HasSubstr("/dev/video0 is not there"));
  EXPECT_EQ(wrong, 0);

  // A character device that everybody may use, by one class and by another.
  std::filesystem::create_directories(root / "dev");
  std::filesystem::create_symlink("/dev/null", root / "dev/video0");
  write_file(root / "proc/devices", "Character devices:\n  1 video4linux\n\nBlock devices:\n  1 ramdisk\n");
  EXPECT_THAT(told(root, config, &wrong), HasSubstr("/dev/video0 is open to the service"));
  EXPECT_EQ(wrong, 0);
  write_file(root / "proc/devices", "Character devices:\n  1 mem\n\nBlock devices:\n  1 video4linux\n");
  EXPECT_THAT(told(root, config, &wrong), HasSubstr("DeviceAllow=/dev/video0 rw is missing"));
  EXPECT_EQ(wrong, 1);

  std::filesystem::remove(root / "dev/video0");
  write_file(root / "dev/video0", "");
  chmod((root / "dev/video0").c_str(), 0600);
  EXPECT_THAT(told(root, config, &wrong), HasSubstr("user godwit may not read and write it"));
  EXPECT_EQ(wrong, 1);
}

TEST(DoctorService, WithoutSystemdTheLimitsAreOnesOwn) {
  const TempFolder root;
  write_file(root / "proc/1/comm", "init\n");
  write_file(root / "proc/self/limits", "Max locked memory         65536                65536                bytes\n");
  int wrong = 0;
  EXPECT_THAT(told(root, flying(), &wrong),
              AllOf(HasSubstr("systemd does not run this machine"), HasSubstr("is not installed"),
                    HasSubstr("whoever starts it here may lock 64 kB")));
  EXPECT_EQ(wrong, 1);
}

TEST(DoctorService, WithoutItsUserTheUnitDoesNotStart) {
  const TempFolder root;
  put_machine(root);
  write_file(root / "etc/passwd", "root:x:0:0::/root:/bin/sh\n");
  int wrong = 0;
  EXPECT_THAT(told(root, flying(), &wrong), HasSubstr("there is no user \"godwit\""));
  EXPECT_EQ(wrong, 1);
}

}  // namespace doctor_service_test
}  // namespace godwit::app
