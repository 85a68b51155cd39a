// MJPEG from a V4L2 device: decoded, and fed by a thread of its own.
#include <opencv2/imgcodecs.hpp>

#include "hal/camera/device/fed_camera.h"
#include "tests/camera/no_cost.h"
#include "tests/camera/v4l2_fixture.h"
#include "tests/support/abandoned.h"

namespace godwit::hal::v4l2_mjpeg_test {
namespace {

TEST_F(V4l2CameraTest, MjpegIsDecodedAndWhatIsCutOffIsBad) {
  const cv::Mat picture(48, 64, CV_8UC3, cv::Scalar(30, 120, 200));
  cv::imencode(".jpg", picture, device_.jpeg);
  device_.formats = {V4L2_PIX_FMT_MJPEG};
  open();
  EXPECT_FALSE(camera_->real_time());
  ASSERT_EQ(shoot(), CameraStatus::kFrame);
  EXPECT_NEAR(pixels_[100], 0.114 * 30 + 0.587 * 120 + 0.299 * 200, 3);
  EXPECT_NEAR(bgr_[300], 30, 4);
  EXPECT_NEAR(bgr_[302], 200, 4);
  const auto half = static_cast<std::int64_t>(device_.jpeg.size() / 2);
  EXPECT_EQ(shoot(7, 0, half), CameraStatus::kBadFrame);
  EXPECT_NE(why_.find("JPEG"), std::string::npos);
  EXPECT_EQ(shoot(7, 0, 0), CameraStatus::kBadFrame);
  cv::imencode(".jpg", cv::Mat(48, 32, CV_8UC3, cv::Scalar::all(9)), device_.jpeg);
  EXPECT_EQ(shoot(), CameraStatus::kBadFrame);
  EXPECT_NE(why_.find("another size"), std::string::npos);
  cv::imencode(".jpg", picture, device_.jpeg);
  EXPECT_EQ(shoot(), CameraStatus::kFrame);
}

TEST_F(V4l2CameraTest, FedByAThreadOfItsOwnMjpegCostsTheReaderNoHeapAndNoLock) {
  const cv::Mat picture(48, 64, CV_8UC3, cv::Scalar(30, 120, 200));
  cv::imencode(".jpg", picture, device_.jpeg);
  device_.formats = {V4L2_PIX_FMT_MJPEG};
  device_.real_waits = true;
  open();
  V4l2Camera* const inner = camera_.get();
  auto fed = FedCamera::start(std::move(camera_), {});
  ASSERT_TRUE(fed.ok());
  FedCamera& camera = *fed.value();
  EXPECT_TRUE(camera.real_time());
  EXPECT_EQ(camera.channels(), 3);
  const auto shoot_and_read = [&] {
    device_.now_ns += kFrameNs;
    stamp_ns_ = device_.now_ns - rt::kNsPerMs;
    while (!device_.shoot(7, stamp_ns_, sequence_)) std::this_thread::yield();
    ++sequence_;
    CameraStatus status = CameraStatus::kTimeout;
    for (int i = 0; i < 600 && status == CameraStatus::kTimeout; ++i) {
      status = camera.next(grey(), bgr_.data(), 100 * rt::kNsPerMs, &frame_, &why_);
    }
    return status;
  };
  ASSERT_EQ(shoot_and_read(), CameraStatus::kFrame);
  test::expect_no_heap_and_no_lock(29, [&](int i) {
    ASSERT_EQ(shoot_and_read(), CameraStatus::kFrame);
    ASSERT_EQ(frame_.sequence, static_cast<std::uint32_t>(i + 1));
    ASSERT_EQ(frame_.t_source_ns, stamp_ns_ / 1000 * 1000);
    ASSERT_NEAR(pixels_.back(), 0.114 * 30 + 0.587 * 120 + 0.299 * 200, 3);
    ASSERT_NEAR(bgr_.back(), 200, 4);
  });
  device_.jpeg.resize(device_.jpeg.size() / 2);
  EXPECT_EQ(shoot_and_read(), CameraStatus::kBadFrame);
  EXPECT_NE(why_.find("JPEG"), std::string::npos);
  // Nobody takes them: they are passed over, and the newest four are kept waiting no longer than that.
  for (int i = 0; i < 60'000 && camera.passed_over() == 0; ++i) {
    device_.now_ns += kFrameNs;
    stamp_ns_ = device_.now_ns - rt::kNsPerMs;
    device_.shoot(7, stamp_ns_, sequence_++);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_GT(camera.passed_over(), 0u);
  EXPECT_GE(inner->counters().damaged, 1u);
}

TEST_F(V4l2CameraTest, AFeederThatHangsIsNamedAndKeepsNoEndAway) {
  open();
  auto fed = FedCamera::start(std::move(camera_), {});
  ASSERT_TRUE(fed.ok());
  EXPECT_EQ(test::abandoned_while_stands("gw-feeder", [&] { fed.value().reset(); }), "gw-feeder");
}

}  // namespace
}  // namespace godwit::hal::v4l2_mjpeg_test
