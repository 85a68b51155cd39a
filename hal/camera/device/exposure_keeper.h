// Keeps a device's exposure as the configuration wants it: off, fixed, or by what the pictures show.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <optional>

#include "hal/camera/device/exposure_device.h"
#include "hal/rt/spsc_ring.h"

namespace godwit::hal {

/// Two sides: saw() and turning() belong to threads that must not wait, the rest to the one that opens the device and
/// sets its controls, which may block as long as a driver likes.
class ExposureKeeper {
 public:
  explicit ExposureKeeper(const ExposurePlan& plan) : plan_(plan) {}

  /// The camera thread, once a picture, with its time on the clock of steer(). False: nobody wants to know. No
  /// allocation, no lock, no wait.
  bool saw(const rt::ImageView& grey, rt::TimeNs t_capture_ns);
  /// How fast the camera turns [rad/s]. Any thread; no lock.
  void turning(double rate_rad_s);

  /// A device was opened: sets it and goes on from what the last one was set to. Valid until end().
  void begin(std::unique_ptr<ExposureDevice> device);
  void end() { device_.reset(); }
  /// Looks at the pictures seen since the last call and sets what must change. One that was taken before the last
  /// setting and lay in a driver's buffer since says nothing of it. True: something was set.
  bool steer(rt::TimeNs now_ns);
  /// How long the device exposes now; nothing: nobody knows. Asks the driver.
  std::optional<rt::TimeNs> exposure_ns() const;
  /// As set last. Valid after begin().
  const Exposure& current() const { return now_; }
  /// Pictures that steer() has looked at. Any thread.
  std::uint64_t steered() const { return steered_.load(std::memory_order_relaxed); }

 private:
  /// A rate of which nothing newer is heard says nothing any more.
  static constexpr rt::TimeNs kTurnKnownNs = 200 * rt::kNsPerMs;
  static constexpr float kNoRate = -1;

  double turn_rate(rt::TimeNs now_ns);

  const ExposurePlan plan_;
  struct Seen {
    Brightness brightness;
    rt::TimeNs t_ns = 0;
  };

  rt::SpscRing<Seen, 16> seen_;
  std::atomic<float> turn_rad_s_{kNoRate};  ///< the largest since the keeper's last look; a number alone
  std::atomic<std::uint64_t> steered_{0};   ///< a number alone
  std::unique_ptr<ExposureDevice> device_;
  std::optional<ExposureControl> control_;
  Exposure now_;
  bool set_before_ = false;
  rt::TimeNs set_ns_ = 0;  ///< the last correction; 0: none yet
  double rate_rad_s_ = 0;
  rt::TimeNs rate_heard_ns_ = 0;
};

}  // namespace godwit::hal
