// Metres for a map from lengths that others know: what it learns, what it refuses, and what it says when one lies.
#include "vo_core/inertial/scale_state.h"

#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <random>

#include "tests/vo_core/scale_source_name.h"

namespace godwit::vo {
namespace scale_state_test {

using test::scale_source_name;
using Source = ScaleSource;
using Verdict = ScaleVerdict;

constexpr double kScale = 3.7;  // metres in a map unit

/// A flight between 8 and 16 m above ground, seen ten times a second by vision and by whoever measures.
class Flown {
 public:
  explicit Flown(unsigned seed = 1) : engine_(seed) {}
  rt::TimeNs t_ns() const { return rt::kNsPerSecond + k_ * (rt::kNsPerSecond / 10); }
  double t_s() const { return 0.1 * k_; }
  double height() const { return 12 + 4 * std::sin(0.15 * t_s()); }
  void step() { ++k_; }
  double noise(double sigma) { return sigma * normal_(engine_); }

  /// A length of so many metres, with the noise of each.
  Verdict tell(ScaleState* state, Source source, double metres, double sigma, double lie = 0) {
    ScaleReading r;
    r.source = source;
    r.t_ns = t_ns();
    r.metres = metres + noise(sigma) + lie;
    r.metres_sigma = sigma;
    r.units = metres / kScale + noise(0.02);
    r.units_sigma = 0.02;
    return state->take(r);
  }
  Verdict range(ScaleState* s, double lie = 0) { return tell(s, Source::kRange, height(), 0.05, lie); }
  /// The way of ten seconds at 3 m/s.
  Verdict satellites(ScaleState* s, double lie = 0) { return tell(s, Source::kSatellites, 30, 1.0, lie); }
  /// The climb since ten seconds ago.
  Verdict barometer(ScaleState* s, double lie = 0) {
    const double before = 12 + 4 * std::sin(0.15 * (t_s() - 10));
    return tell(s, Source::kBarometer, height() - before, 0.4, lie);
  }

