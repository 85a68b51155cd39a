#include "hal/camera/replay/replay_camera.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/imgproc.hpp>
#include <unistd.h>
#include <vector>

#include "hal/rt/frame_pool.h"
#include "hal/rt/wake_up.h"
#include "tests/support/tiny_sequence.h"

namespace godwit::hal::replay_camera_test {
namespace {

using test::read_file;
using test::TempFolder;
using test::write_file;
using testing::HasSubstr;

/// What one call of next() gave.
struct Seen {
  CameraStatus status;
  CapturedFrame frame;
  std::string why;
  cv::Mat grey;
};

std::vector<Seen> run_to_end(ReplayCamera* camera) {
  std::vector<Seen> all;
  while (true) {
    Seen s;
    s.grey = cv::Mat(camera->height(), camera->width(), CV_8UC1, cv::Scalar(0));
    const rt::MutableImageView view{s.grey.data, s.grey.cols, s.grey.rows, static_cast<int>(s.grey.step)};
    s.status = camera->next(view, nullptr, 0, &s.frame, &s.why);
    if (s.status == CameraStatus::kEnd) return all;
    all.push_back(s);
  }
}

std::unique_ptr<ReplayCamera> open(const std::string& folder, const ReplayOptions& options = {}) {
  auto camera = ReplayCamera::open(folder, options);
  EXPECT_TRUE(camera.ok()) << camera.error().message;
  return camera.ok() ? std::move(camera).value() : nullptr;
}

std::string refusal(const std::string& folder, const ReplayOptions& options = {}) {
  const auto camera = ReplayCamera::open(folder, options);
  EXPECT_FALSE(camera.ok());
  return camera.ok() ? "" : camera.error().message;
}

double difference(const cv::Mat& a, const cv::Mat& b) {
  return cv::norm(a, b, cv::NORM_INF);
}

TEST(ReplayCamera, DeliversEveryPictureWithItsExactTime) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 5);
  const auto camera = open(folder.path());
  ASSERT_NE(camera, nullptr);
  EXPECT_EQ(camera->total(), 5);
  EXPECT_EQ(camera->width(), test::kTinyWidth);
  const auto seen = run_to_end(camera.get());
  ASSERT_EQ(seen.size(), 5u);
  for (int i = 0; i < 5; ++i) {
    const Seen& s = seen[static_cast<std::size_t>(i)];
    EXPECT_EQ(s.status, CameraStatus::kFrame);
    EXPECT_EQ(s.frame.sequence, static_cast<std::uint32_t>(i));
    EXPECT_EQ(s.frame.t_source_ns, 100'000'000'001 + i * 50'000'000);
    EXPECT_EQ(s.frame.t_capture_ns, rt::kNsPerSecond + i * 50'000'000) << "rebased, the same in every run";
    EXPECT_EQ(difference(s.grey, test::tiny_picture(i)), 0);
  }
  EXPECT_EQ(camera->counters().delivered, 5u);
}

TEST(ReplayCamera, SeveralPassesGoForthAndBackWithoutAJump) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 4);
  ReplayOptions options;
  options.passes = 3;
  const auto camera = open(folder.path(), options);
  ASSERT_NE(camera, nullptr);
  EXPECT_EQ(camera->total(), 10);
  const auto seen = run_to_end(camera.get());
  ASSERT_EQ(seen.size(), 10u);
  const int pictures[] = {0, 1, 2, 3, 2, 1, 0, 1, 2, 3};
  for (int i = 0; i < 10; ++i) {
    const Seen& s = seen[static_cast<std::size_t>(i)];
    EXPECT_EQ(difference(s.grey, test::tiny_picture(pictures[i])), 0) << i;
    EXPECT_EQ(s.frame.sequence, static_cast<std::uint32_t>(i));
    EXPECT_EQ(s.frame.t_source_ns, 100'000'000'001 + i * 50'000'000) << i;
    EXPECT_EQ(s.frame.t_capture_ns, rt::kNsPerSecond + i * 50'000'000) << i;
  }
}

