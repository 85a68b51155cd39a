// One interface to every source of pictures: replay, V4L2, libcamera, simulation.
#pragma once

#include <cstdint>
#include <string>

#include "hal/rt/image.h"
#include "hal/rt/log_ring.h"
#include "hal/rt/result.h"
#include "hal/rt/time.h"

namespace godwit::hal {

/// What became of one call of Camera::next.
enum class CameraStatus : std::uint8_t {
  kFrame,     ///< a picture was delivered
  kBadFrame,  ///< a picture was due but missing, truncated or of the wrong size: counted, skipped
  kTimeout,   ///< nothing came in time
  kEnd        ///< the source is at its end
};

/// What a source says of the picture it wrote into the caller's slot.
struct CapturedFrame {
  rt::TimeNs t_capture_ns = 0;  ///< middle of exposure, CLOCK_MONOTONIC (replay and simulation: rebased)
  rt::TimeNs t_source_ns = 0;   ///< the source's own timestamp, exact, as in its index; for output files
  std::uint32_t sequence = 0;   ///< counts every picture that was due, also bad ones
};

/// A source of grey pictures of one fixed size. One thread calls it.
class Camera {
 public:
  virtual ~Camera() = default;
  virtual int width() const = 0;
  virtual int height() const = 0;
  virtual int channels() const = 0;  ///< 1 grey, 3 BGR in the source
  /// next() neither allocates nor locks and blocks only while it waits for a picture: the thread that calls it may be
  /// held to the rules of the frame path. False where files are decoded or pictures rendered in next().
  virtual bool real_time() const { return false; }
  /// Writes the next picture as grey into grey and, where the source has colour and bgr is not null, its BGR pixels
  /// (width * 3 bytes a row, no padding) into bgr. Waits at most timeout_ns. After kBadFrame `why` (if given) names the
  /// file and the reason.
  /// An empty grey view means that the caller has no room for this picture: it is waited for and passed over, *frame
  /// says which one it was.
  virtual CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns,
                            CapturedFrame* frame, std::string* why) = 0;
  /// How fast the camera turns, from whoever knows: an automatic exposure keeps motion blur small by it. Any thread; no
  /// allocation, no lock.
  virtual void turning(double /*rate_rad_s*/) {}
  /// What the device has to say beside its pictures (lost, back, a clock that is not what it says); null: nothing. The
  /// thread of next() writes, one other may read.
  virtual rt::LogRing* events() { return nullptr; }
};

}  // namespace godwit::hal
