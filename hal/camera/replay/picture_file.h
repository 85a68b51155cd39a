// One picture file into grey (and colour) pixels. Allocates and decodes: feeder threads only, never armed ones.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "hal/camera/replay/picture_codec.h"
#include "hal/rt/image.h"
#include "hal/rt/result.h"

namespace godwit::hal {

/// Decodes picture files with buffers kept from call to call. One thread.
class PictureDecoder {
 public:
  /// Reads and decodes; width() and height() are valid after success. JPEG and PNG of 8 bits a channel, grey or colour.
  /// Error: missing, unreadable, empty, not a picture, cut off, too large or of another depth; names the file.
  rt::Result<void> load(const std::string& file);
  int width() const { return picture_.width; }
  int height() const { return picture_.height; }

  /// Writes the loaded picture as grey; 0.299 R + 0.587 G + 0.114 B from colour. Precondition: the sizes are equal.
  void write_grey(const rt::MutableImageView& grey) const;
  /// Writes it as BGR, width * 3 bytes a row without padding; from grey three equal channels.
  void write_bgr(std::uint8_t* bgr) const;

 private:
  DecodedPicture picture_;
};

/// The file's end is there: JPEG ends with its end marker, PNG with its IEND chunk. Decoders fill in what is missing
/// without a word, which would be flown as if it had been seen. True for formats that are neither.
bool picture_is_whole(std::span<const std::uint8_t> bytes);

}  // namespace godwit::hal
