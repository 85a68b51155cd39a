// Movers found by geometry alone.
#include "vo_core/tracking/motion_gate.h"

#include <gtest/gtest.h>
#include <vector>

namespace godwit::vo {
namespace motion_gate_test {

constexpr int kWidth = 640, kHeight = 480;

struct Measured {
  std::vector<FrameFeature> features;
  std::vector<PoseMeasurement> measurements;
  void add(float x, float y, bool inlier) {
    FrameFeature f;
    f.px = {x, y};
    PoseMeasurement m;
    m.px = {static_cast<double>(x), static_cast<double>(y)};
    m.inlier = inlier;
    features.push_back(f);
    measurements.push_back(m);
  }
  /// Features a cell apart and two a cell, all inliers.
  void add_background() {
    for (int y = 0; y < MotionGate::kRows; ++y)
      for (int x = 0; x < MotionGate::kColumns; ++x)
        for (int k = 0; k < 2; ++k)
          add(static_cast<float>(80 * x + 20 + 30 * k), static_cast<float>(80 * y + 40), true);
  }
};

MotionGate gate() {
  MotionGateOptions options;
  options.on = true;
  return MotionGate(kWidth, kHeight, options);
}

TEST(MotionGate, SingleOutliersStayTheBusinessOfTheRobustPose) {
  Measured m;
  m.add_background();
  for (int x = 0; x < MotionGate::kColumns; ++x) m.add(static_cast<float>(80 * x + 5), 5.0f, false);
  const auto n = static_cast<int>(m.features.size());
  EXPECT_EQ(gate().run(m.features, m.measurements), n);
}

TEST(MotionGate, AMoverTakesItsAgreeingPointsAlongAndNothingElse) {
  Measured m;
  m.add(325.0f, 250.0f, false);
  m.add_background();
  m.add(330.0f, 255.0f, false);
  m.add(335.0f, 260.0f, false);
  const int left = gate().run(m.features, m.measurements);
  ASSERT_EQ(left, 2 * MotionGate::kColumns * MotionGate::kRows - 2) << "the two inliers of the cell go too";
  for (std::size_t i = 0; i < m.features.size(); ++i) {
    const Vec2f px = m.features[i].px;
    const bool in_cell = px.x() >= 320 && px.x() < 400 && px.y() >= 240 && px.y() < 320;
    EXPECT_EQ(in_cell, static_cast<int>(i) >= left) << px.transpose();
    EXPECT_EQ(m.measurements[i].px.cast<float>(), px) << "features and measurements stay together";
  }
  EXPECT_EQ(m.features[0].px, Vec2f(20.0f, 40.0f)) << "the others keep their order";
  EXPECT_EQ(m.features[1].px, Vec2f(50.0f, 40.0f));
}

TEST(MotionGate, NothingIsRejectedWhereTooLittleWouldBeLeft) {
  Measured m;
  for (int i = 0; i < 39; ++i) m.add(10.0f + static_cast<float>(i), 10.0f, true);
  for (int i = 0; i < 5; ++i) m.add(600.0f, 400.0f + static_cast<float>(i), false);
  EXPECT_EQ(gate().run(m.features, m.measurements), 44);
  m.add(50.0f, 10.0f, true);
  EXPECT_EQ(gate().run(m.features, m.measurements), 40);
}

TEST(MotionGate, ThePicturesEdgesBelongToCells) {
  Measured m;
  m.add_background();
  for (int i = 0; i < 3; ++i) m.add(639.9f, 479.9f, false);
  for (int i = 0; i < 3; ++i) m.add(0.0f, 0.0f, false);
  EXPECT_EQ(gate().run(m.features, m.measurements), 2 * MotionGate::kColumns * MotionGate::kRows - 4);
}

TEST(MotionGate, NoFeaturesAreNoError) {
  EXPECT_EQ(gate().run({}, {}), 0);
}

}  // namespace motion_gate_test
}  // namespace godwit::vo
