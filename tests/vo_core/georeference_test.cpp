// North and origin from satellites while they last: found as surely as is said, kept when they end, and not taken from
// a receiver that lies.
#include "vo_core/inertial/georeference.h"

#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <random>

namespace godwit::vo {
namespace georeference_test {

constexpr rt::TimeNs kPicture = rt::kNsPerSecond / 30;
constexpr int kPicturesAFix = 6;

/// A camera that takes off, flies out and turns, at 30 pictures a second; a receiver five times a second, whose place
/// wanders as the estimator's model has it, and whose velocity has a new error each second.
class Flown {
 public:
  explicit Flown(unsigned seed, double heading = 2.1) : engine_(seed), heading_(heading) {}

  double t_s() const { return rt::to_seconds(t_ns_) - 1; }
  Vec3 place(double late_s = 0) const {
    const double t_s = this->t_s() - late_s, t = std::max(0.0, t_s - 4);
    if (circled_s_ < 0) return {3 * t, 6 * std::sin(0.2 * t), std::min(15.0, 2 * t_s)};
    const double course = kCircle * std::min(t_s, circled_s_);
    const Vec3 circled = kSpeed / kCircle * Vec3(std::sin(course), 1 - std::cos(course), 0);
    return circled + std::max(0.0, t_s - circled_s_) * velocity(late_s);
  }
  Vec3 velocity(double late_s = 0) const {
    const double t_s = this->t_s() - late_s, t = t_s - 4, out = t > 0 ? 1 : 0, up = t_s < 7.5 ? 1 : 0;
    if (circled_s_ < 0) return {3 * out, 1.2 * std::cos(0.2 * t) * out, 2 * up};
    const double course = kCircle * std::min(t_s, circled_s_);
    return kSpeed * Vec3(std::cos(course), std::sin(course), 0);
  }
  Mat3 turn() const { return so3_exp(Vec3(0, 0, heading_)); }
  Vec3 told_place(const Vec3& nav) const { return turn() * nav + origin_; }

  NavigatedPlace seen() const {
    NavigatedPlace p;
    p.t_ns = t_ns_;
    p.frame_id = frame_id_;
    p.T_nav_cam.t = place();
    p.velocity_m_s = velocity();
    p.place_variance = 1e-4 * t_s();
    p.heading_variance = 1e-6 * t_s();
    p.velocity_variance = 1e-4;
    return p;
  }
  SatelliteFix fix() {
    const double dt = rt::to_seconds(kPicture) * kPicturesAFix, decay = std::exp(-dt / 30);
    wander_ = begun_ ? Vec3(decay * wander_ + std::sqrt(1 - decay * decay) * sigma_ * noise()) : Vec3(sigma_ * noise());
    begun_ = true;
    SatelliteFix f;
    f.t_ns = t_ns_;
    f.place_m = told_place(place(late_s_)) + wander_ + 0.1 * noise();
    f.place_sigma_m = sigma_;
    if (k_ / kPicturesAFix % 5 == 0) doppler_error_ = 0.1 * noise().head<2>();
    f.velocity_m_s = (turn() * velocity(late_s_)).head<2>() + doppler_error_;
    f.velocity_sigma_m_s = doppler_ ? 0.1 : 0;
    return f;
  }
  template <typename Change>
  void fly(double seconds, Georeference* g, bool satellites, Change change) {
    const rt::TimeNs end_ns = t_ns_ + static_cast<rt::TimeNs>(seconds * 1e9);
    for (; t_ns_ < end_ns; t_ns_ += kPicture, ++k_) {
      if (satellites && k_ % kPicturesAFix == 0) {
        SatelliteFix f = fix();
        change(&f);
        g->take(f);
      }
      g->pose(seen());
    }
  }
  void fly(double seconds, Georeference* g, bool satellites = true) {
    fly(seconds, g, satellites, [](SatelliteFix*) {});
  }
  double heading_error(const Georeference& g) const { return std::remainder(g.heading() - heading_, 2 * M_PI); }
  void new_frame() { ++frame_id_; }
  void turn_frame(double by) { heading_ += by; }
  void no_doppler() { doppler_ = false; }
  /// From the beginning, at height, for so long; then straight on.
  void circle(double seconds) { circled_s_ = seconds; }
  void late(double seconds) { late_s_ = seconds; }
  static constexpr double kSpeed = 10, kCircle = 0.2;  // [m/s, rad/s]

 private:
  Vec3 noise() { return {normal_(engine_), normal_(engine_), normal_(engine_)}; }

