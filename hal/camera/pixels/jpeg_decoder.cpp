#include "hal/camera/pixels/jpeg_decoder.h"

#include <csetjmp>
#include <cstdio>
// libjpeg's header needs FILE and size_t before it.
#include <jpeglib.h>

namespace godwit::hal {

/// libjpeg leaves by a jump where it cannot go on: everything that a jump passes over is plain data.
struct JpegDecoder::Jpeg {
  jpeg_decompress_struct cinfo{};
  jpeg_error_mgr errors{};
  std::jmp_buf leave;

  /// The part that libjpeg may jump out of. Returns as JpegDecoder::decode does.
  const char* decode(const std::uint8_t* data, std::size_t bytes, const rt::MutableImageView& grey, std::uint8_t* bgr);
};

namespace {

void on_error(j_common_ptr info) {
  std::longjmp(*static_cast<std::jmp_buf*>(info->client_data), 1);
}

/// Warnings are what a cut-off picture gives: the decoder would fill it up with grey.
void on_message(j_common_ptr info, int level) {
  if (level < 0) ++info->err->num_warnings;
}

void on_output(j_common_ptr /*info*/) {}

/// BT.601 in 1/256, as the usual conversions round.
std::uint8_t luma(const std::uint8_t* bgr) {
  return static_cast<std::uint8_t>((29 * bgr[0] + 150 * bgr[1] + 77 * bgr[2] + 128) >> 8);
}

}  // namespace

JpegDecoder::JpegDecoder() : jpeg_(std::make_unique<Jpeg>()) {
  jpeg_->cinfo.err = jpeg_std_error(&jpeg_->errors);
  jpeg_->errors.error_exit = on_error;
  jpeg_->errors.emit_message = on_message;
  jpeg_->errors.output_message = on_output;
  jpeg_->cinfo.client_data = &jpeg_->leave;
  jpeg_create_decompress(&jpeg_->cinfo);
}

JpegDecoder::~JpegDecoder() {
  jpeg_destroy_decompress(&jpeg_->cinfo);
}

const char* JpegDecoder::Jpeg::decode(const std::uint8_t* data, std::size_t bytes, const rt::MutableImageView& grey,
                                      std::uint8_t* bgr) {
  if (setjmp(leave) != 0) return "not a JPEG, or a broken one";
  jpeg_mem_src(&cinfo, data, static_cast<unsigned long>(bytes));
  errors.num_warnings = 0;
  jpeg_read_header(&cinfo, TRUE);
  if (static_cast<int>(cinfo.image_width) != grey.width || static_cast<int>(cinfo.image_height) != grey.height) {
    return "the JPEG has another size than the device said";
  }
  cinfo.out_color_space = bgr != nullptr ? JCS_EXT_BGR : JCS_GRAYSCALE;
  cinfo.dct_method = JDCT_ISLOW;
  jpeg_start_decompress(&cinfo);
  while (cinfo.output_scanline < cinfo.output_height) {
    const int y = static_cast<int>(cinfo.output_scanline);
    JSAMPROW row = bgr != nullptr ? bgr + static_cast<std::ptrdiff_t>(y) * grey.width * 3 : grey.row(y);
    jpeg_read_scanlines(&cinfo, &row, 1);
    if (bgr == nullptr) continue;
    std::uint8_t* const to = grey.row(y);
    for (int x = 0; x < grey.width; ++x) to[x] = luma(row + 3 * static_cast<std::ptrdiff_t>(x));
  }
  jpeg_finish_decompress(&cinfo);
  return errors.num_warnings > 0 ? "the JPEG is cut off or damaged" : nullptr;
}

const char* JpegDecoder::decode(const std::uint8_t* data, std::size_t bytes, const rt::MutableImageView& grey,
                                std::uint8_t* bgr) {
  const char* const wrong = jpeg_->decode(data, bytes, grey, bgr);
  jpeg_abort_decompress(&jpeg_->cinfo);
  return wrong;
}

}  // namespace godwit::hal
