#include "firmware_app/commands/doctor_detector.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace godwit::app {
namespace doctor_detector_test {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

TEST(DoctorDetector, SaysWhatTheTimeOfAPictureMeans) {
  const SchedulerOptions s;  // a picture every 100 ms, masks of at most 400 ms
  const auto advice = [&](int large_ms, int small_ms, bool tiled = false) {
    return pace_advice(large_ms * rt::kNsPerMs, small_ms * rt::kNsPerMs, s, tiled);
  };
  EXPECT_EQ(advice(79, 50), "");
  EXPECT_THAT(advice(120, 70), HasSubstr("a picture every 150 ms instead of every 100"));
  EXPECT_THAT(advice(200, 120), AllOf(HasSubstr("masks would grow 450 ms old, more than 400"), HasSubstr("small one"),
                                      HasSubstr("detector.backend")));
  EXPECT_THAT(advice(400, 200), AllOf(HasSubstr("too slow: masks grow 450 ms old"), HasSubstr("detector.backend"),
                                      Not(HasSubstr("tiled"))));
  EXPECT_THAT(advice(400, 200, true), HasSubstr("detector.tiled = false"));
}

std::string told(const Config& config, int* wrong) {
  DoctorReport report;
  testing::internal::CaptureStdout();
  examine_detector(config, 160, 120, 30, &report);
  *wrong = report.wrong_count();
  return testing::internal::GetCapturedStdout();
}

TEST(DoctorDetector, TellsTheNetworksThatComeWithGodwitAndTheirLicence) {
  int wrong = 0;
  const std::string said = told(Config{}, &wrong);
  EXPECT_EQ(wrong, 0) << said;
  EXPECT_THAT(said, testing::ContainsRegex("ok .*cbam_yolov5n_416.onnx: input 416 x 416, 6 classes, [0-9]+ ms a "
                                           "picture on the processor"));
  EXPECT_THAT(said, HasSubstr("cbam_yolov5n_320.onnx: input 320 x 320"));
  EXPECT_THAT(said, HasSubstr("GPL-3.0"));
}

TEST(DoctorDetector, AMissingNetworkIsWrongAndNoneWantedIsNot) {
  Config config;
  config.detector.model = "/nowhere.onnx";
  int wrong = 0;
  EXPECT_THAT(told(config, &wrong), HasSubstr("WRONG  detector.model: /nowhere.onnx: No such file"));
  EXPECT_EQ(wrong, 1);
  config.detector.enabled = false;
  EXPECT_THAT(told(config, &wrong), AllOf(HasSubstr("detector.enabled is false"), Not(HasSubstr("nowhere"))));
  EXPECT_EQ(wrong, 0);
}

}  // namespace doctor_detector_test
}  // namespace godwit::app