  std::mt19937 engine_;
  std::normal_distribution<double> normal_;
  double heading_, sigma_ = 0.6, circled_s_ = -1, late_s_ = 0;
  Vec3 origin_{120, -40, 7}, wander_ = Vec3::Zero();
  Vec2 doppler_error_ = Vec2::Zero();
  bool begun_ = false, doppler_ = true;
  rt::TimeNs t_ns_ = rt::kNsPerSecond;
  int k_ = 0;
  std::uint32_t frame_id_ = 1;
};

void expect_found(const Flown& flown, const Georeference& g) {
  EXPECT_TRUE(g.known());
  EXPECT_LT(std::abs(flown.heading_error(g)), 4 * g.heading_sigma());
  EXPECT_LT(g.heading_sigma(), 0.05);
}

TEST(Georeference, HeadingAndPlaceAreFoundAsSurelyAsIsSaid) {
  double heading2 = 0, place2 = 0;
  constexpr int kFlights = 60;
  for (unsigned seed = 1; seed <= kFlights; ++seed) {
    Flown flown(seed, 0.1 * seed);
    Georeference g;
    flown.fly(20, &g);
    ASSERT_TRUE(g.known()) << seed;
    EXPECT_LT(g.heading_sigma(), 0.02) << seed;
    heading2 += std::pow(flown.heading_error(g) / g.heading_sigma(), 2) / kFlights;
    const Vec3 here = g.origin_m() + so3_exp(Vec3(0, 0, g.heading())) * flown.place();
    place2 += (here - flown.told_place(flown.place())).squaredNorm() / (3 * std::pow(g.place_sigma_m(), 2)) / kFlights;
  }
  EXPECT_GT(heading2, 0.4);
  EXPECT_LT(heading2, 1.6);
  EXPECT_GT(place2, 0.4);
  EXPECT_LT(place2, 1.6);
}

TEST(Georeference, WithoutVelocityAWayShowsIt) {
  for (unsigned seed = 1; seed <= 10; ++seed) {
    Flown flown(seed);
    flown.no_doppler();
    Georeference g;
    flown.fly(40, &g);
    ASSERT_TRUE(g.known()) << seed;
    EXPECT_LT(std::abs(flown.heading_error(g)), 4 * g.heading_sigma()) << seed;
  }
}

TEST(Georeference, WhoStandsShowsNoHeading) {
  Georeference g;
  Flown flown(1);
  flown.fly(3.9, &g);
  EXPECT_FALSE(g.known());
}

TEST(Georeference, WhereSatellitesEndItStaysAndGrowsLessSureAsTheFrameDoes) {
  Flown flown(1);
  Georeference g;
  flown.fly(20, &g);
  const double heading = g.heading(), sigma = g.heading_sigma();
  const Vec3 origin = g.origin_m();
  flown.fly(60, &g, false);
  // By a millionth of a square radian in a second.
  EXPECT_NEAR(std::pow(g.heading_sigma(), 2) - sigma * sigma, 60e-6, 15e-6);
  EXPECT_EQ(g.heading(), heading);
  EXPECT_EQ(g.origin_m(), origin);
  // They come back: the minute between is in it.
  flown.fly(1, &g);
  EXPECT_LT(std::abs(flown.heading_error(g)), 3 * sigma + 0.01);
  EXPECT_EQ(g.refused(), 0U);
}

TEST(Georeference, ANewFrameIsNoSurerThanWhatBrokeTheOldOne) {
  Flown flown(1);
  Georeference g;
  flown.fly(20, &g);
  flown.new_frame();
  flown.fly(1, &g, false);
  EXPECT_TRUE(g.known());
  EXPECT_GT(g.heading_sigma(), 0.3);
  EXPECT_GT(g.place_sigma_m(), 4);
  flown.fly(10, &g);
  expect_found(flown, g);
}

TEST(Georeference, AJumpOfTheReceiverIsRefusedAndOneThatStaysIsGivenUp) {
  Flown flown(3);
  Georeference g;
  flown.fly(20, &g);
  const double heading = g.heading();
  flown.fly(2, &g, true, [](SatelliteFix* f) { f->place_m.x() += 15; });
  EXPECT_GT(g.refused(), 5U);
  EXPECT_EQ(g.given_up(), 0U);
  EXPECT_NEAR(g.heading(), heading, 0.02);
  flown.fly(8, &g, true, [](SatelliteFix* f) { f->place_m.x() += 15; });
  EXPECT_EQ(g.given_up(), 1U);
  EXPECT_TRUE(g.known());
  EXPECT_LT(std::abs(flown.heading_error(g)), 4 * g.heading_sigma());
}

// Late stamps turn all velocities of a steady circle alike, and its places with them.
TEST(Georeference, HowLateAReceiverIsIsInTheHeadingOfASteadyCircleAndStaysThere) {
  const GeoreferenceOptions o;
  double off2 = 0;
  constexpr int kFlights = 20;
  for (unsigned seed = 1; seed <= kFlights; ++seed) {
    Flown flown(seed);
    flown.circle(60);
    flown.late(o.lag_s);
    Georeference g;
    flown.fly(60, &g);
    ASSERT_TRUE(g.known()) << seed;
    EXPECT_GT(g.heading_sigma(), 0.9 * o.lag_s * Flown::kCircle) << seed;
    off2 += std::pow(flown.heading_error(g) / g.heading_sigma(), 2) / kFlights;
    const double sigma = g.heading_sigma();
    flown.fly(40, &g, false);
    EXPECT_GT(g.heading_sigma(), sigma) << "flying straight on without a fix mends nothing";
  }
  EXPECT_GT(off2, 0.5);
  EXPECT_LT(off2, 1.5);
}

TEST(Georeference, HowLateAReceiverIsShowsWhereTheTurnEnds) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    Flown flown(seed);
    flown.circle(20);
    flown.late(0.25);
    Georeference g;
    flown.fly(20, &g);
    const double turning = std::abs(flown.heading_error(g));
    EXPECT_GT(turning, 0.035) << seed;
    flown.fly(3, &g);
    EXPECT_LT(std::abs(flown.heading_error(g)), 0.5 * turning) << seed;
    EXPECT_LT(std::abs(flown.heading_error(g)), 4 * g.heading_sigma()) << seed;
  }
}