TEST(ReplayCamera, SeveralPassesMirrorUnevenTimesAndLeaveWrongOnesOut) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 4);
  write_file(folder / "rgb.txt", "1.0 rgb/0000.png\n1.1 rgb/0001.png\n1.1 rgb/0002.png\n1.4 rgb/0003.png\n");
  ReplayOptions options;
  options.passes = 2;
  const auto camera = open(folder.path(), options);
  ASSERT_NE(camera, nullptr);
  const auto seen = run_to_end(camera.get());
  ASSERT_EQ(seen.size(), 5u);
  const double times[] = {1.0, 1.1, 1.4, 1.7, 1.8};
  for (std::size_t i = 0; i < 5; ++i) {
    EXPECT_EQ(seen[i].status, CameraStatus::kFrame);
    EXPECT_NEAR(rt::to_seconds(seen[i].frame.t_source_ns), times[i], 1e-9);
  }
  options.frames = 1;
  EXPECT_THAT(refusal(folder.path(), options),
              HasSubstr("1 pictures with a time; to fly them forth and back takes two"));
}

TEST(ReplayCamera, StartAndFramesChooseAPart) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 6);
  ReplayOptions options;
  options.start = 2;
  options.frames = 3;
  const auto camera = open(folder.path(), options);
  ASSERT_NE(camera, nullptr);
  const auto seen = run_to_end(camera.get());
  ASSERT_EQ(seen.size(), 3u);
  EXPECT_EQ(difference(seen[0].grey, test::tiny_picture(2)), 0);
  EXPECT_EQ(seen[0].frame.sequence, 0u);
  EXPECT_EQ(seen[2].frame.t_source_ns, 100'200'000'001);
  options.start = 6;
  EXPECT_THAT(refusal(folder.path(), options), HasSubstr("lists 6 pictures; a start at picture 6 leaves none"));
}

TEST(ReplayCamera, BadPicturesInTheMiddleAreNamedCountedAndPassed) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 10);
  std::filesystem::remove(folder / "rgb/0001.png");
  const std::string whole = read_file(folder / "rgb/0002.png");
  write_file(folder / "rgb/0002.png", whole.substr(0, whole.size() / 2));
  write_file(folder / "rgb/0003.png", "this is text, not a picture\n");
  cv::imwrite(folder / "rgb/0004.png", cv::Mat(60, 80, CV_8UC1, cv::Scalar(9)));
  write_file(folder / "rgb/0005.png", "");
  cv::imwrite(folder / "rgb/0006.png", cv::Mat(test::kTinyHeight, test::kTinyWidth, CV_16UC1, cv::Scalar(9)));
  std::filesystem::remove(folder / "rgb/0007.png");
  std::filesystem::create_directory(folder / "rgb/0007.png");
  const auto camera = open(folder.path());
  ASSERT_NE(camera, nullptr);
  const auto seen = run_to_end(camera.get());
  ASSERT_EQ(seen.size(), 10u);
  const char* const reasons[] = {"",
                                 "No such file",
                                 "cut off",
                                 "not a picture",
                                 "80 x 60 pixels; the calibration says 160 x 120",
                                 "the file is empty",
                                 "1 channels of 16 bits",
                                 "Is a directory",
                                 ""};
  for (std::size_t i = 1; i <= 7; ++i) {
    EXPECT_EQ(seen[i].status, CameraStatus::kBadFrame) << i;
    EXPECT_THAT(seen[i].why, HasSubstr(reasons[i]));
    EXPECT_THAT(seen[i].why, HasSubstr("rgb/000" + std::to_string(i) + ".png"));
    EXPECT_EQ(seen[i].frame.sequence, i);
  }
  EXPECT_EQ(seen[8].status, CameraStatus::kFrame);
  EXPECT_EQ(difference(seen[8].grey, test::tiny_picture(8)), 0);
  EXPECT_EQ(camera->counters().bad_pictures, 7u);
  EXPECT_EQ(camera->counters().delivered, 3u);
}

TEST(ReplayCamera, ATruncatedJpegIsBadAlthoughTheDecoderWouldFillItUp) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 2);
  cv::imwrite(folder / "whole.jpg", test::tiny_picture(0));
  const std::string whole = read_file(folder / "whole.jpg");
  write_file(folder / "cut.jpg", whole.substr(0, whole.size() * 2 / 3));
  write_file(folder / "rgb.txt", "1 whole.jpg\n2 cut.jpg\n");
  const auto camera = open(folder.path());
  ASSERT_NE(camera, nullptr);
  const auto seen = run_to_end(camera.get());
  EXPECT_EQ(seen[0].status, CameraStatus::kFrame);
  EXPECT_EQ(seen[1].status, CameraStatus::kBadFrame);
  EXPECT_THAT(seen[1].why, HasSubstr("cut.jpg: the picture is cut off"));
}

