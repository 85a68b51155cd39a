#include "hal/camera/pixels/pixel_format.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cstring>
#include <linux/videodev2.h>

#include "hal/camera/pixels/rgb_rows.h"
#include "hal/camera/pixels/yuv_rows.h"

namespace godwit::hal {
namespace {

struct Description {
  PixelFormat format;
  const char* name;
  std::uint32_t code;
  int channels;
  int bytes_a_pixel;  ///< of the first plane; 0: compressed
  int bits;
};

constexpr std::array<Description, 10> kDescriptions{{
    {PixelFormat::kGrey, "GREY", V4L2_PIX_FMT_GREY, 1, 1, 8},
    {PixelFormat::kY10, "Y10", V4L2_PIX_FMT_Y10, 1, 2, 10},
    {PixelFormat::kY16, "Y16", V4L2_PIX_FMT_Y16, 1, 2, 16},
    {PixelFormat::kYuyv, "YUYV", V4L2_PIX_FMT_YUYV, 3, 2, 8},
    {PixelFormat::kNv12, "NV12", V4L2_PIX_FMT_NV12, 3, 1, 8},
    {PixelFormat::kRg10, "RG10", V4L2_PIX_FMT_SRGGB10, 3, 2, 10},
    {PixelFormat::kBa10, "BA10", V4L2_PIX_FMT_SGRBG10, 3, 2, 10},
    {PixelFormat::kBgr3, "BGR3", V4L2_PIX_FMT_BGR24, 3, 3, 8},
    {PixelFormat::kRgb3, "RGB3", V4L2_PIX_FMT_RGB24, 3, 3, 8},
    {PixelFormat::kMjpeg, "MJPG", V4L2_PIX_FMT_MJPEG, 3, 0, 8},
}};

const Description& description(PixelFormat format) {
  return kDescriptions[static_cast<std::size_t>(format)];
}

int pixel16(const std::uint8_t* row, int x) {
  std::uint16_t value = 0;
  std::memcpy(&value, row + 2 * static_cast<std::ptrdiff_t>(x), 2);
  return value;
}

std::uint8_t byte_of(int value) {
  return static_cast<std::uint8_t>(std::clamp(value, 0, 255));
}

void grey_of_16_bits(const RawPicture& raw, const rt::MutableImageView& grey) {
  for (int y = 0; y < grey.height; ++y) {
    const std::uint8_t* const from = raw.data + static_cast<std::ptrdiff_t>(y) * raw.stride;
    std::uint8_t* const to = grey.row(y);
    for (int x = 0; x < grey.width; ++x)
      to[x] = static_cast<std::uint8_t>(std::min(255, pixel16(from, x) >> raw.shift));
  }
}

void convert_yuyv(const RawPicture& raw, const rt::MutableImageView& grey, std::uint8_t* bgr) {
  for (int y = 0; y < grey.height; ++y) {
    yuyv_row(raw.data + static_cast<std::ptrdiff_t>(y) * raw.stride, grey.width, grey.row(y),
             bgr == nullptr ? nullptr : bgr + static_cast<std::ptrdiff_t>(y) * grey.width * 3);
  }
}

void convert_nv12(const RawPicture& raw, const rt::MutableImageView& grey, std::uint8_t* bgr) {
  const std::uint8_t* const chroma = raw.data + static_cast<std::ptrdiff_t>(grey.height) * raw.stride;
  for (int y = 0; y < grey.height; ++y) {
    const std::uint8_t* const from = raw.data + static_cast<std::ptrdiff_t>(y) * raw.stride;
    std::memcpy(grey.row(y), from, static_cast<std::size_t>(grey.width));
    if (bgr == nullptr) continue;
    nv12_row(from, chroma + static_cast<std::ptrdiff_t>(y / 2) * raw.stride, grey.width,
             bgr + static_cast<std::ptrdiff_t>(y) * grey.width * 3);
  }
}

void convert_rgb(const RawPicture& raw, const rt::MutableImageView& grey, std::uint8_t* bgr) {
  for (int y = 0; y < grey.height; ++y) {
    rgb_row(raw.data + static_cast<std::ptrdiff_t>(y) * raw.stride, grey.width, raw.format == PixelFormat::kRgb3,
            grey.row(y), bgr == nullptr ? nullptr : bgr + static_cast<std::ptrdiff_t>(y) * grey.width * 3);
  }
}

/// The row above or below inside the picture, of the same colours as the one outside.
int mirrored(int y, int size) {
  return y < 0 ? -y : y >= size ? 2 * (size - 1) - y : y;
}

void convert_bayer(const RawPicture& raw, const rt::MutableImageView& grey, std::uint8_t* bgr) {
  const int w = grey.width, h = grey.height;
  const auto row = [&](int y) { return raw.data + static_cast<std::ptrdiff_t>(y) * raw.stride; };
  for (int y = 0; y < h; ++y) {
    const std::uint8_t* const above = row(mirrored(y - 1, h));
    const std::uint8_t* const here = row(y);
    const std::uint8_t* const below = row(mirrored(y + 1, h));
    const auto column = [&](int x) { return pixel16(above, x) + 2 * pixel16(here, x) + pixel16(below, x); };
    std::uint8_t* const to = grey.row(y);
    const auto write = [&](int x, int left, int right) {
      to[x] =
          static_cast<std::uint8_t>(std::min(255, (column(left) + 2 * column(x) + column(right)) >> (4 + raw.shift)));
    };
    write(0, 1, 1);
    for (int x = 1; x < w - 1; ++x) write(x, x - 1, x + 1);
    write(w - 1, w - 2, w - 2);
  }
  if (bgr == nullptr) return;
  const bool red_first = raw.format == PixelFormat::kRg10;  // RG/GB; otherwise GR/BG
  for (int y = 0; y + 1 < h; y += 2) {
    const std::uint8_t* const first = row(y);
    const std::uint8_t* const second = row(y + 1);
    std::uint8_t* const to = bgr + static_cast<std::ptrdiff_t>(y) * w * 3;
    for (int x = 0; x + 1 < w; x += 2) {
      const int a = pixel16(first, x), b = pixel16(first, x + 1), c = pixel16(second, x), d = pixel16(second, x + 1);
      const int red = red_first ? a : b, blue = red_first ? d : c;
      const int green = (red_first ? b + c : a + d) / 2;
      const std::uint8_t colour[3] = {byte_of(blue >> raw.shift), byte_of(green >> raw.shift),
                                      byte_of(red >> raw.shift)};
      for (const std::ptrdiff_t place : {0, 1, w, w + 1}) std::memcpy(to + 3 * (x + place), colour, 3);
    }
  }
}

}  // namespace

std::uint32_t fourcc(PixelFormat format) {
  return description(format).code;
}
const char* name(PixelFormat format) {
  return description(format).name;
}
int channels(PixelFormat format) {
  return description(format).channels;
}
int row_bytes(PixelFormat format, int width) {
  return description(format).bytes_a_pixel * width;
}
int usual_shift(PixelFormat format) {
  return description(format).bits - 8;
}

std::optional<PixelFormat> pixel_format_named(std::string_view text) {
  for (const Description& d : kDescriptions) {
    if (text == d.name) return d.format;
  }
  return std::nullopt;
}

std::size_t picture_bytes(PixelFormat format, int width, int height, int stride) {
  if (format == PixelFormat::kMjpeg) return 0;
  const int rows = format == PixelFormat::kNv12 ? height + height / 2 : height;
  return static_cast<std::size_t>(rows - 1) * static_cast<std::size_t>(stride) +
         static_cast<std::size_t>(row_bytes(format, width));
}

void convert(const RawPicture& raw, const rt::MutableImageView& grey, std::uint8_t* bgr) {
  const auto grey_into_bgr = [&] {
    if (bgr == nullptr) return;
    for (int y = 0; y < grey.height; ++y) {
      std::uint8_t* const to = bgr + static_cast<std::ptrdiff_t>(y) * grey.width * 3;
      for (int x = 0; x < grey.width; ++x) std::memset(to + 3 * static_cast<std::ptrdiff_t>(x), grey.row(y)[x], 3);
    }
  };
  switch (raw.format) {
    case PixelFormat::kGrey:
      for (int y = 0; y < grey.height; ++y) {
        std::memcpy(grey.row(y), raw.data + static_cast<std::ptrdiff_t>(y) * raw.stride,
                    static_cast<std::size_t>(grey.width));
      }
      return grey_into_bgr();
    case PixelFormat::kY10:
    case PixelFormat::kY16:
      grey_of_16_bits(raw, grey);
      return grey_into_bgr();
    case PixelFormat::kYuyv:
      return convert_yuyv(raw, grey, bgr);
    case PixelFormat::kNv12:
      return convert_nv12(raw, grey, bgr);
    case PixelFormat::kRg10:
    case PixelFormat::kBa10:
      return convert_bayer(raw, grey, bgr);
    case PixelFormat::kBgr3:
    case PixelFormat::kRgb3:
      return convert_rgb(raw, grey, bgr);
    case PixelFormat::kMjpeg:
      assert(false);  // JpegDecoder's
  }
}

}  // namespace godwit::hal
