// The controls by which V4L2 devices set exposure and gain, and what they count in.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "hal/camera/device/exposure_device.h"
#include "hal/camera/v4l2/v4l2_controls.h"

namespace godwit::hal {

/// Its units where the plan gives none: 100 us of V4L2_CID_EXPOSURE_ABSOLUTE, 1 us of Tegra's, and of V4L2_CID_EXPOSURE
/// a line: (width + V4L2_CID_HBLANK) / V4L2_CID_PIXEL_RATE where the device has both.
class V4l2Exposure final : public ExposureDevice {
 public:
  /// Finds the controls; where they are to be set, switches off what the device would do itself. What cannot be done is
  /// told in notes, in words, and left. controls must live longer.
  V4l2Exposure(const V4l2Controls& controls, const ExposurePlan& plan, int width, std::vector<std::string>* notes);

  std::optional<rt::TimeNs> exposure_ns() const override;
  std::optional<double> gain() const override;
  Exposure apply(const Exposure& wanted, const Exposure& now) const override;
  bool has_exposure() const override { return unit_ns_ > 0; }
  bool has_gain() const override { return gain_.has_value(); }
  rt::TimeNs least_ns() const override { return exposure_->low * unit_ns_; }
  rt::TimeNs most_ns() const override { return exposure_->high * unit_ns_; }
  double most_gain() const override { return gain_of(gain_->high); }

 private:
  void take_over(std::vector<std::string>* notes) const;
  void find_exposure(const ExposurePlan& plan, int width, std::vector<std::string>* notes);
  void find_gain(const ExposurePlan& plan, std::vector<std::string>* notes);
  double gain_of(std::int64_t value) const;
  std::int64_t value_of(double gain) const;

  const V4l2Controls& controls_;
  std::optional<V4l2Control> exposure_, gain_;
  rt::TimeNs unit_ns_ = 0;  ///< 0: the exposure cannot be set
  double gain_one_ = 1, gain_step_db_ = 0;
};

}  // namespace godwit::hal
