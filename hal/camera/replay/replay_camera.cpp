#include "hal/camera/replay/replay_camera.h"

#include <cmath>
#include <filesystem>
#include <system_error>

#include "hal/rt/wake_up.h"

namespace godwit::hal {
namespace {

namespace fs = std::filesystem;

/// Time between the first call and the first picture at real pace: enough to decode it.
constexpr rt::TimeNs kLeadNs = 50 * rt::kNsPerMs;
/// At real pace a picture that comes later is not decoded: whoever has fallen behind, because the machine stood or is
/// too slow for all of them, is soon where a camera would be.
constexpr rt::TimeNs kTooLateNs = 500 * rt::kNsPerMs;
/// A wrong calibration shows within this many pictures that can be decoded.
constexpr int kPicturesProbed = 5;

bool is_file(const fs::path& path) {
  std::error_code ignored;
  return fs::is_regular_file(path, ignored);
}

}  // namespace

rt::Result<SequenceLayout> find_sequence(const std::string& folder) {
  const fs::path root(folder);
  std::error_code error;
  if (!fs::is_directory(root, error)) {
    return rt::Error{folder + ": " +
                     (error ? error.message() : "not a folder; scripts/from_video makes one of a video")};
  }
  if (is_file(root / "rgb.txt")) {
    return SequenceLayout{SequenceLayout::Kind::kTum, root / "rgb.txt", root / "camera.yaml", root};
  }
  for (const fs::path& cam0 : {root / "mav0" / "cam0", root / "cam0", root}) {
    if (!is_file(cam0 / "data.csv")) continue;
    return SequenceLayout{SequenceLayout::Kind::kEuroc, cam0 / "data.csv", cam0 / "sensor.yaml", cam0 / "data"};
  }
  return rt::Error{folder +
                   ": no sequence: neither rgb.txt (TUM layout) nor mav0/cam0/data.csv (EuRoC layout) is there, "
                   "nor image_0 or image_2 with times.txt (KITTI's odometry benchmark)"};
}

rt::Result<std::unique_ptr<ReplayCamera>> ReplayCamera::open(const std::string& folder, const ReplayOptions& options) {
  auto layout = find_sequence(folder);
  if (!layout) return layout.error();
  std::unique_ptr<ReplayCamera> camera(new ReplayCamera);
  camera->options_ = options;
  camera->layout_ = std::move(layout).value();
  const SequenceLayout& l = camera->layout_;

  auto calibration_text = read_text_file(l.calibration_file);
  if (!calibration_text) return rt::Error{calibration_text.error().message + " (the camera's calibration is needed)"};
  auto calibration = parse_calibration(calibration_text.value(), l.calibration_file);
  if (!calibration) return calibration.error();
  camera->calibration_ = calibration.value();

  auto index_text = read_text_file(l.index_file);
  if (!index_text) return index_text.error();
  auto index = l.kind == SequenceLayout::Kind::kTum ? parse_tum_index(index_text.value(), l.index_file)
                                                    : parse_euroc_index(index_text.value(), l.index_file);
  if (!index) return index.error();
  camera->index_ = std::move(index).value();

  const auto listed = static_cast<std::int64_t>(camera->index_.entries.size());
  if (options.start < 0 || options.start >= listed) {
    return rt::Error{l.index_file + ": lists " + std::to_string(listed) + " pictures; a start at picture " +
                     std::to_string(options.start) + " leaves none"};
  }
  camera->first_ = options.start;
  camera->last_ =
      options.frames > 0 && options.frames < listed - options.start ? options.start + options.frames : listed;
  camera->total_ = camera->last_ - camera->first_;
  if (options.passes > 1) {
    const auto planned = camera->plan_passes();
    if (!planned) return planned.error();
  }
  const auto sizes = camera->check_size();
  if (!sizes) return sizes.error();
  return camera;
}

std::string ReplayCamera::picture_file(const SequenceEntry& entry) const {
  return fs::path(layout_.pictures) / entry.file;
}

rt::Result<void> ReplayCamera::plan_passes() {
  for (std::int64_t i = first_; i < last_; ++i) {
    if (index_.entries[i].fault == TimeFault::kNone) way_.push_back(i);
  }
  if (way_.size() < 2) {
    return rt::Error{layout_.index_file + ": " + std::to_string(way_.size()) +
                     " pictures with a time; to fly them forth and back takes two at least"};
  }
  total_ = options_.passes * (static_cast<std::int64_t>(way_.size()) - 1) + 1;
  return {};
}

const SequenceEntry& ReplayCamera::entry_at(std::int64_t number, rt::TimeNs* t_ns) const {
  if (way_.empty()) {
    const SequenceEntry& entry = index_.entries[first_ + number];
    *t_ns = entry.t_ns;
    return entry;
  }
  const std::int64_t steps = static_cast<std::int64_t>(way_.size()) - 1;
  const std::int64_t pass = number / steps;
  const std::int64_t step = number % steps;
  const bool back = pass % 2 == 1;
  const auto at = [&](std::int64_t place) -> const SequenceEntry& { return index_.entries[way_[place]]; };
  const SequenceEntry& entry = at(back ? steps - step : step);
  const rt::TimeNs into = back ? at(steps).t_ns - entry.t_ns : entry.t_ns - at(0).t_ns;
  *t_ns = at(0).t_ns + pass * (at(steps).t_ns - at(0).t_ns) + into;
  return entry;
}

rt::Result<void> ReplayCamera::check_size() {
  std::string mismatch;
  int decoded = 0;
  for (std::int64_t i = first_; i < last_ && i < first_ + 4 * kPicturesProbed && decoded < kPicturesProbed; ++i) {
    const std::string file = picture_file(index_.entries[i]);
    if (!decoder_.load(file)) continue;  // bad pictures are told of when they are due
    if (decoder_.width() == width() && decoder_.height() == height()) return {};
    if (mismatch.empty()) {
      mismatch = layout_.calibration_file + ": width, height: " + std::to_string(width()) + " x " +
                 std::to_string(height()) + " pixels, but " + file + " has " + std::to_string(decoder_.width()) +
                 " x " + std::to_string(decoder_.height());
    }
    ++decoded;
  }
  if (mismatch.empty()) return {};
  return rt::Error{mismatch};
}

CameraStatus ReplayCamera::next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns,
                                CapturedFrame* frame, std::string* why) {
  if (next_ >= total_) return CameraStatus::kEnd;
  rt::TimeNs t_ns = 0;
  const SequenceEntry& entry = entry_at(next_, &t_ns);
  const bool real_pace = options_.pace == ReplayOptions::Pace::kReal;
  if (!begun_) {
    begun_ = true;
    const rt::TimeNs first_capture = real_pace ? rt::monotonic_now_ns() + kLeadNs : rt::kNsPerSecond;
    rebase_ns_ = first_capture - t_ns;
    if (options_.time != nullptr) options_.time->pin(t_ns, first_capture);
  }
  frame->t_source_ns = t_ns;
  frame->t_capture_ns = t_ns + rebase_ns_;
  frame->sequence = static_cast<std::uint32_t>(next_);
  // However long a gap in the recording is, whoever waits wants to look at other things meanwhile.
  const rt::TimeNs give_up = rt::monotonic_now_ns() + timeout_ns;
  // Captured when the middle row was read, and whole when the last one was.
  const rt::TimeNs t_whole_ns = frame->t_capture_ns + std::llround(0.5e9 * calibration_.readout_s());
  if (real_pace && entry.fault == TimeFault::kNone && t_whole_ns > give_up) {
    rt::sleep_until_ns(give_up);
    return CameraStatus::kTimeout;
  }
  ++next_;

  const auto bad = [&](std::uint64_t* counter, const std::string& reason) {
    ++*counter;
    if (why != nullptr) *why = reason;
    return CameraStatus::kBadFrame;
  };
  const std::string at = layout_.index_file + ":" + std::to_string(entry.line) + ": time " + format_seconds(entry.t_ns);
  if (entry.fault == TimeFault::kRepeats) return bad(&counters_.time_repeated, at + " repeats");
  if (entry.fault == TimeFault::kGoesBack) return bad(&counters_.time_went_back, at + " goes back");
  if (real_pace && rt::monotonic_now_ns() - frame->t_capture_ns > kTooLateNs) {
    return bad(&counters_.too_late, at + " came " + format_seconds(rt::monotonic_now_ns() - frame->t_capture_ns) +
                                        " s too late: passed over unread");
  }
  if (grey.data == nullptr) {
    if (real_pace) rt::sleep_until_ns(t_whole_ns);
    ++counters_.passed_over;
    return CameraStatus::kFrame;
  }
  const std::string file = picture_file(entry);
  const auto loaded = decoder_.load(file);
  // A bad picture comes due at its time as well: a gap in the pictures is a gap in time.
  if (real_pace) rt::sleep_until_ns(t_whole_ns);
  if (!loaded) return bad(&counters_.bad_pictures, loaded.error().message);
  if (decoder_.width() != width() || decoder_.height() != height()) {
    return bad(&counters_.bad_pictures, file + ": " + std::to_string(decoder_.width()) + " x " +
                                            std::to_string(decoder_.height()) + " pixels; the calibration says " +
                                            std::to_string(width()) + " x " + std::to_string(height()));
  }
  decoder_.write_grey(grey);
  if (bgr != nullptr && channels() == 3) decoder_.write_bgr(bgr);
  ++counters_.delivered;
  return CameraStatus::kFrame;
}

}  // namespace godwit::hal
