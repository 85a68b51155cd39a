#include "hal/camera/replay/png_encoder.h"

#include <csetjmp>
#include <new>
#include <png.h>
#include <zlib.h>

namespace godwit::hal {
namespace {

/// libpng leaves by a jump where it cannot go on. What is jumped over is plain data, held here.
struct Png {
  png_structp png = nullptr;
  png_infop info = nullptr;
  std::vector<std::uint8_t>* out;

  explicit Png(std::vector<std::uint8_t>* to) : out(to) {
    png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, on_error, [](png_structp, png_const_charp) {});
    if (png != nullptr) info = png_create_info_struct(png);
  }
  ~Png() { png_destroy_write_struct(&png, &info); }
  Png(const Png&) = delete;
  Png& operator=(const Png&) = delete;

  [[noreturn]] static void on_error(png_structp p, png_const_charp) { png_longjmp(p, 1); }
  static bool append(std::vector<std::uint8_t>* to, png_bytep bytes, std::size_t count) {
    try {
      to->insert(to->end(), bytes, bytes + count);
      return true;
    } catch (const std::bad_alloc&) {
      return false;
    }
  }
  static void write(png_structp p, png_bytep bytes, std::size_t count) {
    if (!append(static_cast<Png*>(png_get_io_ptr(p))->out, bytes, count)) on_error(p, nullptr);
  }
  bool encode(const rt::ImageView& grey) {
    if (info == nullptr || setjmp(png_jmpbuf(png)) != 0) return false;
    png_set_write_fn(png, this, write, nullptr);
    png_set_IHDR(png, info, static_cast<png_uint_32>(grey.width), static_cast<png_uint_32>(grey.height), 8,
                 PNG_COLOR_TYPE_GRAY, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    // Differences to the left, and no search for repetitions: noise has none.
    png_set_filter(png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
    png_set_compression_level(png, 1);
    png_set_compression_strategy(png, Z_HUFFMAN_ONLY);
    png_write_info(png, info);
    for (int y = 0; y < grey.height; ++y) png_write_row(png, grey.row(y));
    png_write_end(png, nullptr);
    return true;
  }
};

}  // namespace

std::string encode_png(const rt::ImageView& grey, std::vector<std::uint8_t>* out) {
  out->clear();
  // What cannot be packed takes its own size, and a little.
  out->reserve(static_cast<std::size_t>(grey.width + 16) * static_cast<std::size_t>(grey.height) + 4096);
  Png png(out);
  return png.encode(grey) ? "" : "a picture cannot be packed";
}

}  // namespace godwit::hal
