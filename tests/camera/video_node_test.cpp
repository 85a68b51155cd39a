// Which V4L2 devices there are, and which one is meant.
#include <filesystem>
#include <gtest/gtest.h>
#include <thread>

#include "hal/camera/v4l2/video_system.h"
#include "tests/support/temp_folder.h"

namespace godwit::hal::video_node_test {
namespace {

TEST(LinuxVideo, ANodeWithoutADeviceHasNoSerialNumber) {
  const test::TempFolder folder;
  std::filesystem::create_directories(folder / "sys/class/video4linux/video0");
  std::filesystem::create_directories(folder / "sys/class/video4linux/video3/device");
  test::write_file(folder / "sys/class/video4linux/video3/device/serial", "A3\n");
  test::write_file(folder / "serial", "of the working folder\n");
  const std::filesystem::path before = std::filesystem::current_path();
  std::filesystem::current_path(std::string(folder / "."));
  const auto nodes = linux_video_system(folder / "sys", folder / "dev")->nodes();
  std::filesystem::current_path(before);
  ASSERT_EQ(nodes.size(), 2u);
  EXPECT_EQ(nodes[0].serial, "");
  EXPECT_EQ(nodes[1].serial, "A3");
}

// A folder that is read in pieces and goes in between ends with an error, which an iterator's ++ throws.
TEST(LinuxVideo, DevicesThatGoWhileTheyAreListedAreNoExceptionOfOurs) {
  const test::TempFolder folder;
  const std::string nodes = folder / "sys/class/video4linux";
  for (int round = 0; round < 2; ++round) {
    std::filesystem::create_directories(nodes);
    for (int i = 0; i < 1300; ++i) test::write_file(nodes + "/video" + std::to_string(i), "");
    std::thread unplugs([&] { std::filesystem::remove_all(nodes); });
    const auto system = linux_video_system(folder / "sys", folder / "dev");
    EXPECT_NO_THROW(system->nodes());
    unplugs.join();
  }
}

TEST(VideoNode, DevicesAreChosenByPathNameOrSerialNumber) {
  const std::vector<VideoNode> nodes{{"/dev/video0", {"usb-Cam_A-video-index0"}, "A1"},
                                     {"/dev/video2", {"usb-Cam_B-video-index0"}, "B2"}};
  EXPECT_EQ(choose_video_node("/dev/video7", nodes).path, "/dev/video7");
  EXPECT_EQ(choose_video_node("serial:B2", nodes).path, "/dev/video2");
  EXPECT_EQ(choose_video_node("by-id:Cam_A", nodes).path, "/dev/video0");
  EXPECT_NE(choose_video_node("by-id:Cam", nodes).error.find("fits 2"), std::string::npos);
  EXPECT_NE(choose_video_node("serial:C", nodes).error.find("there are /dev/video0"), std::string::npos);
}

}  // namespace
}  // namespace godwit::hal::video_node_test
