// The kinds of world: what stands and moves where in each.
#include <algorithm>
#include <cmath>
#include <numbers>

#include "hal/sim/world/layout.h"

// Counters in metres: what a seed lays out hangs on these very sums.
// NOLINTBEGIN(clang-analyzer-security.FloatLoopCounter)
namespace godwit::sim {
void Layout::residential() {
  constexpr int kStreets = 8, kAvenues = 4;
  constexpr double kStreetM = kWorldM / kStreets, kAvenueM = kWorldM / kAvenues, kHalf = 3.6;
  ground_.fill(96, 128);
  for (int i = 0; i < 260; ++i) {  // uneven lawn
    spot(rng_.uniform(0, kWorldM), rng_.uniform(0, kWorldM), rng_.uniform(1, 6), rng_.uniform(80, 118), 128);
  }
  const auto free_of_avenue = [&](double x, double margin) {
    return std::abs(x - kAvenueM * std::round(x / kAvenueM)) > kHalf + 2 + margin;
  };
  for (int k = 0; k < kStreets; ++k) {
    const double y = k * kStreetM;
    for (const double side : {-1.0, 1.0}) {
      for (double x = 8.5; x < kWorldM; x += 17.07) {
        if (!free_of_avenue(x, 6)) continue;
        const double hx = x + rng_.uniform(-1, 1), hy = y + side * (12.5 + rng_.uniform(-0.8, 1.2));
        // Garden: path to the door, drive, beds, terrace, fence.
        paint(hx - 2, y + side * 7.5, 0, 1, 2.6, 0.5, 160, 60);
        paint(hx + 6.4, y + side * 9.5, 0, 1, 4.2, 1.4, rng_.uniform(110, 170), 60);
        for (int b = 0; b < 5; ++b) {
          spot(hx + rng_.uniform(-7, 5), y + side * rng_.uniform(6.5, 24), rng_.uniform(0.3, 1.2),
               rng_.uniform(30, 190), 128);
        }
        paint(hx, y + side * 19, 1, 0, rng_.uniform(1.5, 4), rng_.uniform(1, 2), rng_.uniform(120, 185), 60);
        if (rng_.chance(0.3)) {  // a pool
          paint(hx + 3, y + side * 22, 1, 0, 2.6, 1.4, 215, 30);
          paint(hx + 3, y + side * 22, 1, 0, 2.3, 1.1, 120, 10);
        }
        house(hx, hy, rng_.chance(0.7));
        if (rng_.chance(0.7)) hedge(x - 8.4, y + side * 15, false, 8.5);
        if (rng_.chance(0.5)) hedge(x, y + side * 25.2, true, 7.5);
        if (rng_.chance(0.6 * world_.plan_.trees))
          tree(hx + rng_.uniform(-7, 7), y + side * rng_.uniform(20, 23.5), rng_.uniform(1.6, 2.8));
        if (rng_.chance(0.5 * world_.plan_.trees))
          tree(hx + rng_.uniform(-6, 3), y + side * 7.4, rng_.uniform(1.2, 2.0));
        for (int b = 0; b < 2; ++b)
          bush(hx + rng_.uniform(-7, 4), y + side * rng_.uniform(6.5, 7.5), rng_.uniform(0.4, 0.9));
        if (rng_.chance(0.4)) crate(hx - 5, y + side * 22, rng_.uniform(0, 0.3), 1.2, 1.6, 2.1, kTexDoor, 0.8);
        if (rng_.chance(0.5)) car(hx + 6.4, y + side * 9.8, side * std::numbers::pi / 2, 0, true);
      }
    }
  }
  for (int k = 0; k < kStreets; ++k) road_x(k * kStreetM, kHalf, 2);
  for (int k = 0; k < kAvenues; ++k) road_y(k * kAvenueM, kHalf);
  for (int k = 0; k < kStreets; ++k) {
    for (int a = 0; a < kAvenues; ++a) {  // crossings, bare of lane marks, with zebras
      const double x = a * kAvenueM, y = k * kStreetM;
      paint(x, y, 1, 0, kHalf, kHalf, 80, 62);
      for (double s = -3; s <= 3.1; s += 1.0) {
        paint(x - 5.6, y + s, 1, 0, 1.3, 0.25, 228, 30);
        paint(x + 5.6, y + s, 1, 0, 1.3, 0.25, 228, 30);
        paint(x + s, y - 5.6, 0, 1, 1.3, 0.25, 228, 30);
        paint(x + s, y + 5.6, 0, 1, 1.3, 0.25, 228, 30);
      }
    }
    const double y = k * kStreetM;
    for (double x = 20; x < kWorldM; x += 34.13) {
      if (!free_of_avenue(x, 0)) continue;
      lamp(x, y + 4.4);
      lamp(x + 17, y - 4.4);
    }
    for (double x = 12; x < kWorldM; x += 6.2) {
      if (rng_.chance(0.22) && free_of_avenue(x, 8))
        car(x, y + (rng_.chance(0.5) ? 2.7 : -2.7), rng_.chance(0.5) ? 0 : std::numbers::pi, 0, true);
    }
  }
  // Traffic keeps right, one speed a lane, so that nobody drives through another; people walk on the pavements.
  const auto lane_speed = [&](int road, bool forth) {
    return Rng(world_.seed_, static_cast<std::uint64_t>(2 * road) + (forth ? 1u : 0u)).uniform(4, 9);
  };
  for (int i = 0; i < world_.plan_.cars; ++i) {
    const double at = 8.0 * rng_.below(static_cast<int>(kWorldM / 8));
    const bool forth = rng_.chance(0.5);
    // Two in five drive near the streets that the flights use.
    const int street = rng_.chance(0.4) ? 2 : rng_.below(kStreets);
    if (rng_.chance(0.75)) {
      car(at, street * kStreetM + (forth ? -1.3 : 1.3), forth ? 0 : std::numbers::pi, lane_speed(street, forth), false);
    } else {
      const int avenue = rng_.chance(0.5) ? 2 : rng_.below(kAvenues);
      car(avenue * kAvenueM + (forth ? 1.5 : -1.5), at, forth ? std::numbers::pi / 2 : -std::numbers::pi / 2,
          lane_speed(kStreets + avenue, forth), false);
    }
  }
  for (int i = 0; i < world_.plan_.people; ++i) {
    const double side = rng_.chance(0.5) ? 4.7 : -4.7, at = rng_.uniform(0, kWorldM);
    const double heading = rng_.chance(0.5) ? 0 : std::numbers::pi;
    const int street = rng_.chance(0.4) ? 2 : rng_.below(kStreets);
    walker(at, street * kStreetM + side + rng_.uniform(-0.6, 0.6), heading, rng_.uniform(0.9, 1.7));
  }
}

void Layout::fields(bool snow) {
  ground_.fill(snow ? 205 : 105, snow ? 22 : 120);
  const double base[] = {70, 95, 125, 150, 110, 84};
  const int nx = 8, ny = 10;
  const double wx = kWorldM / nx, wy = kWorldM / ny;
  for (int j = 0; j < ny; ++j) {
    for (int i = 0; i < nx; ++i) {
      const double x = (i + 0.5) * wx, y = (j + 0.5) * wy;
      const double b = snow ? rng_.uniform(186, 212) : base[rng_.below(6)] + rng_.uniform(-10, 10);
      paint(x, y, 1, 0, wx / 2, wy / 2, b, snow ? rng_.uniform(14, 30) : rng_.uniform(70, 128));
      if (snow) continue;
      const double spacing = rng_.uniform(0.7, 2.2);
      const bool along = rng_.chance(0.5);
      if (rng_.chance(0.7)) {  // crop rows
        const double row = b + rng_.uniform(15, 40) * (rng_.chance(0.5) ? 1 : -1);
        for (double s = -(along ? wy : wx) / 2 + 1; s < (along ? wy : wx) / 2 - 1; s += spacing) {
          paint(along ? x : x + s, along ? y + s : y, along ? 1 : 0, along ? 0 : 1, (along ? wx : wy) / 2 - 1,
                spacing * 0.28, row, 128);
        }
      }
      for (double s = -18; s < 19; s += 12) {  // tractor's tracks
        for (const double t : {-0.9, 0.9}) {
          paint(along ? x : x + s + t, along ? y + s + t : y, along ? 1 : 0, along ? 0 : 1, (along ? wx : wy) / 2 - 0.5,
                0.22, b * 0.62, 110);
        }
      }
      for (int k = rng_.below(14); k > 0; --k) {
        spot(x + rng_.uniform(-0.5, 0.5) * wx, y + rng_.uniform(-0.5, 0.5) * wy, rng_.uniform(0.4, 4),
             b + rng_.uniform(-35, 35), 128);
      }
      if (rng_.chance(0.35)) {  // bales
        for (int k = 0; k < 9; ++k) {
          crate(x + rng_.uniform(-0.45, 0.45) * wx, y + rng_.uniform(-0.45, 0.45) * wy,
                rng_.uniform(0, std::numbers::pi), 0.75, 0.6, 1.3, kTexConcrete, 0.9);
        }
      }
    }
  }
  for (int i = 0; i <= nx; i += 2) {  // farm tracks with a grass strip
    const double x = i * wx;
    paint(x, kWorldM / 2, 0, 1, kWorldM / 2, 1.9, snow ? 178 : 165, snow ? 30 : 110);
    if (!snow) paint(x, kWorldM / 2, 0, 1, kWorldM / 2, 0.4, 100, 128);
  }
  if (!snow) road_x(0, 3.2, 2);
  const double trees = world_.plan_.trees;
  for (int j = 0; j < ny; ++j) {
    const double y = j * wy;
    if (snow || !rng_.chance(0.5)) continue;
    for (double x = 3; x < kWorldM; x += rng_.uniform(4, 14) / std::max(0.2, trees)) {
      if (rng_.chance(0.5))
        tree(x, y + rng_.uniform(-1, 1), rng_.uniform(1.2, 3));
      else
        bush(x, y + rng_.uniform(-1, 1), rng_.uniform(0.6, 1.6));
    }
  }
  if (snow) {
    // Little to hold on to: a fence here and there, dry stalks, a few spoors.
    for (int i = 0; i < static_cast<int>(260 * trees); ++i)
      bush(rng_.uniform(0, kWorldM), rng_.uniform(0, kWorldM), rng_.uniform(0.2, 0.6));
    for (int i = 0; i < 60; ++i) {
      const double x = rng_.uniform(0, kWorldM), y = rng_.uniform(0, kWorldM),
                   a = rng_.uniform(0, 2 * std::numbers::pi);
      for (int k = 0; k < 90; ++k) {
        const double side = k % 2 == 0 ? 0.15 : -0.15, bend = a + 0.4 * std::sin(k * 0.07);
        spot(x + 0.45 * k * std::cos(bend) - side * std::sin(bend),
             y + 0.45 * k * std::sin(bend) + side * std::cos(bend), 0.15, 150, 20);
      }
    }
    for (int i = 0; i < 1500; ++i) {  // drifts: the wind's long soft ridges
      const double a = 0.5 + rng_.uniform(-0.25, 0.25);
      paint(rng_.uniform(0, kWorldM), rng_.uniform(0, kWorldM), std::cos(a), std::sin(a), rng_.uniform(0.6, 5),
            rng_.uniform(0.05, 0.2), rng_.chance(0.5) ? 222 : 182, 22);
    }
    for (int i = 0; i < 5; ++i) {
      const double y = rng_.uniform(0, kWorldM);
      for (double x = 0; x < kWorldM; x += 6.4) crate(x, y, 0, 0.06, 0.06, 1.1, kTexConcrete, 0.4);
    }
  } else {
    for (int i = 0; i < 10; ++i) house(rng_.uniform(0, kWorldM), rng_.uniform(0, kWorldM), rng_.chance(0.5));
    for (int i = 0; i < world_.plan_.people; ++i)
      walker(rng_.uniform(0, kWorldM), rng_.uniform(0, kWorldM), rng_.uniform(0, 2 * std::numbers::pi),
             rng_.uniform(0.8, 1.5));
    for (int i = 0; i < world_.plan_.cars; ++i) {
      const bool forth = rng_.chance(0.5);
      car(rng_.uniform(0, kWorldM), forth ? -1.4 : 1.4, forth ? 0 : std::numbers::pi, rng_.uniform(8, 16), false);
    }
  }
}

void Layout::plaza() {
  const double c = kWorldM / 2;
  ground_.fill(150, 60);
  for (double x = 0; x < kWorldM; x += 1.6) {
    for (double y = 0; y < kWorldM; y += 1.6) {
      if (std::abs(x - c) < 70 && std::abs(y - c) < 70)
        paint(x + 0.8, y + 0.8, 1, 0, 0.77, 0.77, 140 + rng_.uniform(-30, 30), 60);
    }
  }
  for (double r = 6; r < 40; r += 8) {  // rings of dark stone
    for (double a = 0; a < 2 * std::numbers::pi; a += 0.35 / r)
      spot(c + r * std::cos(a), c + r * std::sin(a), 0.22, 70, 60);
  }
  wear(c - 40, c - 40, c + 40, c + 40, 160);
  for (int k = 0; k < 24; ++k) {  // houses around, trees and benches inside
    const double a = 2 * std::numbers::pi * k / 24, r = 62 + rng_.uniform(-2, 6);
    block(c + r * std::cos(a), c + r * std::sin(a), rng_.uniform(6, 8), rng_.uniform(6, 8), rng_.uniform(9, 18),
          rng_.below(4));
    if (k % 2 == 0) tree(c + 36 * std::cos(a + 0.1), c + 36 * std::sin(a + 0.1), rng_.uniform(1.6, 2.4));
    crate(c + 27 * std::cos(a), c + 27 * std::sin(a), a, 0.3, 1.0, 0.45, kTexConcrete, 0.6);
    if (k % 3 == 1) lamp(c + 20 * std::cos(a), c + 18 * std::sin(a));
  }
  for (int k = 0; k < 8; ++k) {
    const double a = 2 * std::numbers::pi * k / 8 + 0.3;
    crate(c + 16 * std::cos(a), c + 16 * std::sin(a), a, 1.2, 1.6, 2.4, kTexPoster0 + k % 4, 1);
  }
  object([&](Mesh* m) {  // fountain
    const double z = world_.terrain_.height(c + 6, c + 3);
    m->prism(Vec3(c + 6, c + 3, z - 0.2), 12, 3, 3, 0.8, kConcrete, {kTexGlass, 64, 1.6, 0, 0, false});
    m->prism(Vec3(c + 6, c + 3, z + 0.6), 8, 0.6, 0.3, 2.2, kConcrete, kConcrete);
  });
  for (int i = 0; i < world_.plan_.people; ++i) {
    const double r = 15 * std::sqrt(rng_.uniform()), a = rng_.uniform(0, 2 * std::numbers::pi);
    wanderer(c + r * std::cos(a), c + r * std::sin(a), rng_.uniform(2, 6));
  }
  for (int i = 0; i < world_.plan_.cars; ++i)
    car(c + rng_.uniform(-20, 20), c + rng_.uniform(-20, 20), rng_.uniform(0, 2 * std::numbers::pi), 0, true);
}

void Layout::highway() {
  const double y = kWorldM / 2, half = 11.4;
  ground_.fill(100, 128);
  for (int i = 0; i < 900; ++i)
    spot(rng_.uniform(0, kWorldM), rng_.uniform(0, kWorldM), rng_.uniform(0.4, 5), rng_.uniform(60, 150), 128);
  road_x(y, half, 6);
  paint(y, y, 1, 0, y, 0.8, 165, 50);
  paint(y, y + half - 0.4, 1, 0, y, 0.1, 228, 30);
  paint(y, y - half + 0.4, 1, 0, y, 0.1, 228, 30);
  for (double x = 0; x < kWorldM; x += 12.8) crate(x + 6.4, y, 0, 6.3, 0.2, 0.9, kTexConcrete, 1);
  road_x(y + 40, 3.5, 2);
  for (double x = 5; x < kWorldM; x += rng_.uniform(5, 11)) {
    tree(x, y + half + 6 + rng_.uniform(-1, 2), rng_.uniform(1.2, 2.2));
    bush(x + 3, y - half - 5 + rng_.uniform(-2, 2), rng_.uniform(0.5, 1.4));
    if (rng_.chance(0.35)) tree(x, y - half - 9 - rng_.uniform(0, 20), rng_.uniform(1.4, 2.6));
    if (rng_.chance(0.25)) house(x, y + half + 18 + rng_.uniform(0, 3), rng_.chance(0.5));
    if (rng_.chance(0.25)) house(x, y - half - 22 - rng_.uniform(0, 3), rng_.chance(0.5));
  }
  for (double x = 10; x < kWorldM; x += 25.6) {
    lamp(x, y + half + 2.6);
    lamp(x, y - half - 2.6);
  }
  // A column of trucks in each of the two right-hand lanes, cars in the others.
  for (const double lane : {-9.5, -5.7}) {
    const double speed = lane < -7 ? 6.0 : 7.5;
    for (double x = 0; x < kWorldM - 16; x += rng_.uniform(14.5, 19)) truck(x, y + lane, 0, speed);
  }
  for (int i = 0; i < world_.plan_.cars; ++i) {
    const double lanes[] = {-1.9, 1.9, 5.7, 9.5}, lane = lanes[i % 4];
    car(kWorldM * (i + rng_.uniform(0, 0.5)) / std::max(1, world_.plan_.cars), y + lane,
        lane < 0 ? 0 : std::numbers::pi, lane < 0 ? 9.0 : 8.0, false);
  }
  for (int i = 0; i < world_.plan_.people; ++i)
    walker(rng_.uniform(0, kWorldM), y - half - 1.2, rng_.chance(0.5) ? 0 : std::numbers::pi, rng_.uniform(1, 1.7));
}

void Layout::airfield() {
  const double c = kWorldM / 2;
  ground_.fill(104, 128);
  for (int i = 0; i < 700; ++i)
    spot(rng_.uniform(0, kWorldM), rng_.uniform(0, kWorldM), rng_.uniform(0.5, 6), rng_.uniform(82, 124), 128);
  paint(c, c + 30, 1, 0, 190, 9, 84, 60);  // runway
  wear(c - 150, c + 23, c + 150, c + 37, 160);
  for (double x = c - 160; x < c + 160; x += 15) paint(x, c + 30, 1, 0, 4, 0.25, 230, 30);
  paint(c - 10, c + 5, 1, 0, 30, 14, 125, 60);  // apron
  for (double x = c - 40; x <= c + 20; x += 5) paint(x, c + 5, 0, 1, 14, 0.06, 70, 60);
  for (double y = c - 9; y <= c + 19; y += 5) paint(c - 10, y, 1, 0, 30, 0.06, 70, 60);
  wear(c - 38, c - 8, c + 18, c + 18, 120);
  // Pad: ring and H.
  spot(c, c, 3.4, 235, 30);
  spot(c, c, 3.0, 70, 60);
  paint(c - 0.9, c, 0, 1, 1.5, 0.22, 235, 30);
  paint(c + 0.9, c, 0, 1, 1.5, 0.22, 235, 30);
  paint(c, c, 1, 0, 0.9, 0.22, 235, 30);
  for (double a = 0; a < 2 * std::numbers::pi; a += std::numbers::pi / 4)
    spot(c + 2.6 * std::cos(a), c + 2.6 * std::sin(a), 0.12, 200, 30);
  block(c - 25, c - 22, 9, 6, 7, 2);
  block(c + 5, c - 24, 8, 6, 8, 0);
  block(c + 30, c - 20, 6, 8, 5, 3);
  for (int i = 0; i < 26; ++i) {
    crate(c + rng_.uniform(-38, 30), c + (rng_.chance(0.5) ? rng_.uniform(-13, -9) : rng_.uniform(14, 18)),
          rng_.uniform(0, std::numbers::pi), rng_.uniform(0.4, 1.3), rng_.uniform(0.4, 1.0), rng_.uniform(0.5, 1.8),
          rng_.chance(0.5) ? kTexDoor : kTexConcrete, rng_.uniform(0.5, 1.1));
  }
  for (int i = 0; i < static_cast<int>(90 * world_.plan_.trees); ++i) {
    const double x = rng_.uniform(0, kWorldM), y = rng_.uniform(0, kWorldM);
    if (std::abs(y - c) > 45 || std::abs(x - c) > 170) tree(x, y, rng_.uniform(1.4, 3));
  }
  for (double a = 0; a < 2 * std::numbers::pi; a += 0.7)
    bush(c + 48 * std::cos(a), c - 5 + 20 * std::sin(a), rng_.uniform(0.4, 1));
  lamp(c - 12, c - 12);
  lamp(c + 14, c - 12);
  for (int i = 0; i < world_.plan_.cars; ++i) {
    if (i % 2 == 0)
      car(c + rng_.uniform(-36, 16), c + rng_.uniform(9, 16), rng_.uniform(0, 2 * std::numbers::pi), 0, true);
    else
      car(rng_.uniform(0, kWorldM), c + 21.5 + 0.0, 0, rng_.uniform(5, 9), false);
  }
  for (int i = 0; i < world_.plan_.people; ++i)
    wanderer(c + rng_.uniform(-30, 15), c + rng_.uniform(8, 15), rng_.uniform(1, 4));
}

void Layout::corridor() {
  // An L of 60 m and 40 m: floor, walls with doors and posters, ceiling with lamps. Flown inside.
  ground_.fill(140, 50);
  constexpr double x0 = 100, x1 = 160, y0 = 100, y1 = 140, kHalf = 1.6, kHigh = 3.0;
  for (double x = x0 - 4; x < x1 + 4; x += 0.6) {
    for (double y = y0 - 4; y < y1 + 4; y += 0.6) {
      if (y > y0 + 4 && x < x1 - 4) continue;
      paint(x + 0.3, y + 0.3, 1, 0, 0.28, 0.28, 128 + rng_.uniform(-34, 34), 60);
    }
  }
  wear(x0, y0 - kHalf, x1, y0 + kHalf, 90);
  wear(x1 - kHalf, y0, x1 + kHalf, y1, 60);
  const Cover wall{kTexPlaster, kConcreteTexelsPerM, 1.05, 0, 0, false};
  const auto hang = [&](Mesh* m, const Vec3& a, const Vec3& along, const Vec3& inside, double length) {
    // A run of wall from a, seen from inside left to right, in pieces with something on each.
    const Vec3 up(0, 0, kHigh);
    Cover cover = wall;
    for (double s = 0; s < length - 0.01; s += 2.0) {
      const Vec3 l = a + s * along, r = a + std::min(length, s + 2.0) * along;
      cover.u0 = s * kConcreteTexelsPerM;
      cover.albedo = rng_.uniform(0.9, 1.1);
      m->quad(l + up, r + up, r, l, cover);
      const double what = rng_.uniform();
      const Vec3 out = 0.02 * inside;
      // The last piece may be too short for a door, which would then hang in the air behind the wall's end.
      const bool whole = s + 2.0 <= length + 0.01;
      if (what < 0.3) {
        const double w = 0.45, x = 1.0;
        const Cover door{kTexDoor, 0, rng_.uniform(0.6, 1.2), 0, 0, false};
        if (whole)
          m->quad(l + (x - w) * along + Vec3(0, 0, 2.1) + out, l + (x + w) * along + Vec3(0, 0, 2.1) + out,
                  l + (x + w) * along + out, l + (x - w) * along + out, door);
      } else if (what < 0.75) {
        const double w = rng_.uniform(0.3, 0.7), h = rng_.uniform(0.3, 0.6), x = rng_.uniform(0.7, 1.3),
                     z = rng_.uniform(1.2, 1.8);
        const Cover poster{kTexPoster0 + rng_.below(4), 0, rng_.uniform(0.8, 1.1), 0, 0, false};
        if (whole)
          m->quad(l + (x - w) * along + Vec3(0, 0, z + h) + out, l + (x + w) * along + Vec3(0, 0, z + h) + out,
                  l + (x + w) * along + Vec3(0, 0, z - h) + out, l + (x - w) * along + Vec3(0, 0, z - h) + out, poster);
      }
      m->quad(l + Vec3(0, 0, 0.12) + out, r + Vec3(0, 0, 0.12) + out, r + out, l + out,
              {kTexConcrete, kConcreteTexelsPerM, 0.4, 0, 0, false});
    }
  };
  const Vec3 ex(1, 0, 0), ey(0, 1, 0);
  object([&](Mesh* m) { hang(m, Vec3(x0, y0 + kHalf, 0), ex, -ey, x1 - kHalf - x0); });          // left on the way out
  object([&](Mesh* m) { hang(m, Vec3(x1 + kHalf, y0 - kHalf, 0), -ex, ey, x1 + kHalf - x0); });  // right
  object([&](Mesh* m) { hang(m, Vec3(x0, y0 - kHalf, 0), ey, ex, 2 * kHalf); });                 // behind
  object([&](Mesh* m) { hang(m, Vec3(x1 - kHalf, y0 + kHalf, 0), ey, ex, y1 - y0 - kHalf); });   // left after the bend
  object([&](Mesh* m) { hang(m, Vec3(x1 + kHalf, y1, 0), -ey, -ex, y1 - y0 + kHalf); });         // right
  object([&](Mesh* m) { hang(m, Vec3(x1 - kHalf, y1, 0), ex, -ey, 2 * kHalf); });                // end
  const Cover ceiling{kTexTiles, 64, 1.05, 0, 0, false}, tube{kTexSkin, 0, 1.55, 0, 0, true};
  const auto cover_top = [&](Mesh* m, double ax, double ay, double bx, double by) {
    // Seen from below: x to the right, then y runs up the picture.
    m->quad(Vec3(bx, by, kHigh), Vec3(ax, by, kHigh), Vec3(ax, ay, kHigh), Vec3(bx, ay, kHigh), ceiling);
  };
  object([&](Mesh* m) {
    for (double x = x0; x < x1 + kHalf; x += 4) {
      cover_top(m, x, y0 - kHalf, std::min(x + 4, x1 + kHalf), y0 + kHalf);
      m->quad(Vec3(x + 1.7, y0 + 0.15, kHigh - 0.04), Vec3(x + 0.5, y0 + 0.15, kHigh - 0.04),
              Vec3(x + 0.5, y0 - 0.15, kHigh - 0.04), Vec3(x + 1.7, y0 - 0.15, kHigh - 0.04), tube);
    }
    for (double y = y0 + kHalf; y < y1; y += 4) {
      cover_top(m, x1 - kHalf, y, x1 + kHalf, std::min(y + 4, y1));
      m->quad(Vec3(x1 + 0.15, y + 1.7, kHigh - 0.04), Vec3(x1 - 0.15, y + 1.7, kHigh - 0.04),
              Vec3(x1 - 0.15, y + 0.5, kHigh - 0.04), Vec3(x1 + 0.15, y + 0.5, kHigh - 0.04), tube);
    }
  });
  for (double x = x0 + 5; x < x1 - 5; x += rng_.uniform(4, 8)) {  // cupboards and boxes along the walls
    const double side = rng_.chance(0.5) ? 1 : -1;
    crate(x, y0 + side * (kHalf - 0.3), 0, rng_.uniform(0.3, 0.7), 0.25, rng_.uniform(0.5, 1.7),
          rng_.chance(0.5) ? kTexDoor : kTexConcrete, rng_.uniform(0.5, 1.1));
  }
  for (double y = y0 + 7; y < y1 - 3; y += rng_.uniform(4, 8)) {
    const double side = rng_.chance(0.5) ? 1 : -1;
    crate(x1 + side * (kHalf - 0.3), y, 0, 0.25, rng_.uniform(0.3, 0.7), rng_.uniform(0.5, 1.7),
          rng_.chance(0.5) ? kTexDoor : kTexConcrete, rng_.uniform(0.5, 1.1));
  }
  for (int i = 0; i < world_.plan_.people; ++i)
    walker(x0 + rng_.uniform(6, 50), y0 + (i % 2 == 0 ? 0.8 : -0.8), i % 2 == 0 ? std::numbers::pi : 0,
           rng_.uniform(0.1, 0.5));
}

}  // namespace godwit::sim
// NOLINTEND(clang-analyzer-security.FloatLoopCounter)
