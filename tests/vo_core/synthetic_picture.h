// Pictures that the tests make up, with known content.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <random>
#include <vector>

#include "hal/rt/image.h"
#include "vo_core/image/pyramid.h"

namespace godwit::vo::test {

/// Where a row may begin in these bytes, of which the last rt::kRowAlignment are spare.
inline std::uint8_t* aligned(std::vector<std::uint8_t>* bytes) {
  void* at = bytes->data();
  std::size_t room = bytes->size();
  return static_cast<std::uint8_t*>(std::align(rt::kRowAlignment, room - rt::kRowAlignment, at, room));
}

/// A picture that owns its pixels.
class Picture {
 public:
  Picture(int width, int height, std::uint8_t grey)
      : width_(width), height_(height), pixels_(static_cast<std::size_t>(width * height + rt::kRowAlignment), grey) {}

  int width() const { return width_; }
  int height() const { return height_; }
  std::uint8_t& operator()(int x, int y) { return pixels_[static_cast<std::size_t>(y * width_ + x)]; }
  rt::ImageView view() const { return {pixels_.data(), width_, height_, width_}; }

  void fill_rectangle(int x0, int y0, int x1, int y1, std::uint8_t grey) {
    for (int y = std::max(0, y0); y < std::min(height_, y1); ++y) {
      for (int x = std::max(0, x0); x < std::min(width_, x1); ++x) (*this)(x, y) = grey;
    }
  }

  /// Gaussian sensor noise.
  void add_noise(double sigma, unsigned seed) {
    std::mt19937 random(seed);
    std::normal_distribution<double> noise(0.0, sigma);
    for (std::uint8_t& p : pixels_) p = static_cast<std::uint8_t>(std::clamp(std::lround(p + noise(random)), 0L, 255L));
  }

  /// 3x3 binomial blur, so that edges look as through a lens.
  void blur() {
    const std::vector<std::uint8_t> old = pixels_;
    for (int y = 1; y + 1 < height_; ++y) {
      for (int x = 1; x + 1 < width_; ++x) {
        int sum = 0;
        for (int dy = -1; dy <= 1; ++dy) {
          for (int dx = -1; dx <= 1; ++dx) {
            sum += (2 - std::abs(dx)) * (2 - std::abs(dy)) * old[static_cast<std::size_t>((y + dy) * width_ + x + dx)];
          }
        }
        (*this)(x, y) = static_cast<std::uint8_t>((sum + 8) / 16);
      }
    }
  }

 private:
  int width_, height_;
  std::vector<std::uint8_t> pixels_;
};

/// Random rectangles of random grey, blurred, with noise: corners everywhere.
inline Picture rectangles(int width, int height, int count, unsigned seed) {
  Picture picture(width, height, 128);
  std::mt19937 random(seed);
  for (int i = 0; i < count; ++i) {
    const int x = static_cast<int>(random() % static_cast<unsigned>(width)) - 20;
    const int y = static_cast<int>(random() % static_cast<unsigned>(height)) - 20;
    const int w = 6 + static_cast<int>(random() % 60), h = 6 + static_cast<int>(random() % 60);
    picture.fill_rectangle(x, y, x + w, y + h, static_cast<std::uint8_t>(random() % 256));
  }
  picture.blur();
  picture.add_noise(1.5, seed + 1);
  return picture;
}

/// A pyramid that owns its levels; the picture must outlive it.
class Pyramid {
 public:
  explicit Pyramid(const rt::ImageView& base, int levels = rt::kPyramidLevels)
      : bytes_(pyramid_bytes(base.width, base.height, levels) + rt::kRowAlignment) {
    std::uint8_t* storage = bytes_.data();
    while (reinterpret_cast<std::uintptr_t>(storage) % rt::kRowAlignment != 0) ++storage;
    view_ = build_pyramid(base, levels, storage, bytes_.size() - rt::kRowAlignment);
  }
  const rt::PyramidView& view() const { return view_; }

 private:
  std::vector<std::uint8_t> bytes_;
  rt::PyramidView view_;
};

/// A mask and its pyramid: a pixel of a level is masked if any pixel under it is.
class Mask {
 public:
  Mask(int width, int height, int levels = rt::kPyramidLevels) {
    for (int l = 0; l < levels; ++l) levels_.emplace_back(width >> l, height >> l, std::uint8_t{0});
  }
  void add_rectangle(int x0, int y0, int x1, int y1) {
    for (std::size_t l = 0; l < levels_.size(); ++l) {
      const int s = 1 << l;
      levels_[l].fill_rectangle(x0 / s, y0 / s, (x1 + s - 1) / s, (y1 + s - 1) / s, 255);
    }
  }
  rt::MaskPyramidView view() const {
    rt::MaskPyramidView v;
    v.levels = static_cast<int>(levels_.size());
    for (std::size_t l = 0; l < levels_.size(); ++l) v.level[l] = levels_[l].view();
    return v;
  }
  double share() const {
    const rt::ImageView v = levels_[0].view();
    int set = 0;
    for (int y = 0; y < v.height; ++y) {
      for (int x = 0; x < v.width; ++x) set += v.at(x, y) != 0;
    }
    return static_cast<double>(set) / (v.width * v.height);
  }

 private:
  std::vector<Picture> levels_;
};

}  // namespace godwit::vo::test
