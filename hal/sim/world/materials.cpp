// The procedural materials: walls with windows, roofs, leaves, cars, clothes, posters.
#include <algorithm>
#include <array>
#include <cmath>

#include "hal/sim/world/texture.h"

namespace godwit::sim {
namespace {

Canvas detail(std::uint64_t seed) {
  Canvas c(1024);
  c.fill(128, 128);
  c.noise(std::array{32, 16, 8}, 0.20, mix(seed, 1), false);
  c.noise(std::array{4, 2}, 0.24, mix(seed, 1), false);
  Rng rng(seed, 2);
  for (int i = 0; i < 5000; ++i) {  // pebbles, blades, stains
    c.disc(rng.uniform(0, 1024), rng.uniform(0, 1024), rng.uniform(0.8, 3.5), rng.chance(0.5) ? 70 : 190, 128);
  }
  return c;
}

/// 16 m x 16 m of wall: five storeys of windows; `style` picks brick, plaster, panels or weatherboard.
Canvas facade(std::uint64_t seed, int style, bool night) {
  Canvas c(512);
  Rng rng(seed, static_cast<std::uint64_t>(10 + style));
  const double base[] = {120, 190, 150, 215}, wall = base[style];
  c.fill(wall, style == 0 ? 90 : 50);
  if (style == 0) {  // brick courses
    for (int y = 0; y < 512; y += 4) {
      c.box(0, y, 512, y + 0.7, 170, 60);
      for (int x = (y / 4 % 2) * 4; x < 512; x += 8) c.box(x, y, x + 0.7, y + 4, 165, 60);
    }
  } else if (style == 2) {
    for (int x = 0; x < 512; x += 64) c.box(x, 0, x + 2, 512, 90, 40);
  } else if (style == 3) {
    for (int y = 0; y < 512; y += 8) c.box(0, y, 512, y + 1.5, 160, 40);
  }
  c.noise(std::array{128}, 0.15, mix(seed, 3), false);
  c.noise(std::array{16}, 0.10, mix(seed, 4), false);
  c.noise(std::array{2}, 0.10, mix(seed, 5), false);
  for (int floor = 0; floor < 5; ++floor) {  // v runs down from the top of the wall's picture
    const double y = floor * 102.4 + 24;
    if (style != 3) c.box(0, floor * 102.4, 512, floor * 102.4 + 4, wall * 0.7, 40);
    for (int k = 0; k < 5; ++k) {
      const double x = k * 102.4 + rng.uniform(20, 34), w = rng.uniform(30, 48), h = rng.uniform(40, 56);
      c.box(x - 4, y - 4, x + w + 4, y + h + 5, style == 3 ? 110 : 235, 20);
      const bool lit = night && rng.chance(0.4);
      const double pane = lit ? 250 : (night ? 20 : rng.uniform(25, 80));
      c.box(x, y, x + w, y + h, pane, 12);
      if (!lit) c.box(x + 2, y + 2, x + w * 0.4, y + h * rng.uniform(0.2, 0.5), pane + rng.uniform(10, 50), 12);
      c.box(x + w / 2 - 1, y, x + w / 2 + 1, y + h, 215, 10);
      c.box(x, y + h * 0.4 - 1, x + w, y + h * 0.4 + 1, 215, 10);
      c.box(x - 6, y + h + 4, x + w + 6, y + h + 8, 225, 20);
      if (rng.chance(0.3)) c.box(x - 14, y - 2, x - 5, y + h + 2, 70, 30);  // shutters
      if (rng.chance(0.3)) c.box(x + w + 5, y - 2, x + w + 14, y + h + 2, 70, 30);
    }
  }
  return c;
}

Canvas roof(std::uint64_t seed, int style) {
  Canvas c(256);
  Rng rng(seed, static_cast<std::uint64_t>(20 + style));
  c.fill(style == 0 ? 105 : 75, 90);
  for (int row = 0; row < 256; row += 10) {
    c.box(0, row, 256, row + 2.2, 45, 60);
    for (int x = 0; x < 256; x += 8) {
      const double b = (style == 0 ? 115 : 80) + rng.uniform(-28, 28);
      c.box(x + 0.6, row + 2.2, x + 7.4, row + 9.6, b, 80);
    }
  }
  c.noise(std::array{64}, 0.2, mix(seed, 6), false);
  c.noise(std::array{4}, 0.15, mix(seed, 7), false);
  return c;
}

Canvas foliage(std::uint64_t seed, int style) {
  Canvas c(256);
  Rng rng(seed, static_cast<std::uint64_t>(30 + style));
  c.fill(style == 0 ? 52 : 68, 128);
  for (int i = 0; i < 5200; ++i) {  // leaves, later ones in front and brighter
    const double x = rng.uniform(0, 256), y = rng.uniform(0, 256), a = rng.uniform(0, 3.14159);
    const double b = 20 + 125.0 * i / 5200.0 * rng.uniform(0.5, 1.2);
    c.rect(x, y, std::cos(a), std::sin(a), rng.uniform(2, 5), rng.uniform(1, 2.2), b, 100);
  }
  c.noise(std::array{32}, 0.35, mix(seed, 8), false);
  return c;
}

Canvas plain(std::uint64_t seed, double brightness, double grain, double noise) {
  Canvas c(256);
  c.fill(brightness, grain);
  c.noise(std::array{64, 16, 4, 2}, noise, seed, false);
  return c;
}

Canvas bark(std::uint64_t seed) {
  Canvas c(128);
  Rng rng(seed, 40);
  c.fill(80, 80);
  for (int i = 0; i < 200; ++i) {
    const double x = rng.uniform(0, 128), y = rng.uniform(0, 128);
    c.box(x, y, x + rng.uniform(1, 4), y + rng.uniform(8, 30), rng.uniform(35, 120), 60);
  }
  return c;
}

/// Stretched over a car's side; the top row of the picture is the car's top.
Canvas car_side() {
  Canvas c(256);
  c.fill(200, 8);
  c.box(0, 120, 256, 126, 150, 8);  // moulding
  c.box(0, 215, 256, 256, 60, 20);  // sill
  c.box(84, 20, 86, 200, 110, 8);   // door gaps
  c.box(150, 20, 152, 200, 110, 8);
  for (const double x : {52.0, 202.0}) {  // wheels
    c.disc(x, 205, 38, 40, 20);
    c.disc(x, 208, 33, 18, 20);
    c.disc(x, 208, 16, 170, 20);
    c.disc(x, 208, 5, 60, 20);
  }
  c.box(0, 70, 14, 100, 250, 4);
  c.box(244, 60, 256, 95, 90, 4);
  c.box(100, 100, 116, 106, 90, 4);
  c.box(166, 100, 182, 106, 90, 4);
  return c;
}

Canvas car_top() {
  Canvas c(256);
  c.fill(205, 8);
  c.box(0, 0, 256, 8, 150, 8);
  c.box(0, 248, 256, 256, 150, 8);
  c.box(70, 20, 73, 236, 120, 8);
  c.box(20, 60, 60, 62, 140, 8);
  c.box(20, 194, 60, 196, 140, 8);
  return c;
}

Canvas car_end() {
  Canvas c(256);
  c.fill(190, 8);
  c.box(10, 70, 60, 110, 245, 4);
  c.box(196, 70, 246, 110, 245, 4);
  c.box(75, 80, 181, 120, 40, 10);
  c.box(90, 150, 166, 180, 230, 4);
  c.box(0, 200, 256, 256, 50, 20);
  return c;
}

Canvas glass() {
  Canvas c(256);
  c.fill(38, 6);
  c.rect(90, 128, 0.6, 0.8, 200, 14, 80, 6);
  c.rect(150, 128, 0.6, 0.8, 200, 5, 70, 6);
  c.box(0, 0, 256, 10, 150, 6);
  c.box(0, 244, 256, 256, 150, 6);
  c.box(122, 0, 134, 256, 150, 6);
  return c;
}

Canvas truck_side(std::uint64_t seed, int style) {
  Canvas c(512);
  Rng rng(seed, static_cast<std::uint64_t>(50 + style));
  c.fill(style == 0 ? 205 : 110, 20);
  for (int x = 0; x < 512; x += 12) c.box(x, 0, x + 3, 430, style == 0 ? 175 : 80, 20);
  for (int i = 0; i < 9; ++i) {  // lettering
    const double x = 60 + i * 44, w = 30;
    c.box(x, 120, x + 8, 230, style == 0 ? 40 : 230, 8);
    if (rng.chance(0.6)) c.box(x, 120, x + w, 135, style == 0 ? 40 : 230, 8);
    if (rng.chance(0.6)) c.box(x, 168, x + w, 182, style == 0 ? 40 : 230, 8);
    if (rng.chance(0.6)) c.box(x, 215, x + w, 230, style == 0 ? 40 : 230, 8);
    if (rng.chance(0.5)) c.box(x + w - 8, 120, x + w, 230, style == 0 ? 40 : 230, 8);
  }
  c.box(0, 420, 512, 440, 60, 20);
  c.box(0, 440, 512, 512, 30, 20);
  for (const double x : {60.0, 150.0, 380.0, 450.0}) {
    c.disc(x, 470, 38, 14, 20);
    c.disc(x, 470, 18, 130, 20);
  }
  return c;
}

Canvas cloth(std::uint64_t seed, int style) {
  Canvas c(128);
  Rng rng(seed, static_cast<std::uint64_t>(60 + style));
  c.fill(style == 0 ? 60 : (style == 1 ? 190 : 120), 30);
  if (style == 1) {
    for (int y = 0; y < 128; y += 16) c.box(0, y, 128, y + 7, 60, 20);
  } else if (style == 2) {
    for (int y = 0; y < 128; y += 20) c.box(0, y, 128, y + 6, 200, 20);
    for (int x = 0; x < 128; x += 20) c.box(x, 0, x + 6, 128, 40, 20);
  } else {
    c.box(40, 20, 90, 60, 210, 20);
  }
  for (int i = 0; i < 8; ++i) {
    const double x = rng.uniform(0, 128);
    c.box(x, 0, x + 3, 128, rng.uniform(30, 90), 20);
  }
  c.noise(std::array{8}, 0.2, mix(seed, 61), false);
  return c;
}

Canvas cloud(std::uint64_t seed) {
  Canvas c(256);
  c.fill(190, 0);
  for (const int cell : {64, 32, 16, 8, 4}) c.noise(std::array{cell}, 0.024 * std::sqrt(cell), mix(seed, 70), false);
  return c;
}

/// A picture on a wall: strong corners at many scales.
Canvas poster(std::uint64_t seed, int style) {
  Canvas c(256);
  Rng rng(seed, static_cast<std::uint64_t>(80 + style));
  c.fill(rng.uniform(150, 240), 10);
  for (int i = 0; i < 26; ++i) {
    const double x = rng.uniform(10, 230), y = rng.uniform(10, 230), b = rng.uniform(15, 245);
    if (rng.chance(0.4)) {
      c.disc(x, y, rng.uniform(4, 36), b, 10);
    } else {
      c.box(x, y, x + rng.uniform(6, 80), y + rng.uniform(4, 50), b, 10);
    }
  }
  for (int line = 0; line < 12; ++line) {  // text
    for (double x = 24; x < 220;) {
      const double w = rng.uniform(4, 16);
      c.box(x, 150 + line * 7, x + w, 153 + line * 7, 30, 4);
      x += w + 4;
    }
  }
  for (const double e : {0.0, 250.0}) {
    c.box(e, 0, e + 6, 256, 25, 4);
    c.box(0, e, 256, e + 6, 25, 4);
  }
  return c;
}

Canvas door() {
  Canvas c(256);
  c.fill(120, 40);
  c.box(0, 0, 16, 256, 200, 20);
  c.box(240, 0, 256, 256, 200, 20);
  c.box(0, 0, 256, 8, 200, 20);
  c.box(50, 30, 206, 110, 85, 40);
  c.box(50, 140, 206, 240, 85, 40);
  c.box(90, 40, 166, 90, 225, 10);
  c.disc(222, 135, 7, 235, 10);
  return c;
}

Canvas tiles(std::uint64_t seed) {
  Canvas c(256);
  Rng rng(seed, 90);
  c.fill(120, 40);
  for (int y = 0; y < 256; y += 32) {
    for (int x = 0; x < 256; x += 32) c.box(x + 1, y + 1, x + 31, y + 31, 165 + rng.uniform(-28, 28), 50);
  }
  c.noise(std::array{4}, 0.08, mix(seed, 91), false);
  return c;
}

}  // namespace

std::vector<Texture> make_materials(std::uint64_t seed, const Canvas& ground, bool night) {
  std::vector<Texture> out;
  out.reserve(kTextureCount);
  out.emplace_back(detail(seed));
  out.emplace_back(ground);
  for (int i = 0; i < 4; ++i) out.emplace_back(facade(seed, i, night));
  for (int i = 0; i < 2; ++i) out.emplace_back(roof(seed, i));
  for (int i = 0; i < 2; ++i) out.emplace_back(foliage(seed, i));
  out.emplace_back(bark(seed));
  out.emplace_back(plain(mix(seed, 41), 165, 70, 0.07));
  out.emplace_back(plain(mix(seed, 43), 165, 24, 0.035));
  out.emplace_back(car_side());
  out.emplace_back(car_top());
  out.emplace_back(car_end());
  out.emplace_back(glass());
  for (int i = 0; i < 2; ++i) out.emplace_back(truck_side(seed, i));
  for (int i = 0; i < 3; ++i) out.emplace_back(cloth(seed, i));
  out.emplace_back(plain(mix(seed, 42), 165, 10, 0.05));
  out.emplace_back(cloud(seed));
  for (int i = 0; i < 4; ++i) out.emplace_back(poster(seed, i));
  out.emplace_back(door());
  out.emplace_back(tiles(seed));
  return out;
}

}  // namespace godwit::sim
