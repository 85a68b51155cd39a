// A recorded sequence as a camera: TUM layout (rgb.txt, camera.yaml) or EuRoC/ASL layout (mav0/cam0).
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "hal/camera/calibration.h"
#include "hal/camera/camera.h"
#include "hal/camera/replay/picture_file.h"
#include "hal/camera/replay/sequence_index.h"
#include "hal/replay_time.h"

namespace godwit::hal {

/// Where the parts of a sequence lie.
struct SequenceLayout {
  enum class Kind { kTum, kEuroc };
  Kind kind = Kind::kTum;
  std::string index_file;        ///< rgb.txt, or data.csv
  std::string calibration_file;  ///< camera.yaml, or sensor.yaml
  std::string pictures;          ///< folder that the index's file names are relative to
};

/// Looks at what lies in the folder: rgb.txt; or mav0/cam0, or the folder is mav0 or cam0 itself. Error: the folder is
/// not there, or holds neither.
rt::Result<SequenceLayout> find_sequence(const std::string& folder);

struct ReplayOptions {
  enum class Pace {
    kMax,  ///< next() returns as soon as the picture is decoded
    kReal  ///< next() returns when the picture's last row has been read, as if a camera had just delivered it
  };
  Pace pace = Pace::kMax;
  std::int64_t start = 0;   ///< pictures of the index left out at its beginning
  std::int64_t frames = 0;  ///< pictures taken from there; 0: all
  /// Times the chosen part is flown: forth, back, forth .. without a jump. The picture at a turn is shown once; times
  /// go on as if the way back took as long as the way there, and entries whose time is wrong are left out.
  std::int64_t passes = 1;
  /// Told where the first picture lies on the clock, for the recording's other devices; may be null.
  ReplayTime* time = nullptr;
};

struct ReplayCounters {
  std::uint64_t delivered = 0;
  std::uint64_t bad_pictures = 0;    ///< missing, cut off, not a picture, of another size
  std::uint64_t time_repeated = 0;   ///< skipped for the time in the index
  std::uint64_t time_went_back = 0;  ///< skipped for the time in the index
  std::uint64_t passed_over = 0;     ///< the caller had no room
  std::uint64_t too_late = 0;        ///< at real pace: the machine stood, or is too slow for all of them
};

/// See Camera. Decodes in next(), with OpenCV: call it from a feeder thread. Every picture of the chosen part of the
/// index is due once; its sequence number is its place in that part, from 0. Capture times are rebased: at Pace::kMax
/// the first picture is captured at one second, so that two replays see the same times; at Pace::kReal it is captured
/// shortly after the first call.
class ReplayCamera final : public Camera {
 public:
  /// Reads index and calibration, and looks whether the pictures have the calibration's size. Error: names file, line
  /// or key, and the reason.
  static rt::Result<std::unique_ptr<ReplayCamera>> open(const std::string& folder, const ReplayOptions& options);

  int width() const override { return calibration_.width; }
  int height() const override { return calibration_.height; }
  int channels() const override { return calibration_.channels; }
  /// timeout_ns is not needed: a file is there or not.
  CameraStatus next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns, CapturedFrame* frame,
                    std::string* why) override;

  const CameraCalibration& calibration() const { return calibration_; }
  /// Where the list of pictures breaks off; empty: it does not.
  const std::string& cut_off() const { return index_.cut_off; }
  const SequenceLayout& layout() const { return layout_; }
  /// Pictures that will be due in all.
  std::int64_t total() const { return total_; }
  const ReplayCounters& counters() const { return counters_; }

 private:
  ReplayCamera() = default;
  rt::Result<void> check_size();
  std::string picture_file(const SequenceEntry& entry) const;
  rt::Result<void> plan_passes();
  /// The entry that is due as picture `number`, and its time.
  const SequenceEntry& entry_at(std::int64_t number, rt::TimeNs* t_ns) const;

  ReplayOptions options_;
  SequenceLayout layout_;
  SequenceIndex index_;
  CameraCalibration calibration_;
  PictureDecoder decoder_;
  ReplayCounters counters_;
  std::int64_t first_ = 0, last_ = 0;  ///< places in the index
  std::int64_t next_ = 0, total_ = 0;  ///< pictures due so far, and in all
  bool begun_ = false;                 ///< rebase_ns_ is set
  std::vector<std::int64_t> way_;      ///< several passes: places in the index, from end to end
  rt::TimeNs rebase_ns_ = 0;           ///< capture time = listed time + rebase_ns_
};

}  // namespace godwit::hal