TEST(ReplayCamera, TimesThatRepeatOrGoBackAreSkippedAndCounted) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 4);
  write_file(folder / "rgb.txt", "1.0 rgb/0000.png\n1.0 rgb/0001.png\n0.5 rgb/0002.png\n2.0 rgb/0003.png\n");
  const auto camera = open(folder.path());
  ASSERT_NE(camera, nullptr);
  const auto seen = run_to_end(camera.get());
  ASSERT_EQ(seen.size(), 4u) << "each listed picture has its place, also the skipped ones";
  EXPECT_EQ(seen[1].status, CameraStatus::kBadFrame);
  EXPECT_THAT(seen[1].why, HasSubstr("rgb.txt:2: time 1.000000000 repeats"));
  EXPECT_THAT(seen[2].why, HasSubstr("rgb.txt:3: time 0.500000000 goes back"));
  EXPECT_EQ(seen[2].frame.t_source_ns, 500'000'000);
  EXPECT_EQ(seen[3].status, CameraStatus::kFrame);
  EXPECT_EQ(camera->counters().time_repeated, 1u);
  EXPECT_EQ(camera->counters().time_went_back, 1u);
}

TEST(ReplayCamera, OtherChannelCountsBecomeGreyByTheUsualWeights) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 1);
  cv::imwrite(folder / "bgr.png", cv::Mat(test::kTinyHeight, test::kTinyWidth, CV_8UC3, cv::Scalar(200, 100, 50)));
  cv::imwrite(folder / "bgra.png", cv::Mat(test::kTinyHeight, test::kTinyWidth, CV_8UC4, cv::Scalar(200, 100, 50, 7)));
  write_file(folder / "rgb.txt", "1 bgr.png\n2 bgra.png\n");
  const auto camera = open(folder.path());
  ASSERT_NE(camera, nullptr);
  for (const Seen& s : run_to_end(camera.get())) {
    ASSERT_EQ(s.status, CameraStatus::kFrame);
    EXPECT_NEAR(s.grey.at<unsigned char>(5, 5), 0.114 * 200 + 0.587 * 100 + 0.299 * 50, 0.6);
  }
}

TEST(ReplayCamera, GivesColourWhereTheSourceHasIt) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 1);
  std::string yaml = test::tiny_camera_yaml();
  yaml.replace(yaml.find("image_channels: 1"), 17, "image_channels: 3");
  write_file(folder / "camera.yaml", yaml);
  cv::imwrite(folder / "rgb/0000.png", cv::Mat(test::kTinyHeight, test::kTinyWidth, CV_8UC3, cv::Scalar(200, 100, 50)));
  const auto camera = open(folder.path());
  ASSERT_NE(camera, nullptr);
  EXPECT_EQ(camera->channels(), 3);
  std::vector<std::uint8_t> grey(test::kTinyWidth * test::kTinyHeight), bgr(grey.size() * 3);
  CapturedFrame frame;
  ASSERT_EQ(camera->next({grey.data(), test::kTinyWidth, test::kTinyHeight, test::kTinyWidth}, bgr.data(), 0, &frame,
                         nullptr),
            CameraStatus::kFrame);
  EXPECT_EQ(bgr[0], 200);
  EXPECT_EQ(bgr[1], 100);
  EXPECT_EQ(bgr[bgr.size() - 1], 50);
}

TEST(ReplayCamera, AnEmptyViewPassesThePictureOver) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 2);
  const auto camera = open(folder.path());
  ASSERT_NE(camera, nullptr);
  CapturedFrame frame;
  EXPECT_EQ(camera->next({}, nullptr, 0, &frame, nullptr), CameraStatus::kFrame);
  EXPECT_EQ(frame.sequence, 0u);
  EXPECT_EQ(camera->counters().passed_over, 1u);
  EXPECT_EQ(run_to_end(camera.get()).size(), 1u);
}

