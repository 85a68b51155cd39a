// What the pipeline's records hold where no inertial sensor is flown by: vision's own until an attitude is heard, then
// metres or a reason.
#include "firmware_app/pipeline/aided_poses.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <gtest/gtest.h>
#include <limits>
#include <string>

#include "tests/app/mounting_matrix.h"
#include "tests/vo_core/aided_flown.h"

namespace godwit::app {
namespace aided_poses_test {

using vo::Mat3;
using vo::Vec3;

/// The flight of aided_flown.h as the tracker tells of it.
class Flown {
 public:
  explicit Flown(unsigned seed) : flight_(seed, 0), poses_(mounting_matrix(flight_.mounting_)) {}

  void hear(hal::AidKind kind, double t, const Vec3& value, double sigma) {
    hal::AidSample s;
    s.kind = kind;
    s.t_ns = vo::test::AidedFlown::ns(t);
    Eigen::Map<Vec3>(s.value.data()) = value;
    s.sigma = sigma;
    poses_.take(s);
  }
  FrameRecord frame(int k) {
    const double t = k / 20.0;
    if (attitude_ && k % 2 == 1)
      hear(hal::AidKind::kAttitude, t - 0.01, flight_.R(t - 0.01).transpose() * Vec3::UnitZ(), hal::kAttitudeSigmaRad);
    if (range_ && k % 4 == 3)
      hear(hal::AidKind::kRange, t - 0.02, Vec3(0, 0, -flight_.camera(t - 0.02).t.z() / flight_.R(t - 0.02)(2, 2)),
           0.05);
    const vo::VisualPose seen = flight_.seen(t);
    vo::FrameResult result;
    result.tracked = tracked_;
    result.repeated = repeated_;
    result.state = vo::State::kTracking;
    result.map_id = 1;
    result.T_world_cam = seen.T_map_cam;
    result.covariance = seen.covariance;
    result.own_covariance = seen.own_covariance;
    result.median_depth = seen.median_depth;
    result.points.count = static_cast<int>(seen.points.size());
    std::copy(seen.points.begin(), seen.points.end(), result.points.at.begin());
    if (spoil_) result.T_world_cam.t.x() = std::numeric_limits<double>::quiet_NaN();
    FrameRecord r;
    r.tracked = r.has_pose = result.tracked;
    r.state = result.state;
    r.own_covariance.fill(0.25);
    r.median_depth = 4.5;
    Eigen::Map<Vec3>(r.t_world_cam.data()) = result.T_world_cam.t;
    poses_.make_metric(result, seen.t_ns, &r);
    return r;
  }

  vo::test::AidedFlown flight_;
  AidedPoses poses_;
  bool attitude_ = true, range_ = true, tracked_ = true, repeated_ = false, spoil_ = false;
};

TEST(AidedPoses, AsLongAsNoAttitudeIsHeardTheRecordStaysVisions) {
  Flown f(1);
  f.attitude_ = false;
  for (int k = 0; k < 100; ++k) {
    const FrameRecord r = f.frame(k);
    EXPECT_TRUE(r.tracked && r.has_pose);
    EXPECT_FALSE(r.metric);
    EXPECT_EQ(r.state, vo::State::kTracking);
    EXPECT_EQ(std::string(r.reason.view()), "");
  }
}

TEST(AidedPoses, FromThenOnItIsMetricOrSaysWhatIsMissing) {
  Flown f(2);
  f.range_ = false;
  FrameRecord r;
  for (int k = 0; k < 100; ++k) r = f.frame(k);
  EXPECT_FALSE(r.tracked || r.has_pose || r.metric);
  EXPECT_EQ(r.state, vo::State::kInitialising);
  EXPECT_NE(std::string(r.reason.view()).find("nobody tells the scale well enough: its sigma [0.1 %]"),
            std::string::npos);
  EXPECT_EQ(r.why.limit, 200) << "tenths of a per cent";
  f.range_ = true;
  for (int k = 100; k < 300; ++k) r = f.frame(k);
  ASSERT_TRUE(r.tracked && r.has_pose && r.metric) << r.reason.view();
  EXPECT_EQ(r.frame_id, 1u);
  EXPECT_EQ(r.trust, 1);
  EXPECT_NEAR(r.inertial.aid_share[0], 1, 1e-9);
  EXPECT_GT(r.inertial.aided_log_sigma, 0);
  EXPECT_NEAR(Vec3(r.velocity.data()).norm(), (f.flight_.p(15) - f.flight_.p(14.9)).norm() / 0.1, 0.6);
  EXPECT_FALSE(r.motion.known) << "nobody carries it on between two pictures";
  // What vision saw stays as it was.
  EXPECT_EQ(r.own_covariance[0], 0.25);
  EXPECT_EQ(r.median_depth, 4.5);
}

TEST(AidedPoses, AConfiguredHeightIsASource) {
  Flown f(3);
  f.range_ = false;
  f.poses_.starts_at_height(f.flight_.camera(0).t.z());
  FrameRecord r;
  for (int k = 0; k < 100; ++k) r = f.frame(k);
  ASSERT_TRUE(r.metric) << r.reason.view();
  EXPECT_EQ(r.inertial.aid_share[3], 1);
  EXPECT_NEAR(r.inertial.aided_log_sigma, 0.18, 0.01);
}

TEST(AidedPoses, ARepeatedPictureChangesNothingAndOneThatIsLostIsLeftToVision) {
  Flown f(4);
  for (int k = 0; k < 200; ++k) f.frame(k);
  f.repeated_ = true;
  EXPECT_FALSE(f.frame(200).metric);
  f.repeated_ = false;
  f.tracked_ = false;
  const FrameRecord lost = f.frame(201);
  EXPECT_FALSE(lost.has_pose || lost.metric);
  EXPECT_EQ(lost.state, vo::State::kTracking) << "what vision says of it";
  f.tracked_ = true;
  EXPECT_TRUE(f.frame(202).metric);
}

TEST(AidedPoses, NoNanLeaves) {
  Flown f(5);
  for (int k = 0; k < 200; ++k) f.frame(k);
  f.spoil_ = true;
  EXPECT_FALSE(f.frame(200).tracked);
  f.hear(hal::AidKind::kAttitude, 10.0, Vec3::Constant(std::numeric_limits<double>::quiet_NaN()), 0.02);
  f.hear(hal::AidKind::kRange, 10.0, Vec3::Constant(std::numeric_limits<double>::infinity()), 0.02);
  f.spoil_ = false;
  for (int k = 201; k < 260; ++k) {
    const FrameRecord r = f.frame(k);
    EXPECT_TRUE(r.metric);
    for (const double v : r.covariance) EXPECT_TRUE(std::isfinite(v));
    for (const double v : r.velocity_covariance) EXPECT_TRUE(std::isfinite(v));
    for (const double v : r.t_world_cam) EXPECT_TRUE(std::isfinite(v));
  }
}

}  // namespace aided_poses_test
}  // namespace godwit::app
