// `godwit record` where its devices are not: told at once, and not taken for a recording.
#include <filesystem>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/support/run_command.h"
#include "tests/support/temp_folder.h"

namespace godwit::app::record_command_test {
namespace {

using godwit::test::Outcome;
using godwit::test::TempFolder;
using godwit::test::write_file;
using testing::HasSubstr;

constexpr const char* kCalibration =
    "model: pinhole\nwidth: 80\nheight: 64\nfx: 50\nfy: 50\ncx: 40\ncy: 32\ndistortion_model: radtan\n"
    "distortion: [0, 0, 0, 0]\nimage_channels: 1\nfps: 30\n";

Outcome record(const TempFolder& folder, const std::string& config, const std::string& more) {
  write_file(folder / "camera.yaml", kCalibration);
  write_file(folder / "live.toml", config);
  return godwit::test::run_command("cd '" + folder / "." +
                                   "' && '" GODWIT_TOOL "' record --config live.toml recording " + more);
}

TEST(Record, ACameraThatIsNotThereIsToldAndNoRecording) {
  const TempFolder folder;
  const Outcome o =
      record(folder, "[camera]\nsource = \"v4l2\"\ndevice = \"/dev/nothing\"\ncalibration = \"camera.yaml\"\n",
             "--seconds 0.5");
  EXPECT_EQ(o.exit_code, 1) << o.text;
  EXPECT_THAT(o.text, HasSubstr("/dev/nothing: cannot be opened: No such file or directory"));
  EXPECT_THAT(o.text, HasSubstr("no picture came from /dev/nothing"));
  EXPECT_FALSE(std::filesystem::exists(folder / "recording/mav0")) << "it would be in the next one's way";
}

TEST(Record, ALengthThatIsNoneIsRefused) {
  for (const char* seconds : {"nan", "inf", "0", "-1", "1e300", "long"}) {
    const TempFolder folder;
    const Outcome o = record(folder, "", std::string("--seconds ") + seconds);
    EXPECT_EQ(o.exit_code, 2) << o.text;
    EXPECT_THAT(o.text,
                HasSubstr(std::string("--seconds: '") + seconds + "': numbers from 0.001 to 86400 are allowed"));
  }
}

TEST(Record, AnInertialSensorThatIsNotThereIsToldAndNoRecording) {
  const TempFolder folder;
  const Outcome o =
      record(folder, "[imu]\nsource = \"mpu6000\"\ndevice = \"/dev/nothing\"\n", "--seconds 0.5 --no-camera");
  EXPECT_EQ(o.exit_code, 1) << o.text;
  EXPECT_THAT(o.text, HasSubstr("/dev/nothing: the SPI device cannot be opened"));
  EXPECT_THAT(o.text, HasSubstr("no sample came from /dev/nothing"));
}

}  // namespace
}  // namespace godwit::app::record_command_test
