#include "hal/camera/device/device_camera.h"

#include <algorithm>
#include <utility>

#include "hal/rt/process_end.h"

namespace godwit::hal {
namespace {
/// A driver's sequence number that leaps further was counted anew.
constexpr std::uint32_t kMostLost = 1000;
}  // namespace

rt::TimeNs middle_of_exposure(rt::TimeNs stamp_ns, bool at_start, rt::TimeNs exposure_ns, rt::TimeNs readout_ns,
                              bool rolling) {
  if (at_start) return stamp_ns + exposure_ns / 2 + (rolling ? readout_ns / 2 : 0);
  return stamp_ns - exposure_ns / 2 - (rolling ? readout_ns / 2 : readout_ns);
}

rt::Result<void> DeviceCamera::begin(const char* thread) {
  try_open();
  return keeper_.start(thread, {}, [this] { keep(); });
}

DeviceCamera::~DeviceCamera() {
  // Relaxed: it only ends the loop; join() orders the rest.
  stop_.store(true, std::memory_order_relaxed);
  keeper_wake_.post();
  // A driver that hangs hangs it.
  rt::join_in_time(&keeper_);
}

int DeviceCamera::channels() const {
  const int format = format_.load(std::memory_order_relaxed);
  return format < 0 ? 3 : hal::channels(static_cast<PixelFormat>(format));
}

bool DeviceCamera::real_time() const {
  const int format = format_.load(std::memory_order_relaxed);
  return format >= 0 && static_cast<PixelFormat>(format) != PixelFormat::kMjpeg;
}

bool DeviceCamera::try_open() {
  auto opened = open_stream_(settings_.format);
  std::string trouble = opened ? std::string() : opened.error().message;
  if (trouble != trouble_ && tell_) tell_(trouble);
  trouble_ = std::move(trouble);
  if (!opened) return false;
  live_ = std::move(opened).value();
  PictureStream& s = *live_;
  // Whether the thread of next() may be real-time was decided by the first format.
  settings_.format = s.format();
  std::vector<std::string> notes = s.notes();
  if (auto exposure = s.exposure(settings_.exposure, &notes)) exposure_.begin(std::move(exposure));
  for (const std::string& note : notes) {
    if (tell_) tell_(note);
  }
  exposure_ns_.store(exposure_.exposure_ns().value_or(settings_.exposure_ns), std::memory_order_relaxed);
  clocks_.write(clocks_of_machine_->clock_offsets());
  format_.store(static_cast<int>(s.format()), std::memory_order_relaxed);
  wanted_ = false;
  fresh_.store(live_.get(), std::memory_order_release);
  caller_wake_.post();
  return true;
}

void DeviceCamera::ask() {
  // A device that sets its exposure itself is asked what it chose.
  if (const auto exposure = exposure_.exposure_ns()) exposure_ns_.store(*exposure, std::memory_order_relaxed);
  // Clocks drift, and somebody may set them.
  clocks_.write(clocks_of_machine_->clock_offsets());
}

void DeviceCamera::keep() {
  rt::TimeNs due_ns = 0;
  while (!stop_.load(std::memory_order_relaxed)) {
    keeper_wake_.wait_for(kRetryNs);
    if (dead_.exchange(nullptr, std::memory_order_acquire) != nullptr) {
      exposure_.end();
      live_.reset();
      wanted_ = true;
      due_ns = 0;
    }
    if (live_ != nullptr) live_->keep();
    const rt::TimeNs now_ns = rt::monotonic_now_ns();
    if (live_ != nullptr && exposure_.steer(clocks_of_machine_->now_ns())) {
      exposure_ns_.store(exposure_.current().exposure_ns, std::memory_order_relaxed);
    }
    if (now_ns < due_ns) continue;
    due_ns = now_ns + kRetryNs;
    if (wanted_) {
      try_open();
    } else {
      ask();
    }
  }
}

void DeviceCamera::say(rt::LogLevel level, const char* what, const char* which, const char* why, double value) {
  events_.say(
      {.t_ns = clocks_of_machine_->now_ns(), .level = level, .what = what, .which = which, .why = why, .value = value});
}

bool DeviceCamera::adopt(rt::TimeNs timeout_ns) {
  PictureStream* fresh = fresh_.exchange(nullptr, std::memory_order_acquire);
  if (fresh == nullptr) {
    caller_wake_.wait_for(timeout_ns);
    fresh = fresh_.exchange(nullptr, std::memory_order_acquire);
  }
  if (fresh == nullptr) return false;
  stream_ = fresh;
  clock_.start();
  any_sequence_ = false;
  heard_ns_ = clocks_of_machine_->now_ns();
  if (ever_) {
    ++counters_.back;
    say(rt::LogLevel::kInfo, "camera device is back", "", "after [s]", rt::to_seconds(heard_ns_ - lost_ns_));
  }
  ever_ = true;
  return true;
}

void DeviceCamera::lose(const char* why) {
  lost_ns_ = clocks_of_machine_->now_ns();
  say(rt::LogLevel::kWarning, "camera device lost", why, "", 0);
  dead_.store(std::exchange(stream_, nullptr), std::memory_order_release);
  keeper_wake_.post();
}

CameraStatus DeviceCamera::next(const rt::MutableImageView& grey, std::uint8_t* bgr, rt::TimeNs timeout_ns,
                                CapturedFrame* frame, std::string* why) {
  if (stream_ == nullptr) {
    const rt::TimeNs began_ns = rt::monotonic_now_ns();
    if (!adopt(timeout_ns)) return CameraStatus::kTimeout;
    timeout_ns -= rt::monotonic_now_ns() - began_ns;
  }
  PictureStream::Buffer b;
  PictureStream* const stream = stream_;
  const PictureStream::Take take = stream->take(std::max<rt::TimeNs>(timeout_ns, 0), &b);
  if (take == PictureStream::Take::kNothing) {
    if (clocks_of_machine_->now_ns() - heard_ns_ > settings_.stall_ns) {
      ++counters_.stalls;
      lose("it is there, but sends nothing");
    }
    return CameraStatus::kTimeout;
  }
  if (take == PictureStream::Take::kGone) {
    ++counters_.gone;
    lose("unplugged, or it refuses");
    return CameraStatus::kTimeout;
  }
  heard_ns_ = clocks_of_machine_->now_ns();
  count_due(b.sequence);
  frame->sequence = due_++;
  CameraStatus status = CameraStatus::kBadFrame;
  if (take == PictureStream::Take::kBroken) {
    ++counters_.damaged;
    frame->t_source_ns = b.stamp_ns;
    frame->t_capture_ns = heard_ns_;
    if (why != nullptr) why->assign("camera: the driver marks the picture as damaged");
  } else {
    status = deliver(b, grey, bgr, frame, why);
  }
  if (!stream->give_back(b.index)) {
    ++counters_.gone;
    lose("it takes no buffer back");
  } else if (stream->kept()) {
    keeper_wake_.post();
  }
  return status;
}

void DeviceCamera::count_due(std::uint32_t driver_sequence) {
  const std::uint32_t step = driver_sequence - last_sequence_;
  if (any_sequence_ && step > 1 && step <= kMostLost) {
    counters_.lost += step - 1;
    due_ += step - 1;
  }
  any_sequence_ = true;
  last_sequence_ = driver_sequence;
}

bool DeviceCamera::stamped_at_start(const PictureStream::Buffer& b) const {
  return settings_.stamp_at == StampAt::kAsFlagged ? b.start_of_exposure
                                                   : settings_.stamp_at == StampAt::kStartOfExposure;
}

const char* DeviceCamera::read_clock(const PictureStream::Buffer& b, rt::TimeNs* t_ns) {
  const bool at_start = stamped_at_start(b);
  const rt::TimeNs exposure = b.exposure_ns > 0 ? b.exposure_ns : exposure_ns_.load(std::memory_order_relaxed);
  clocks_.read(&offsets_);
  const DeviceClock::Source source = clock_.source();
  if (source == DeviceClock::Source::kBoottime || source == DeviceClock::Source::kRealtime) {
    clocks_of_machine_->read_clocks(&offsets_);
  }
  const DeviceClock::Reading r =
      clock_.take(b.stamp_ns, heard_ns_, offsets_, at_start ? exposure + settings_.readout_ns : 0);
  if (r.late) {
    say(rt::LogLevel::kWarning, "camera clock: no picture comes soon after its time by",
        DeviceClock::name(clock_.source()), "soonest [s]", rt::to_seconds(r.off_ns));
  }
  if (r.source_changed && clock_.source() != DeviceClock::Source::kMonotonic) {
    say(rt::LogLevel::kWarning, "camera clock is not CLOCK_MONOTONIC but", DeviceClock::name(clock_.source()),
        "offset [s]", rt::to_seconds(clock_.offset_ns()));
  }
  *t_ns = middle_of_exposure(r.t_ns, at_start, exposure, settings_.readout_ns, settings_.rolling);
  switch (r.verdict) {
    case DeviceClock::Verdict::kGood:
      return nullptr;
    case DeviceClock::Verdict::kRepeats:
      return "camera clock: the device's time stands still";
    case DeviceClock::Verdict::kWentBack:
      return "camera clock: the device's time went back";
    case DeviceClock::Verdict::kJumped:
      say(rt::LogLevel::kWarning, "camera clock jumped", DeviceClock::name(clock_.source()), "by [s]",
          rt::to_seconds(r.off_ns));
      return "camera clock: the device's time jumped; it is followed anew";
  }
  return nullptr;
}

const char* DeviceCamera::unpack(const PictureStream::Buffer& b, const rt::MutableImageView& grey, std::uint8_t* bgr) {
  const PictureStream& s = *stream_;
  if (b.bytes > b.capacity) return "camera: the device says it wrote more than the buffer holds";
  if (s.format() == PixelFormat::kMjpeg) return jpeg_.decode(b.data, b.bytes, grey, bgr);
  if (b.bytes < picture_bytes(s.format(), settings_.width, settings_.height, s.stride())) {
    return "camera: the buffer is short, the picture is cut off";
  }
  const int shift = settings_.shift >= 0 ? settings_.shift : usual_shift(s.format());
  convert({.data = b.data, .stride = s.stride(), .format = s.format(), .shift = shift}, grey, bgr);
  return nullptr;
}

CameraStatus DeviceCamera::deliver(const PictureStream::Buffer& b, const rt::MutableImageView& grey, std::uint8_t* bgr,
                                   CapturedFrame* frame, std::string* why) {
  frame->t_source_ns = b.stamp_ns;
  frame->t_capture_ns = heard_ns_;
  const char* wrong = read_clock(b, &frame->t_capture_ns);
  if (wrong != nullptr) {
    ++counters_.clock;
  } else if (grey.data == nullptr) {
    ++counters_.passed_over;
    return CameraStatus::kFrame;
  } else {
    wrong = unpack(b, grey, bgr);
    if (wrong != nullptr) ++counters_.damaged;
    if (wrong == nullptr && exposure_.saw(grey, frame->t_capture_ns)) keeper_wake_.post();
  }
  if (wrong != nullptr) {
    if (why != nullptr) why->assign(wrong);
    return CameraStatus::kBadFrame;
  }
  ++counters_.delivered;
  return CameraStatus::kFrame;
}

}  // namespace godwit::hal
