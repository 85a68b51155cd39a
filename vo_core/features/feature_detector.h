// Where new features come from: FAST corners with Shi-Tomasi score, chosen by a quadtree from the static rest of the
// picture, edgelets where corners fail (the paper, section 2.3.2; Rosten and Drummond 2006; Shi and Tomasi 1994).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "hal/rt/image.h"
#include "vo_core/geometry/geometry.h"
#include "vo_core/image/grey_noise.h"

namespace godwit::vo {

enum class FeatureType : std::uint8_t { kCorner, kEdgelet };

/// A feature found in one picture.
struct Feature {
  Vec2f px = Vec2f::Zero();         ///< level-0 pixels (centre convention of rt::PyramidView)
  Vec2f gradient = Vec2f::UnitX();  ///< unit gradient direction, used for edgelets
  float score = 0.0f;               ///< Shi-Tomasi: smaller eigenvalue, per pixel; edgelets: gradient magnitude
  std::int8_t level = 0;            ///< pyramid level on which it was found
  FeatureType type = FeatureType::kCorner;
};

struct FeatureDetectorOptions {
  int levels = 3;            ///< pyramid levels searched, from 0
  int fast_threshold = 20;   ///< first FAST threshold [grey levels]
  float fast_sigmas = 2.5f;  ///< lowest threshold tried where texture is weak, in sigmas of the level's grey noise
  int border_px = 8;         ///< no feature closer to the edge, counted on its own level
  /// Corners with a smaller Shi-Tomasi score are not taken, over the variance of the level's grey noise. At 1 two
  /// patches of 8 x 8 can be laid on each other to 0.25 px, and white noise alone has 3 corners where 160 are wanted,
  /// at 0.7 99.
  float min_score = 1.0f;
  /// What a score counts a level further up, where corners of different levels compete. With white noise alone 1 would
  /// be right; but a coarse patch covers more of the scene, which is less likely to be one plane.
  float level_weight = 0.5f;
  bool edgelets = true;  ///< fill up with edgelets where corners fail
};

/// Works in buffers allocated by the constructor for one picture size; detect() does not allocate. One thread at a
/// time.
class FeatureDetector {
 public:
  FeatureDetector(int width, int height, const FeatureDetectorOptions& options);

  /// Up to wanted well-spread features. The quadtree splits the picture until the wanted number of leaves holding a
  /// feature stands; of each leaf the best score is taken. `occupied` are level-0 pixels of features that exist
  /// already: a leaf holding one counts as served and gives no new feature. No feature lies in a masked pixel of its
  /// level. Writes to out (at least wanted long) and returns the number.
  int detect(const rt::PyramidView& pyramid, const rt::MaskPyramidView& mask, std::span<const Vec2f> occupied,
             int wanted, std::span<Feature> out);

  /// One sigma of the grey noise of the last picture, as detect() found it (grey_noise.h).
  float noise() const { return noise_; }

  ~FeatureDetector();
  FeatureDetector(const FeatureDetector&) = delete;
  FeatureDetector& operator=(const FeatureDetector&) = delete;

 private:
  struct Buffers;
  FeatureDetectorOptions options_;
  float noise_ = kLeastGreyNoise;
  Buffers* buffers_;
};

}  // namespace godwit::vo
