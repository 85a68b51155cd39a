#include "hal/camera/replay/picture_codec.h"

#include <algorithm>
#include <array>
#include <csetjmp>
#include <cstdio>
#include <cstring>
#include <png.h>
// libjpeg's header needs FILE and size_t before it.
#include <jpeglib.h>

namespace godwit::hal {
namespace {

constexpr const char* kBroken = "not a picture that can be decoded";

std::string size_refused(std::uint32_t width, std::uint32_t height) {
  return std::to_string(width) + " x " + std::to_string(height) + " pixels; at most " + std::to_string(kWidestPicture) +
         " x " + std::to_string(kWidestPicture) + " are read";
}

std::string depth_refused(int channels, int bits) {
  return std::to_string(channels) + " channels of " + std::to_string(bits) +
         " bits; 1, 3 or 4 channels of 8 bits are wanted";
}

bool too_large(std::uint32_t width, std::uint32_t height) {
  return width == 0 || height == 0 || width > kWidestPicture || height > kWidestPicture;
}

void take_size(std::uint32_t width, std::uint32_t height, int channels, DecodedPicture* out) {
  out->width = static_cast<int>(width);
  out->height = static_cast<int>(height);
  out->channels = channels;
  out->pixels.resize(std::size_t{width} * height * static_cast<std::size_t>(channels));
}

std::uint8_t* row_of(DecodedPicture* picture, std::uint32_t y) {
  return picture->pixels.data() + std::size_t{y} * static_cast<std::size_t>(picture->width * picture->channels);
}

/// Both libraries leave by a jump where they cannot go on. What they jump over is plain data, held here.
struct Png {
  std::span<const std::uint8_t> left;
  png_structp png = nullptr;
  png_infop info = nullptr;
  std::uint32_t width = 0, height = 0;
  int bits = 0, kind = 0, passes = 1;

  explicit Png(std::span<const std::uint8_t> bytes) : left(bytes) {
    png = png_create_read_struct(PNG_LIBPNG_VER_STRING, nullptr, on_error, [](png_structp, png_const_charp) {});
    if (png != nullptr) info = png_create_info_struct(png);
  }
  ~Png() { png_destroy_read_struct(&png, &info, nullptr); }
  Png(const Png&) = delete;
  Png& operator=(const Png&) = delete;

  [[noreturn]] static void on_error(png_structp p, png_const_charp) { png_longjmp(p, 1); }
  static void read(png_structp p, png_bytep to, std::size_t count) {
    auto* const self = static_cast<Png*>(png_get_io_ptr(p));
    if (count > self->left.size()) on_error(p, nullptr);
    std::memcpy(to, self->left.data(), count);
    self->left = self->left.subspan(count);
  }
  bool read_header() {
    if (info == nullptr || setjmp(png_jmpbuf(png)) != 0) return false;
    png_set_read_fn(png, this, read);
    png_set_user_limits(png, 0x7FFFFFFF, 0x7FFFFFFF);  // the words on size are ours
    png_read_info(png, info);
    png_get_IHDR(png, info, &width, &height, &bits, &kind, nullptr, nullptr, nullptr);
    return true;
  }
  /// Grey or BGR, one byte a channel, from here on.
  bool set_up() {
    if (setjmp(png_jmpbuf(png)) != 0) return false;
    if (kind == PNG_COLOR_TYPE_PALETTE) png_set_palette_to_rgb(png);
    if (kind == PNG_COLOR_TYPE_GRAY && bits < 8) png_set_expand_gray_1_2_4_to_8(png);
    png_set_strip_alpha(png);
    png_set_bgr(png);
    passes = png_set_interlace_handling(png);
    png_read_update_info(png, info);
    return true;
  }
  bool read_rows(DecodedPicture* out) {
    if (setjmp(png_jmpbuf(png)) != 0) return false;
    for (int pass = 0; pass < passes; ++pass) {
      for (std::uint32_t y = 0; y < height; ++y) png_read_row(png, row_of(out, y), nullptr);
    }
    png_read_end(png, nullptr);
    return true;
  }
};

std::string decode_png(std::span<const std::uint8_t> bytes, DecodedPicture* out) {
  Png png(bytes);
  if (!png.read_header()) return kBroken;
  if (too_large(png.width, png.height)) return size_refused(png.width, png.height);
  if (png.bits > 8) return depth_refused(png_get_channels(png.png, png.info), png.bits);
  if (!png.set_up()) return kBroken;
  const int channels = png_get_channels(png.png, png.info);
  if (channels != 1 && channels != 3) return depth_refused(channels, 8);
  take_size(png.width, png.height, channels, out);
  return png.read_rows(out) ? "" : kBroken;
}

struct Jpeg {
  jpeg_decompress_struct cinfo{};
  jpeg_error_mgr errors{};
  std::jmp_buf leave;

  Jpeg() {
    cinfo.err = jpeg_std_error(&errors);
    errors.error_exit = [](j_common_ptr info) { std::longjmp(*static_cast<std::jmp_buf*>(info->client_data), 1); };
    errors.emit_message = [](j_common_ptr, int) {};
    errors.output_message = [](j_common_ptr) {};
    cinfo.client_data = &leave;
    jpeg_create_decompress(&cinfo);
  }
  ~Jpeg() { jpeg_destroy_decompress(&cinfo); }
  Jpeg(const Jpeg&) = delete;
  Jpeg& operator=(const Jpeg&) = delete;

  bool read_header(std::span<const std::uint8_t> bytes) {
    if (setjmp(leave) != 0) return false;
    jpeg_mem_src(&cinfo, bytes.data(), static_cast<unsigned long>(bytes.size()));
    return jpeg_read_header(&cinfo, TRUE) == JPEG_HEADER_OK;
  }
  bool read_rows(DecodedPicture* out) {
    if (setjmp(leave) != 0) return false;
    cinfo.out_color_space = out->channels == 1 ? JCS_GRAYSCALE : JCS_EXT_BGR;
    jpeg_start_decompress(&cinfo);
    while (cinfo.output_scanline < cinfo.output_height) {
      JSAMPROW row = row_of(out, cinfo.output_scanline);
      jpeg_read_scanlines(&cinfo, &row, 1);
    }
    jpeg_finish_decompress(&cinfo);
    return true;
  }
};

std::string decode_jpeg(std::span<const std::uint8_t> bytes, DecodedPicture* out) {
  Jpeg jpeg;
  if (!jpeg.read_header(bytes)) return kBroken;
  const jpeg_decompress_struct& header = jpeg.cinfo;
  if (too_large(header.image_width, header.image_height)) return size_refused(header.image_width, header.image_height);
  if (header.num_components != 1 && header.num_components != 3) return depth_refused(header.num_components, 8);
  take_size(header.image_width, header.image_height, header.num_components, out);
  return jpeg.read_rows(out) ? "" : kBroken;
}

}  // namespace

bool is_jpeg(std::span<const std::uint8_t> bytes) {
  return bytes.size() >= 2 && bytes[0] == 0xFF && bytes[1] == 0xD8;
}

bool is_png(std::span<const std::uint8_t> bytes) {
  constexpr std::array<std::uint8_t, 8> kHead = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1A, '\n'};
  return bytes.size() >= kHead.size() && std::equal(kHead.begin(), kHead.end(), bytes.begin());
}

std::string decode_picture(std::span<const std::uint8_t> bytes, DecodedPicture* out) {
  if (is_jpeg(bytes)) return decode_jpeg(bytes, out);
  if (is_png(bytes)) return decode_png(bytes, out);
  return std::string(kBroken) + ": neither a JPEG nor a PNG";
}

}  // namespace godwit::hal