/// What a lie does to a north that is known: the largest error of what is told, and the largest in sigmas.
struct Misled {
  double most_rad = 0, most_sigmas = 0;
  bool known = true;
};
template <typename Lie>
Misled misled(unsigned seed, double seconds, Lie lie) {
  Flown flown(seed);
  Georeference g;
  flown.fly(20, &g);
  Misled out;
  out.known = g.known();
  const double begun = flown.t_s();
  while (flown.t_s() < begun + seconds) {
    flown.fly(0.2, &g, true, [&](SatelliteFix* f) { lie(flown.t_s() - begun, f); });
    const double off = std::abs(flown.heading_error(g));
    out.most_rad = std::max(out.most_rad, off);
    out.most_sigmas = std::max(out.most_sigmas, off / g.heading_sigma());
  }
  return out;
}

TEST(Georeference, AFrozenReceiverTurnsNothing) {
  for (const double seconds : {3.0, 10.0, 40.0}) {
    SatelliteFix frozen;
    const Misled m = misled(4, seconds, [&](double, SatelliteFix* f) {
      const rt::TimeNs t_ns = f->t_ns;
      if (frozen.t_ns == 0) frozen = *f;
      *f = frozen;
      f->t_ns = t_ns;
    });
    EXPECT_TRUE(m.known);
    EXPECT_LT(m.most_sigmas, 4) << seconds;
  }
}

// Turned at once, or so slowly that no fix contradicts the one before.
TEST(Georeference, AReceiverThatLiesTurnsAKnownNorthByNoMoreThanItWasKnownTo) {
  constexpr double kMost = 3.5 * 0.035;
  for (const double turn : {0.5, 1.5, 3.1}) {
    for (const bool places : {false, true}) {
      const Misled m = misled(6, 60, [&](double, SatelliteFix* f) {
        f->velocity_m_s = Eigen::Rotation2Dd(turn) * f->velocity_m_s;
        if (places) f->place_m = so3_exp(Vec3(0, 0, turn)) * f->place_m;
      });
      EXPECT_TRUE(m.known);
      EXPECT_LT(m.most_rad, kMost) << turn << (places ? ", places too" : "");
    }
  }
  for (const double rate : {0.002, 0.01, 0.03}) {
    const Misled m = misled(7, 60, [&](double t, SatelliteFix* f) {
      f->velocity_m_s = Eigen::Rotation2Dd(rate * t) * f->velocity_m_s;
      f->place_m = so3_exp(Vec3(0, 0, rate * t)) * f->place_m;
    });
    EXPECT_LT(m.most_rad, kMost) << rate;
  }
}

TEST(Georeference, AfterAFrameThatTurnedWhileItWasBlindFixesAreBelievedAgain) {
  Flown flown(8);
  Georeference g;
  flown.fly(20, &g);
  flown.new_frame();
  flown.turn_frame(2.1);
  flown.fly(30, &g);
  expect_found(flown, g);
}

TEST(Georeference, WhatACorrectionTurnedTheFrameByIsNotKnown) {
  Flown flown(9);
  Georeference g;
  flown.fly(20, &g);
  const double sigma = g.heading_sigma();
  g.corrected(0.05, 0.5);
  EXPECT_NEAR(g.heading_sigma(), std::hypot(sigma, 0.05), 1e-6);
  g.corrected(std::numeric_limits<double>::quiet_NaN(), 0);
  EXPECT_NEAR(g.heading_sigma(), std::hypot(sigma, 0.05), 1e-6);
}

TEST(Georeference, WhatIsNoNumberIsPassedOver) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  Flown flown(5);
  Georeference g;
  flown.fly(10, &g);
  int k = 0;
  flown.fly(10, &g, true, [&](SatelliteFix* f) {
    switch (k++ % 5) {
      case 0:
        f->place_m.y() = kNan;
        break;
      case 1:
        f->velocity_m_s.x() = kNan;
        break;
      case 2:
        f->place_sigma_m = kNan;
        break;
      case 3:
        f->place_sigma_m = 0;
        break;
      default:
        f->velocity_sigma_m_s = -1;
    }
  });
  NavigatedPlace bad = flown.seen();
  bad.T_nav_cam.t.x() = kNan;
  g.pose(bad);
  flown.fly(5, &g);
  EXPECT_TRUE(std::isfinite(g.heading()) && std::isfinite(g.heading_sigma()) && g.origin_m().allFinite());
  EXPECT_LT(std::abs(flown.heading_error(g)), 4 * g.heading_sigma());
}

}  // namespace georeference_test
}  // namespace godwit::vo