 private:
  std::mt19937 engine_;
  std::normal_distribution<double> normal_;
  int k_ = 0;
};

double off(const ScaleState& s) {
  return std::log(s.scale() / kScale);
}

TEST(ScaleState, WithNothingThereIsNoScale) {
  ScaleState s;
  EXPECT_FALSE(s.known());
  s.advance(100 * rt::kNsPerSecond);
  EXPECT_FALSE(s.known());
  EXPECT_EQ(s.share(Source::kRange), 0);
}

TEST(ScaleState, EachSourceAloneGivesItAndNoSurerThanItIsAsAWhole) {
  for (const Source source : {Source::kRange, Source::kBarometer, Source::kSatellites}) {
    const ScaleOptions options;
    double squared = 0;
    for (unsigned seed = 1; seed <= 20; ++seed) {
      ScaleState s;
      Flown f(seed);
      // This source's own share of wrong, drawn as it is said to be.
      const double bias = std::exp(f.noise(options.bias_sigma[static_cast<std::size_t>(source)]));
      for (; f.t_s() < 30; f.step()) {
        const double before = 12 + 4 * std::sin(0.15 * (f.t_s() - 10));
        const double metres = source == Source::kRange        ? f.height()
                              : source == Source::kSatellites ? 30
                                                              : f.height() - before;
        const double sigma = source == Source::kRange ? 0.05 : source == Source::kSatellites ? 1.0 : 0.4;
        f.tell(&s, source, metres, sigma, metres * (bias - 1));
      }
      EXPECT_TRUE(s.known()) << scale_source_name(source);
      EXPECT_GT(s.log_sigma(), 0.8 * options.bias_sigma[static_cast<std::size_t>(source)]);
      EXPECT_EQ(s.share(source), 1);
      squared += off(s) * off(s) / (s.log_sigma() * s.log_sigma());
    }
    EXPECT_LT(squared / 20, 2.0) << scale_source_name(source);
    EXPECT_GT(squared / 20, 0.3) << scale_source_name(source);
  }
}

TEST(ScaleState, AConfiguredHeightIsEnoughToBeginWithAndAMeasurementOverrulesIt) {
  ScaleState s;
  Flown f;
  f.tell(&s, Source::kStartHeight, 12, 0.5, 1.5);  // 1.5 m wrong
  EXPECT_FALSE(s.known()) << "15 % are too little to be told as metres";
  for (; f.t_s() < 5; f.step()) f.range(&s);
  EXPECT_TRUE(s.known());
  EXPECT_LT(std::abs(off(s)), 0.06);
  EXPECT_GT(s.share(Source::kRange), 0.01);
}

TEST(ScaleState, WithoutReadingsItBecomesLessSureUntilItIsNotKnown) {
  ScaleState s;
  Flown f;
  for (; f.t_s() < 10; f.step()) f.range(&s);
  const double sigma = s.log_sigma();
  s.advance(f.t_ns() + 60 * rt::kNsPerSecond);
  EXPECT_GT(s.log_sigma(), sigma);
  s.advance(f.t_ns() + rt::TimeNs{40'000} * rt::kNsPerSecond);
  EXPECT_FALSE(s.known());
}

TEST(ScaleState, ANewMapIsUnknownAndLearnsFasterWhatTheSourcesAreOffBy) {
  ScaleState s;
  Flown f;
  for (; f.t_s() < 30; f.step()) {
    f.range(&s, 0.1 * f.height());  // the rangefinder reads 10 % too much
    f.satellites(&s);
  }
  EXPECT_LT(std::abs(off(s)), 0.05);
  s.new_map();
  EXPECT_FALSE(s.known());
  for (const double end = f.t_s() + 5; f.t_s() < end; f.step()) f.range(&s, 0.1 * f.height());
  EXPECT_TRUE(s.known());
  EXPECT_LT(std::abs(off(s)), 0.06) << "its 10 % are remembered from the satellites";
}

// Offsets, drifts and freezing of each source beside one that is true.
TEST(ScaleState, ASourceThatLiesBesideATrueOneDoesNotCarryTheScaleAway) {
  using Tell = Verdict (Flown::*)(ScaleState*, double);
  struct Case {
    const char* name;
    Tell liar, witness;
    Source source;
    double offset, drift;
  };
  const Case cases[] = {
      {"rangefinder, offset", &Flown::range, &Flown::satellites, Source::kRange, 6, 0},
      {"rangefinder, drift", &Flown::range, &Flown::satellites, Source::kRange, 0, 0.1},
      {"barometer, drift", &Flown::barometer, &Flown::satellites, Source::kBarometer, 0, 0.05},
      {"barometer, offset", &Flown::barometer, &Flown::range, Source::kBarometer, 5, 0},
      {"satellites, offset", &Flown::satellites, &Flown::range, Source::kSatellites, 20, 0},
      {"satellites, drift", &Flown::satellites, &Flown::range, Source::kSatellites, 0, 0.3},
  };
  for (const Case& c : cases) {
    ScaleState s;
    Flown f(7);
    for (; f.t_s() < 20; f.step()) (f.*c.liar)(&s, 0), (f.*c.witness)(&s, 0);
    double worst = 0;
    for (; f.t_s() < 120; f.step()) {
      (f.*c.liar)(&s, c.offset + c.drift * (f.t_s() - 20));
      (f.*c.witness)(&s, 0);
      worst = std::max(worst, std::abs(off(s)) / s.log_sigma());
    }
    EXPECT_LT(worst, 3.5) << c.name << ": the sigma told covers it all along";
    // Of two that part slowly nobody can tell which is right.
    EXPECT_LT(std::abs(off(s)), c.source == Source::kSatellites && c.drift > 0 ? 0.5 : 0.15) << c.name;
    EXPECT_GT(s.count(c.source, Verdict::kContradicts) + s.count(c.source, Verdict::kDistrusted), 20u) << c.name;
    EXPECT_EQ(s.given_up(), 0u) << c.name;
  }
}

TEST(ScaleState, TwoThatAgreeAreRightAgainstAThird) {
  ScaleState s;
  Flown f(8);
  for (; f.t_s() < 20; f.step()) f.satellites(&s), f.range(&s), f.barometer(&s);
  for (; f.t_s() < 60; f.step()) f.satellites(&s, 20), f.range(&s), f.barometer(&s);
  EXPECT_LT(std::abs(off(s)), 0.08);
  EXPECT_TRUE(s.known());
  EXPECT_GT(s.count(Source::kSatellites, Verdict::kDistrusted), 50u);
}

TEST(ScaleState, AFrozenSourceIsFoundOutWhileVisionMoves) {
  ScaleState s;
  Flown f;
  for (; f.t_s() < 20; f.step()) f.range(&s);
  const double before = off(s);
  ScaleReading stuck;
  stuck.metres = f.height();
  stuck.metres_sigma = 0.05;
  stuck.units_sigma = 0.02;
  for (; f.t_s() < 40; f.step()) {
    stuck.t_ns = f.t_ns();
    stuck.units = f.height() / kScale;
    s.take(stuck);
  }
  EXPECT_GT(s.count(Source::kRange, Verdict::kFrozen) + s.count(Source::kRange, Verdict::kContradicts), 100u);
  EXPECT_LT(std::abs(off(s) - before), 0.1);
}

TEST(ScaleState, AloneAgainstWhatItToldBeforeNothingIsKnownAnyMore) {
  ScaleState s;
  Flown f;
  for (; f.t_s() < 20; f.step()) f.range(&s);
  ASSERT_TRUE(s.known());
  for (; f.t_s() < 23; f.step()) f.range(&s, 10);
  EXPECT_EQ(s.given_up(), 1u);
  EXPECT_NE(s.reason()[0], '\0');
}

TEST(ScaleState, WhatIsNoNumberOrTooShortChangesNothing) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  ScaleState s;
  Flown f;
  for (; f.t_s() < 20; f.step()) f.range(&s);
  const double scale = s.scale(), sigma = s.log_sigma();
  ScaleReading good;
  good.t_ns = f.t_ns();
  good.metres = f.height();
  good.units = f.height() / kScale;
  good.metres_sigma = 0.05;
  good.units_sigma = 0.02;
  const auto spoiled = [&](double ScaleReading::*field, double value) {
    ScaleReading r = good;
    r.*field = value;
    return s.take(r);
  };
  for (const double bad : {kNan, std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity()}) {
    for (const auto field :
         {&ScaleReading::metres, &ScaleReading::units, &ScaleReading::metres_sigma, &ScaleReading::units_sigma}) {
      EXPECT_EQ(spoiled(field, bad), Verdict::kNoNumber);
    }
  }
  EXPECT_EQ(spoiled(&ScaleReading::metres_sigma, -1), Verdict::kNoNumber);
  EXPECT_EQ(s.scale(), scale);
  EXPECT_EQ(spoiled(&ScaleReading::metres, 0), Verdict::kTooShort);
  EXPECT_EQ(spoiled(&ScaleReading::units, -3), Verdict::kTooShort);
  EXPECT_EQ(spoiled(&ScaleReading::metres_sigma, 100), Verdict::kTooShort);
  EXPECT_EQ(s.scale(), scale);
  EXPECT_NEAR(s.log_sigma(), sigma, 1e-3);
  ScaleReading late = good;
  late.t_ns -= rt::kNsPerSecond;
  EXPECT_EQ(s.take(late), Verdict::kNoNumber) << "times that go back";
}

}  // namespace scale_state_test
}  // namespace godwit::vo
