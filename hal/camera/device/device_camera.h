// A device as a Camera: opened, watched, and opened again when it comes back.
#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <string>

#include "hal/camera/camera.h"
#include "hal/camera/device/device_clock.h"
#include "hal/camera/device/exposure_keeper.h"
#include "hal/camera/device/machine_clocks.h"
#include "hal/camera/device/picture_stream.h"
#include "hal/camera/pixels/jpeg_decoder.h"
#include "hal/rt/log_ring.h"
#include "hal/rt/result.h"
#include "hal/rt/thread.h"
#include "hal/rt/triple_buffer.h"
#include "hal/rt/wake_up.h"

namespace godwit::hal {

/// Counts since the start; written by the thread that calls next().
struct DeviceCounters {
  std::uint64_t delivered = 0;
  std::uint64_t lost = 0;     ///< left out in the driver's sequence: nobody took them in time
  std::uint64_t damaged = 0;  ///< marked by the driver, cut off, or no picture
  std::uint64_t clock = 0;    ///< stamps that repeat, go back or jump
  std::uint64_t stalls = 0;   ///< started anew because nothing came
  std::uint64_t gone = 0;     ///< the device went
  std::uint64_t back = 0;     ///< opened again after either
  std::uint64_t passed_over = 0;
};

/// The moment of the middle row's middle of exposure from a stamp. A global shutter's stamp at the end comes after all
/// rows are read; a rolling one's middle row is read half the readout before.
rt::TimeNs middle_of_exposure(rt::TimeNs stamp_ns, bool at_start, rt::TimeNs exposure_ns, rt::TimeNs readout_ns,
                              bool rolling);

/// Two threads: next() belongs to the caller and, but for MJPEG, neither allocates nor locks. Opening, closing, setting
/// controls (the exposure's, too), reading clocks and asking for what is set is the work of a thread of its own, which
/// may block: a device that is gone is looked for five times a second.
class DeviceCamera : public Camera {
 public:
  /// A device that is not there is looked for this often; twice that long it takes at most to have one that came back.
  static constexpr rt::TimeNs kRetryNs = 200 * rt::kNsPerMs;

  /// Hears what went wrong with the device, in words, when it changes; "": all is well again. Called by the camera's
  /// own thread.
  using Tell = std::function<void(const std::string&)>;

  ~DeviceCamera() override;

  int width() const override { return settings_.width; }
  int height() const override { return settings_.height; }
  /// 3 while the device has not been seen and its format is free.
  int channels() const override;
  bool real_time() const override;
  CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns, CapturedFrame* frame,
                    std::string* why) override;
  rt::LogRing* events() override { return &events_; }
  void turning(double rate_rad_s) override { exposure_.turning(rate_rad_s); }

  /// Pictures that the automatic exposure has looked at. Any thread.
  std::uint64_t steered() const { return exposure_.steered(); }
  /// The thread of next() only.
  const DeviceCounters& counters() const { return counters_; }
  const DeviceClock& clock() const { return clock_; }
  bool streaming() const { return stream_ != nullptr; }

 protected:
  /// Opens the device, in the format that is meant if one was decided on; the keeper's thread, from begin() on.
  using OpenStream = std::function<rt::Result<std::unique_ptr<PictureStream>>(std::optional<PixelFormat>)>;

  DeviceCamera(std::unique_ptr<MachineClocks> clocks, const DeviceSettings& settings, OpenStream open_stream, Tell tell)
      : clocks_of_machine_(std::move(clocks)),
        settings_(settings),
        open_stream_(std::move(open_stream)),
        tell_(std::move(tell)),
        exposure_(settings.exposure) {
    if (settings.format) format_.store(static_cast<int>(*settings.format), std::memory_order_relaxed);
  }
  /// Opens the device. One that is not there, or refuses, is no error: it is told and looked for. Error: no thread.
  rt::Result<void> begin(const char* thread);

 private:
  // The caller's thread.
  bool adopt(rt::TimeNs timeout_ns);
  void lose(const char* why);
  CameraStatus deliver(const PictureStream::Buffer& b, const rt::MutableImageView& grey, std::uint8_t* bgr,
                       CapturedFrame* frame, std::string* why);
  void count_due(std::uint32_t driver_sequence);
  /// What is wrong with the stamp, static text; null: nothing, *t_ns is set.
  const char* read_clock(const PictureStream::Buffer& b, rt::TimeNs* t_ns);
  const char* unpack(const PictureStream::Buffer& b, const rt::MutableImageView& grey, std::uint8_t* bgr);
  bool stamped_at_start(const PictureStream::Buffer& b) const;
  void say(rt::LogLevel level, const char* what, const char* which, const char* why, double value);

  // The keeper's.
  void keep();
  bool try_open();
  void ask();

  std::unique_ptr<MachineClocks> clocks_of_machine_;
  DeviceSettings settings_;  ///< after begin() only the keeper's, but for what never changes
  const OpenStream open_stream_;
  const Tell tell_;

  PictureStream* stream_ = nullptr;  ///< the caller's; the keeper opened it and will close it
  bool ever_ = false;                ///< one was adopted before
  DeviceClock clock_;
  ClockOffsets offsets_;  ///< the caller's
  JpegDecoder jpeg_;
  DeviceCounters counters_;
  rt::TimeNs heard_ns_ = 0;  ///< of the newest buffer, or of the adoption
  rt::TimeNs lost_ns_ = 0;
  std::uint32_t due_ = 0;
  std::uint32_t last_sequence_ = 0;
  bool any_sequence_ = false;
  rt::LogRing events_;

  /// Keeper to caller: an open stream. Release and acquire: what open() wrote must be seen before the pointer.
  std::atomic<PictureStream*> fresh_{nullptr};
  /// Caller to keeper: one that is at its end. Release and acquire: the caller's last use comes before the closing.
  std::atomic<PictureStream*> dead_{nullptr};
  /// Keeper to caller: the machine's clocks as they were last read.
  rt::TripleBuffer<ClockOffsets> clocks_;
  ExposureKeeper exposure_;  ///< saw() is the caller's, the rest the keeper's
  /// A number alone: 0 says that the device does not tell.
  std::atomic<rt::TimeNs> exposure_ns_{0};
  /// Of the newest stream, or that which is wanted; -1: none was open yet, and any will do. A number alone.
  std::atomic<int> format_{-1};
  std::atomic<bool> stop_{false};
  rt::WakeUp keeper_wake_, caller_wake_;
  rt::Thread keeper_;
  std::unique_ptr<PictureStream> live_;  ///< the keeper's: what it opened last
  bool wanted_ = true;                   ///< the keeper's: a stream is to be opened
  std::string trouble_;                  ///< the keeper's: told last
};

}  // namespace godwit::hal
