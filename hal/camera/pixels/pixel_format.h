// The pictures that devices give, and how they become grey and BGR.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "hal/rt/image.h"

namespace godwit::hal {

/// V4L2's names: 16-bit ones are little-endian, Bayer ones hold 10 bits in 16, BGR3 and RGB3 are bytes in that order.
enum class PixelFormat : std::uint8_t { kGrey, kY10, kY16, kYuyv, kNv12, kRg10, kBa10, kBgr3, kRgb3, kMjpeg };

/// All of them, the cheapest to turn into grey first: the order in which a device's own are tried.
constexpr PixelFormat kPixelFormats[] = {PixelFormat::kGrey, PixelFormat::kNv12, PixelFormat::kYuyv, PixelFormat::kY10,
                                         PixelFormat::kY16,  PixelFormat::kBgr3, PixelFormat::kRgb3, PixelFormat::kRg10,
                                         PixelFormat::kBa10, PixelFormat::kMjpeg};

/// V4L2's code of four characters (videodev2.h).
std::uint32_t fourcc(PixelFormat format);
/// Static text, V4L2's: "GREY", "Y10", "Y16", "YUYV", "NV12", "RG10", "BA10", "BGR3",
/// "RGB3", "MJPG".
const char* name(PixelFormat format);
std::optional<PixelFormat> pixel_format_named(std::string_view text);
/// 1 grey, 3 colour.
int channels(PixelFormat format);
/// Bytes of a row without padding; 0 for MJPEG.
int row_bytes(PixelFormat format, int width);
/// Bytes that a whole picture takes with rows of `stride` bytes (the last row's padding may be missing); 0 for MJPEG.
std::size_t picture_bytes(PixelFormat format, int width, int height, int stride);
/// Bits to drop so that the format's brightest value becomes 255.
int usual_shift(PixelFormat format);

/// A picture as the driver left it in memory.
struct RawPicture {
  const std::uint8_t* data = nullptr;
  int stride = 0;  ///< bytes from row to row: sensors' drivers pad rows (Tegra to 64 bytes and more)
  PixelFormat format = PixelFormat::kGrey;
  int shift = 0;  ///< 10- and 16-bit formats: bits to drop; what is then above 255 becomes 255
};

/// Writes the picture as grey and, where bgr is not null, as BGR (width * 3 bytes a row; three times the grey where the
/// format has no colour). Not MJPEG. grey's size is the picture's; even for colour. Bayer: grey is the binomial 3 x 3
/// mean, which weighs red, green and blue 1 : 2 : 1 at every pixel; BGR has the colour of each 2 x 2 block. YUV:
/// BT.601, limited range; grey is the luma as it stands. RGB: see rgb_row. No allocation.
void convert(const RawPicture& raw, const rt::MutableImageView& grey, std::uint8_t* bgr);

}  // namespace godwit::hal
