// What of the tracker's words reaches those who make its poses metric.
#include "firmware_app/pipeline/metric_record.h"

#include <gtest/gtest.h>
#include <limits>

namespace godwit::app {
namespace {

TEST(MetricRecord, OnlyPicturesBeforeAMapThatMovedByNothingAreStill) {
  vo::FrameResult result;
  result.init.status = vo::InitStatus::kNoMotion;
  result.init.still_rad = 1e-3;
  EXPECT_EQ(visual_pose(result, 0, 0).still_rad, 1e-3);
  for (const auto other : {vo::InitStatus::kFirstFrame, vo::InitStatus::kTracksLost, vo::InitStatus::kNoParallax,
                           vo::InitStatus::kTwoMotions, vo::InitStatus::kDone}) {
    result.init.status = other;
    EXPECT_EQ(visual_pose(result, 0, 0).still_rad, 0);
  }
  result.init.status = vo::InitStatus::kNoMotion;
  result.tracked = true;
  EXPECT_EQ(visual_pose(result, 0, 0).still_rad, 0) << "it has a pose: what the first view says is of long ago";
}

TEST(MetricRecord, APoseWithANumberThatIsNoneIsNotTracked) {
  vo::FrameResult result;
  result.tracked = true;
  EXPECT_TRUE(visual_pose(result, 0, 0).tracked);
  result.median_depth = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(visual_pose(result, 0, 0).tracked);
}

}  // namespace
}  // namespace godwit::app