TEST(ReplayCamera, AtRealPaceNoPictureComesBeforeItsTime) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 4);
  ReplayOptions options;
  options.pace = ReplayOptions::Pace::kReal;
  const auto camera = open(folder.path(), options);
  ASSERT_NE(camera, nullptr);
  cv::Mat grey(test::kTinyHeight, test::kTinyWidth, CV_8UC1);
  rt::TimeNs first = 0;
  for (int i = 0; i < 4; ++i) {
    CapturedFrame frame;
    ASSERT_EQ(camera->next({grey.data, grey.cols, grey.rows, grey.cols}, nullptr, rt::kNsPerSecond, &frame, nullptr),
              CameraStatus::kFrame);
    EXPECT_GE(rt::monotonic_now_ns(), frame.t_capture_ns);
    if (i == 0) first = frame.t_capture_ns;
    EXPECT_EQ(frame.t_capture_ns - first, i * 50'000'000);
  }
}

TEST(ReplayCamera, AtRealPaceARollingShutterIsWaitedForToItsLastRow) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 2);
  write_file(folder / "camera.yaml", test::tiny_camera_yaml() + "shutter: rolling\nreadout_s: 0.04\n");
  ReplayOptions options;
  options.pace = ReplayOptions::Pace::kReal;
  const auto camera = open(folder.path(), options);
  ASSERT_NE(camera, nullptr);
  cv::Mat grey(test::kTinyHeight, test::kTinyWidth, CV_8UC1);
  CapturedFrame frame;
  for (int i = 0; i < 2; ++i) {
    ASSERT_EQ(camera->next({grey.data, grey.cols, grey.rows, grey.cols}, nullptr, rt::kNsPerSecond, &frame, nullptr),
              CameraStatus::kFrame);
    EXPECT_GE(rt::monotonic_now_ns(), frame.t_capture_ns + 20 * rt::kNsPerMs) << "captured at its middle row";
  }
}

TEST(ReplayCamera, AGapOfAnHourAtRealPaceIsWaitedForInPieces) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 2);
  write_file(folder / "rgb.txt", "100.0 rgb/0000.png\n3700.0 rgb/0001.png\n");
  ReplayOptions options;
  options.pace = ReplayOptions::Pace::kReal;
  const auto camera = open(folder.path(), options);
  ASSERT_NE(camera, nullptr);
  cv::Mat grey(test::kTinyHeight, test::kTinyWidth, CV_8UC1);
  const rt::MutableImageView view{grey.data, grey.cols, grey.rows, grey.cols};
  CapturedFrame frame;
  ASSERT_EQ(camera->next(view, nullptr, rt::kNsPerSecond, &frame, nullptr), CameraStatus::kFrame);
  alarm(60);  // one that waits for the hour fails, and is not waited for
  for (int i = 0; i < 3; ++i) {
    const rt::TimeNs begin = rt::monotonic_now_ns();
    EXPECT_EQ(camera->next(view, nullptr, 20 * rt::kNsPerMs, &frame, nullptr), CameraStatus::kTimeout);
    EXPECT_GE(rt::monotonic_now_ns() - begin, 20 * rt::kNsPerMs);
  }
  alarm(0);
  EXPECT_EQ(camera->counters().delivered, 1u);
}

TEST(ReplayCamera, AtRealPaceWhoFellBehindIsSoonWhereACameraWouldBe) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 2);
  ReplayOptions options;
  options.pace = ReplayOptions::Pace::kReal;
  options.passes = 1'000'000;
  const auto camera = open(folder.path(), options);
  ASSERT_NE(camera, nullptr);
  cv::Mat grey(test::kTinyHeight, test::kTinyWidth, CV_8UC1);
  const rt::MutableImageView view{grey.data, grey.cols, grey.rows, grey.cols};
  CapturedFrame frame;
  std::string why;
  ASSERT_EQ(camera->next(view, nullptr, rt::kNsPerSecond, &frame, nullptr), CameraStatus::kFrame);
  rt::sleep_until_ns(rt::monotonic_now_ns() + 2 * rt::kNsPerSecond);
  int passed_over = 0;
  while (camera->next(view, nullptr, rt::kNsPerSecond, &frame, &why) == CameraStatus::kBadFrame) {
    ++passed_over;
    EXPECT_THAT(why, HasSubstr("too late: passed over unread"));
  }
  EXPECT_GE(passed_over, 29) << "a second and a half of them";
  EXPECT_EQ(camera->counters().too_late, static_cast<std::uint64_t>(passed_over));
  EXPECT_EQ(camera->counters().delivered, 2u);
}

