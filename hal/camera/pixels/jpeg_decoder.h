// JPEG pictures out of a camera (MJPEG), with libjpeg-turbo.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "hal/rt/image.h"

namespace godwit::hal {

/// One thread, and none that is real-time: libjpeg allocates while it decodes.
class JpegDecoder {
 public:
  JpegDecoder();
  ~JpegDecoder();
  JpegDecoder(const JpegDecoder&) = delete;
  JpegDecoder& operator=(const JpegDecoder&) = delete;

  /// Decodes into grey (the luma as it stands) and, where bgr is not null, as BGR; then grey is the luma of that.
  /// Returns what is wrong with the picture, static text: not a JPEG, cut off, of another size than grey; null:
  /// nothing.
  const char* decode(const std::uint8_t* data, std::size_t bytes, const rt::MutableImageView& grey, std::uint8_t* bgr);

 private:
  struct Jpeg;
  std::unique_ptr<Jpeg> jpeg_;
};

}  // namespace godwit::hal
