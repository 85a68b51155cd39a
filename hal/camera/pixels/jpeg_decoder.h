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

  /// Decodes into grey, the luma as it stands, and, where bgr is not null, as BGR. Neighbours that share their chroma
  /// (4:2:2, 4:2:0: what cameras give) get the same, as in the other formats; of other pictures with colour grey is
  /// BT.601's of that.
  /// Returns what is wrong with the picture, static text: not a JPEG, cut off, of another size than grey; null:
  /// nothing.
  const char* decode(const std::uint8_t* data, std::size_t bytes, const rt::MutableImageView& grey, std::uint8_t* bgr);

 private:
  struct Jpeg;
  std::unique_ptr<Jpeg> jpeg_;
};

}  // namespace godwit::hal