TEST(ReplayCamera, ReadsTheEurocLayoutFromAllThreeFolders) {
  const TempFolder folder;
  const std::string cam0 = folder / "mav0/cam0";
  write_file(cam0 + "/data.csv", "#timestamp [ns],filename\n1403636579763555584,1403636579763555584.png\n");
  write_file(cam0 + "/sensor.yaml",
             "camera_model: pinhole\nresolution: [160, 120]\nintrinsics: [130, 130, 80, 60]\n"
             "distortion_model: radial-tangential\ndistortion_coefficients: [0, 0, 0, 0]\nrate_hz: 20\n");
  std::filesystem::create_directories(cam0 + "/data");
  cv::imwrite(cam0 + "/data/1403636579763555584.png", test::tiny_picture(3));
  for (const std::string& start : {std::string(folder.path()), folder / "mav0", cam0}) {
    const auto camera = open(start);
    ASSERT_NE(camera, nullptr);
    const auto seen = run_to_end(camera.get());
    ASSERT_EQ(seen.size(), 1u);
    EXPECT_EQ(seen[0].status, CameraStatus::kFrame) << seen[0].why;
    EXPECT_EQ(seen[0].frame.t_source_ns, 1403636579763555584);
    EXPECT_EQ(difference(seen[0].grey, test::tiny_picture(3)), 0);
  }
}

TEST(ReplayCamera, RefusesWhatIsNoSequence) {
  const TempFolder folder;
  EXPECT_THAT(refusal(folder / "absent"), HasSubstr("absent: No such file"));
  EXPECT_THAT(refusal(folder.path()), HasSubstr("neither rgb.txt (TUM layout) nor mav0/cam0/data.csv"));
  write_file(folder / "file", "x");
  EXPECT_THAT(refusal(folder / "file"), HasSubstr("not a folder"));
  test::write_tiny_tum(folder.path(), 1);
  std::filesystem::remove(folder / "camera.yaml");
  EXPECT_THAT(refusal(folder.path()), HasSubstr("camera.yaml: No such file or directory (the camera's calibration"));
  test::write_tiny_tum(folder.path(), 1);
  write_file(folder / "rgb.txt", "");
  EXPECT_THAT(refusal(folder.path()), HasSubstr("rgb.txt: lists no pictures"));
}

TEST(ReplayCamera, RefusesACalibrationOfAnotherSize) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 8);
  std::string yaml = test::tiny_camera_yaml();
  yaml.replace(yaml.find("width: 160"), 10, "width: 170");
  write_file(folder / "camera.yaml", yaml);
  EXPECT_THAT(refusal(folder.path()), HasSubstr("camera.yaml: width, height: 170 x 120 pixels, but"));
}

TEST(ReplayCamera, OneWrongPictureAtTheBeginningDoesNotRefuseTheSequence) {
  const TempFolder folder;
  test::write_tiny_tum(folder.path(), 3);
  cv::imwrite(folder / "rgb/0000.png", cv::Mat(60, 80, CV_8UC1, cv::Scalar(9)));
  const auto camera = open(folder.path());
  ASSERT_NE(camera, nullptr);
  EXPECT_EQ(run_to_end(camera.get())[0].status, CameraStatus::kBadFrame);
}

TEST(PictureIsWhole, KnowsTheEndsOfJpegAndPng) {
  using Bytes = std::vector<std::uint8_t>;
  EXPECT_TRUE(picture_is_whole(Bytes{0xFF, 0xD8, 0xFF, 0xD9}));
  EXPECT_TRUE(picture_is_whole(Bytes{0xFF, 0xD8, 0xFF, 0xD9, 0, 0})) << "padded with zeros";
  EXPECT_FALSE(picture_is_whole(Bytes{0xFF, 0xD8, 0xFF}));
  EXPECT_FALSE(picture_is_whole(Bytes{0xFF, 0xD8}));
  EXPECT_FALSE(picture_is_whole(Bytes{0x89, 'P', 'N', 'G', '\r', '\n', 0x1A, '\n'}));
  EXPECT_TRUE(picture_is_whole(Bytes{'P', '5', '\n'})) << "other formats are the decoder's business";
  EXPECT_TRUE(picture_is_whole(Bytes{}));
}

}  // namespace
}  // namespace godwit::hal::replay_camera_test
