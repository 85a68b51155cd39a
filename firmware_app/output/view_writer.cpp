#include "firmware_app/output/view_writer.h"

#include <filesystem>
#include <fmt/format.h>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

namespace godwit::app {
namespace {
const cv::Scalar kCorner(60, 220, 60), kEdgelet(0, 215, 255), kShaded(255, 120, 40);  // blue, green, red

cv::Mat colour_of(const rt::ImageView& grey) {
  // OpenCV takes no pointer to what it only reads; the picture is not written to.
  const cv::Mat view(grey.height, grey.width, CV_8UC1, const_cast<std::uint8_t*>(grey.data), grey.stride);
  cv::Mat out;
  cv::cvtColor(view, out, cv::COLOR_GRAY2BGR);
  return out;
}

void redden(const rt::ImageView& mask, cv::Mat* picture) {
  for (int y = 0; y < mask.height; ++y) {
    for (int x = 0; x < mask.width; ++x) {
      if (mask.at(x, y) == 0) continue;
      auto& p = picture->at<cv::Vec3b>(y, x);
      p = cv::Vec3b(static_cast<std::uint8_t>(p[0] / 2), static_cast<std::uint8_t>(p[1] / 2),
                    static_cast<std::uint8_t>(127 + p[2] / 2));
    }
  }
}
}  // namespace

rt::Result<ViewWriter> ViewWriter::open(const std::string& folder, std::int64_t every) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return rt::Error{folder + ": cannot be made: " + error.message()};
  return ViewWriter(folder, every);
}

void ViewWriter::look(const rt::FrameMeta& frame, const rt::ImageView& grey, const rt::MaskPyramidView& mask,
                      std::span<const vo::FrameFeature> features) {
  if (seen_++ % every_ != 0) return;
  const cv::Mat picture = colour_of(grey);
  cv::Mat masked = picture.clone();
  if (mask.levels > 0) redden(mask.level[0], &masked);
  cv::Mat found = masked.clone();
  for (const vo::FrameFeature& f : features) {
    const cv::Scalar& colour = f.shaded ? kShaded : f.type == vo::FeatureType::kCorner ? kCorner : kEdgelet;
    cv::circle(found, cv::Point2f(f.px.x(), f.px.y()), 2 + 2 * f.level, colour, 1, cv::LINE_AA);
  }
  cv::Mat all;
  cv::hconcat(std::array{picture, masked, found}, all);
  const std::string file = fmt::format("{}/{:06}.png", folder_, frame.sequence);
  bool done = false;
  std::string why = "not written";
  try {
    done = cv::imwrite(file, all);
  } catch (const cv::Exception& e) {
    why = e.what();
  }
  if (done) {
    ++written_;
  } else if (error_.empty()) {
    error_ = file + ": " + why;
  }
}

}  // namespace godwit::app
