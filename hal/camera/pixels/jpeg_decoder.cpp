#include "hal/camera/pixels/jpeg_decoder.h"

#include <csetjmp>
#include <cstdio>
#include <cstring>
// libjpeg's header needs FILE and size_t before it.
#include <jpeglib.h>

#include "hal/camera/pixels/rgb_rows.h"
#include "hal/camera/pixels/yuv_rows.h"

namespace godwit::hal {

/// libjpeg leaves by a jump where it cannot go on: everything that a jump passes over is plain data.
struct JpegDecoder::Jpeg {
  jpeg_decompress_struct cinfo{};
  jpeg_error_mgr errors{};
  std::jmp_buf leave;

  /// The part that libjpeg may jump out of. Returns as JpegDecoder::decode does.
  const char* decode(const std::uint8_t* data, std::size_t bytes, const rt::MutableImageView& grey, std::uint8_t* bgr);

 private:
  bool shares_chroma_as_cameras_do() const;
  void decode_planes(const rt::MutableImageView& grey, std::uint8_t* bgr);
  void decode_rows(const rt::MutableImageView& grey, std::uint8_t* bgr);
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

/// YCbCr, a pair of pixels with one chroma (4:2:2), or two rows of them (4:2:0).
bool JpegDecoder::Jpeg::shares_chroma_as_cameras_do() const {
  if (cinfo.jpeg_color_space != JCS_YCbCr || cinfo.num_components != 3) return false;
  const jpeg_component_info* const c = cinfo.comp_info;
  const auto single = [](const jpeg_component_info& i) { return i.h_samp_factor == 1 && i.v_samp_factor == 1; };
  return c[0].h_samp_factor == 2 && c[0].v_samp_factor <= 2 && single(c[1]) && single(c[2]);
}

/// The planes as they are coded, a row of blocks after the other: the luma is grey already, and the colours come from
/// rows that are still in the processor's cache. libjpeg's own way smooths the chroma first, and the luma would have to
/// be reckoned back out of the colours: twice the time.
void JpegDecoder::Jpeg::decode_planes(const rt::MutableImageView& grey, std::uint8_t* bgr) {
  cinfo.raw_data_out = TRUE;
  cinfo.out_color_space = JCS_YCbCr;
  jpeg_start_decompress(&cinfo);
  const int rows_a_chroma = cinfo.comp_info[0].v_samp_factor, rows = rows_a_chroma * DCTSIZE;
  // Whole blocks: libjpeg writes beyond the picture's edge.
  const auto blocks = (cinfo.image_width + 2 * DCTSIZE - 1) / (2 * DCTSIZE);
  JSAMPARRAY planes[3];
  for (int i = 0; i < 3; ++i) {
    planes[i] =
        cinfo.mem->alloc_sarray(reinterpret_cast<j_common_ptr>(&cinfo), JPOOL_IMAGE,
                                blocks * DCTSIZE * (i == 0 ? 2 : 1), static_cast<JDIMENSION>(i == 0 ? rows : DCTSIZE));
  }
  for (int top = 0; top < grey.height; top += rows) {
    jpeg_read_raw_data(&cinfo, planes, static_cast<JDIMENSION>(rows));
    for (int i = 0; i < rows && top + i < grey.height; ++i) {
      const std::uint8_t* const luma = planes[0][i];
      std::memcpy(grey.row(top + i), luma, grey.width);
      jpeg_row(luma, planes[1][i / rows_a_chroma], planes[2][i / rows_a_chroma], grey.width,
               bgr + static_cast<std::ptrdiff_t>(top + i) * grey.width * 3);
    }
  }
}

/// Any JPEG, as libjpeg turns it into grey or colours.
void JpegDecoder::Jpeg::decode_rows(const rt::MutableImageView& grey, std::uint8_t* bgr) {
  cinfo.out_color_space = bgr != nullptr ? JCS_EXT_BGR : JCS_GRAYSCALE;
  jpeg_start_decompress(&cinfo);
  while (cinfo.output_scanline < cinfo.output_height) {
    const int y = static_cast<int>(cinfo.output_scanline);
    JSAMPROW row = bgr != nullptr ? bgr + static_cast<std::ptrdiff_t>(y) * grey.width * 3 : grey.row(y);
    jpeg_read_scanlines(&cinfo, &row, 1);
    if (bgr != nullptr) rgb_row(row, grey.width, false, grey.row(y), nullptr);
  }
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
  cinfo.dct_method = JDCT_ISLOW;
  if (bgr != nullptr && shares_chroma_as_cameras_do()) {
    decode_planes(grey, bgr);
  } else {
    decode_rows(grey, bgr);
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
