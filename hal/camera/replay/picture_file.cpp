#include "hal/camera/replay/picture_file.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "hal/record_file.h"

namespace godwit::hal {

struct PictureDecoder::Impl {
  cv::Mat picture;
};

PictureDecoder::PictureDecoder() : impl_(new Impl) {}
PictureDecoder::~PictureDecoder() {
  delete impl_;
}

bool picture_is_whole(std::span<const std::uint8_t> bytes) {
  constexpr std::array<std::uint8_t, 8> kPng = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1A, '\n'};
  // Writers may pad the end with zeros; IEND itself ends with the CRC AE 42 60 82.
  while (!bytes.empty() && bytes.back() == 0) bytes = bytes.first(bytes.size() - 1);
  if (bytes.size() >= 2 && bytes[0] == 0xFF && bytes[1] == 0xD8) {
    return bytes.size() >= 4 && bytes[bytes.size() - 2] == 0xFF && bytes.back() == 0xD9;
  }
  if (bytes.size() >= kPng.size() && std::equal(kPng.begin(), kPng.end(), bytes.begin())) {
    constexpr std::array<std::uint8_t, 8> kEnd = {'I', 'E', 'N', 'D', 0xAE, 0x42, 0x60, 0x82};
    return bytes.size() >= 20 && std::equal(kEnd.begin(), kEnd.end(), bytes.end() - 8);
  }
  return true;
}

rt::Result<void> PictureDecoder::load(const std::string& file) {
  impl_->picture.release();
  auto bytes = read_whole_file(file);
  if (!bytes) return bytes.error();
  if (bytes.value().empty()) return rt::Error{file + ": the file is empty"};
  if (!picture_is_whole(bytes.value())) return rt::Error{file + ": the picture is cut off"};
  try {
    // As stored: no rotation by EXIF, which would swap width and height behind the calibration's back.
    impl_->picture = cv::imdecode(bytes.value(), cv::IMREAD_UNCHANGED | cv::IMREAD_IGNORE_ORIENTATION);
  } catch (const std::exception& e) {  // cv::Exception, std::bad_alloc on an absurd size
    return rt::Error{file + ": not decodable: " + e.what()};
  }
  const cv::Mat& m = impl_->picture;
  if (m.empty()) return rt::Error{file + ": not a picture that can be decoded"};
  const bool channels_ok = m.channels() == 1 || m.channels() == 3 || m.channels() == 4;
  if (m.depth() != CV_8U || !channels_ok) {
    const std::string what =
        std::to_string(m.channels()) + " channels of " + std::to_string(8 * m.elemSize1()) + " bits";
    impl_->picture.release();
    return rt::Error{file + ": " + what + "; 1, 3 or 4 channels of 8 bits are wanted"};
  }
  return {};
}

int PictureDecoder::width() const {
  return impl_->picture.cols;
}
int PictureDecoder::height() const {
  return impl_->picture.rows;
}

void PictureDecoder::write_grey(const rt::MutableImageView& grey) const {
  const cv::Mat& m = impl_->picture;
  assert(grey.width == m.cols && grey.height == m.rows);
  cv::Mat out(grey.height, grey.width, CV_8UC1, grey.data, static_cast<std::size_t>(grey.stride));
  if (m.channels() == 1) m.copyTo(out);
  if (m.channels() == 3) cv::cvtColor(m, out, cv::COLOR_BGR2GRAY);
  if (m.channels() == 4) cv::cvtColor(m, out, cv::COLOR_BGRA2GRAY);
}

void PictureDecoder::write_bgr(std::uint8_t* bgr) const {
  const cv::Mat& m = impl_->picture;
  cv::Mat out(m.rows, m.cols, CV_8UC3, bgr);
  if (m.channels() == 1) cv::cvtColor(m, out, cv::COLOR_GRAY2BGR);
  if (m.channels() == 3) m.copyTo(out);
  if (m.channels() == 4) cv::cvtColor(m, out, cv::COLOR_BGRA2BGR);
}

}  // namespace godwit::hal
