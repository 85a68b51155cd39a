// Pictures laid on surfaces: periodic, with a chain of half-sampled levels so that a far surface does not shimmer.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "hal/sim/world/random.h"

namespace godwit::sim {

/// A square picture being painted: brightness 0..255 and grain (how strongly fine detail modulates it; 128 = by half).
/// Coordinates are texels; everything wraps around. 8 bits a channel, because the ground has 16 million texels.
class Canvas {
 public:
  /// size: a power of two.
  explicit Canvas(int size);
  int size() const { return size_; }

  void fill(double brightness, double grain);
  /// Rectangle around (cx, cy), half extents along and across the direction (dx, dy) [unit], with a soft edge of about
  /// a texel. Leaves pixels outside alone.
  void rect(double cx, double cy, double dx, double dy, double half_along, double half_across, double brightness,
            double grain);
  /// Axis-aligned rectangle from (x0, y0) to (x1, y1).
  void box(double x0, double y0, double x1, double y1, double brightness, double grain);
  void disc(double cx, double cy, double radius, double brightness, double grain);
  /// Multiplies brightness by 1 + amplitude * noise, noise of zero mean whose blobs are cell texels wide (a power of
  /// two), summed over all cells, weighted by grain / 128 where by_grain.
  void noise(std::span<const int> cells, double amplitude, std::uint64_t seed, bool by_grain);
  /// Multiplies the brightness of one row, texel by texel.
  void scale_row(int y, std::span<const float> factors);

  std::uint8_t brightness(int x, int y) const { return brightness_[index(x, y)]; }
  std::uint8_t grain(int x, int y) const { return grain_[index(x, y)]; }

 private:
  std::size_t index(int x, int y) const {
    const int m = size_ - 1;
    return (y & m) * size_ + (x & m);
  }
  void blend(int x, int y, double cover, double brightness, double grain);

  int size_;
  std::vector<std::uint8_t> brightness_, grain_;
};

/// A finished picture. Each 32-bit texel holds what a bilinear lookup needs, so that one load serves it: the halved
/// brightness (7 bits, dithered) of the texel (x, y) in bits 0-6, of (x + 1, y) in 7-13, of (x, y + 1) in 14-20 and of
/// (x + 1, y + 1) in 21-27, and its grain / 16 in 28-31. Level l is texels[offset[l] + y * (size >> l) + x].
struct Texture {
  static constexpr int kMaxLevels = 14;
  int size = 0, levels = 0;
  int offset[kMaxLevels] = {};
  std::vector<std::uint32_t> texels;

  explicit Texture(const Canvas& canvas);
};

/// What surfaces can be made of.
enum TextureId : int {
  kTexDetail,
  kTexGround,
  kTexFacade0,
  kTexFacade1,
  kTexFacade2,
  kTexFacade3,
  kTexRoof0,
  kTexRoof1,
  kTexFoliage0,
  kTexFoliage1,
  kTexBark,
  kTexConcrete,
  kTexPlaster,
  kTexCarSide,
  kTexCarTop,
  kTexCarEnd,
  kTexGlass,
  kTexTruckSide0,
  kTexTruckSide1,
  kTexCloth0,
  kTexCloth1,
  kTexCloth2,
  kTexSkin,
  kTexCloud,
  kTexPoster0,
  kTexPoster1,
  kTexPoster2,
  kTexPoster3,
  kTexDoor,
  kTexTiles,
  kTextureCount
};

/// Texels a metre of the tiled materials (facades, roofs, foliage, bark, concrete, tiles, cloud at 1 texel a 4 m).
constexpr double kFacadeTexelsPerM = 32, kRoofTexelsPerM = 32, kFoliageTexelsPerM = 48, kConcreteTexelsPerM = 64,
                 kCloudTexelsPerM = 0.25, kDetailTexelsPerM = 100;

/// All but the ground, which the world's layout paints. night: windows are lit, walls dark.
std::vector<Texture> make_materials(std::uint64_t seed, const Canvas& ground, bool night);

}  // namespace godwit::sim
