// How the navigation frame lies on the earth, as the pipeline's records have it.
#pragma once

#include "firmware_app/pipeline/frame_record.h"
#include "hal/aid/aid.h"
#include "vo_core/inertial/georeference.h"

namespace godwit::app {

/// Tracker thread; no allocation.
class EarthPoses {
 public:
  /// In the clock of the frames' capture times.
  void take(const hal::AidSample& sample);
  /// A record that is done but for this. Its pose stays where it is.
  void tell(FrameRecord* record);

 private:
  vo::Georeference georeference_;
  std::uint32_t fixes_ = 0;
};

}  // namespace godwit::app
