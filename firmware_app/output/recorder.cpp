#include "firmware_app/output/recorder.h"

#include <algorithm>
#include <array>
#include <filesystem>
#include <fmt/format.h>
#include <memory>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <vector>

#include "hal/atomic_file.h"
#include "hal/imu/error_model.h"
#include "hal/rt/frame_pool.h"
#include "hal/rt/process_end.h"
#include "hal/rt/thread.h"

namespace godwit::app {
namespace {

namespace fs = std::filesystem;

/// PNG of 752 x 480 takes some 5 ms: one keeps up with 60 Hz three times over, but not on a processor that others want.
constexpr std::size_t kWriters = 3;
/// So many pictures behind, a writer stops packing them: that halves its work and doubles the file.
constexpr std::size_t kBehind = 8;
constexpr rt::TimeNs kWaitNs = 50 * rt::kNsPerMs;
/// A device that is asked for 50 ms at most and is not back after so long hangs: what there is is finished without it.
constexpr rt::TimeNs kHangsNs = rt::kNsPerSecond;
/// A disc that took no picture for so long hangs: cards stand still for seconds while they tidy up. What waits at the
/// end, up to 46 MB of 752 x 480, is written however long a slow one takes.
constexpr rt::TimeNs kDiscHangsNs = 10 * rt::kNsPerSecond;

class Recording {
 public:
  Recording(hal::Camera* camera, hal::Imu* imu, const RecorderOptions& options)
      : camera_(camera), imu_(imu), options_(options), jobs_(kWriters) {}

  rt::Result<Recorded> run(const RecorderProgress& progress, const std::atomic<bool>& stop);

 private:
  using Jobs = rt::SpscRing<rt::FrameHandle, rt::kMaxFrameSlots>;

  rt::Result<void> prepare();
  rt::Result<void> start_threads();
  void read_camera();
  void read_imu();
  void write_pictures(std::size_t writer);
  void collect_samples();
  bool time_is_up() const;
  Recorded so_far() const;
  void end_writers();
  rt::Result<void> finish();
  std::string data_folder() const { return options_.out + "/mav0/cam0/data"; }

  hal::Camera* camera_;
  hal::Imu* imu_;
  const RecorderOptions& options_;
  std::unique_ptr<rt::FramePool> pool_;
  std::vector<std::unique_ptr<Jobs>> jobs_;  ///< one for each writer
  std::array<rt::WakeUp, kWriters> wake_;
  std::array<rt::Thread, kWriters> writers_;
  std::array<std::vector<rt::TimeNs>, kWriters> written_;  ///< capture times; read after the threads have ended
  std::array<std::string, kWriters> failed_;               ///< the same
  rt::Thread camera_thread_, imu_thread_;
  std::unique_ptr<rt::SpscRing<hal::ImuSample, 4096>> samples_ = std::make_unique<rt::SpscRing<hal::ImuSample, 4096>>();
  std::string imu_text_;
  hal::AtomicFile imu_file_;
  rt::TimeNs began_ns_ = 0;
  // Numbers alone; nothing is ordered by them.
  std::atomic<std::uint64_t> pictures_{0}, bad_{0}, missed_{0}, taken_{0}, imu_faults_{0};
  std::uint64_t samples_written_ = 0;
  std::atomic<bool> stop_{false};
  /// Release: all jobs were pushed before, but those of a camera that hangs. Partner: the acquire load in
  /// write_pictures().
  std::atomic<bool> camera_done_{false};
  std::atomic<bool> failing_{false};
};

rt::Result<void> Recording::prepare() {
  if (fs::exists(options_.out + "/mav0")) return rt::Error{options_.out + ": already holds a recording"};
  std::error_code error;
  for (const char* folder : {"/mav0/cam0/data", "/mav0/imu0"}) {
    if (folder[6] == 'c' ? camera_ == nullptr : imu_ == nullptr) continue;
    fs::create_directories(options_.out + folder, error);
    if (error) return rt::Error{options_.out + folder + ": cannot make the folder: " + error.message()};
  }
  if (imu_ != nullptr) {
    if (auto r = imu_file_.open(options_.out + "/mav0/imu0/data.csv"); !r) return r;
    if (auto r = imu_file_.write("#timestamp [ns],w_x [rad s^-1],w_y [rad s^-1],w_z [rad s^-1],a_x [m s^-2],a_y [m "
                                 "s^-2],a_z [m s^-2]\n");
        !r) {
      return r;
    }
  }
  if (camera_ == nullptr) return {};
  rt::FramePool::Layout layout;
  layout.width = camera_->width();
  layout.height = camera_->height();
  layout.slots = rt::kMaxFrameSlots;
  layout.readers = kWriters;
  auto pool = rt::FramePool::create(layout);
  if (!pool) return pool.error();
  pool_ = std::move(pool).value();
  for (auto& jobs : jobs_) jobs = std::make_unique<Jobs>();
  return {};
}

bool Recording::time_is_up() const {
  return options_.seconds > 0 && rt::to_seconds(rt::monotonic_now_ns() - began_ns_) >= options_.seconds;
}

void Recording::read_camera() {
  std::string why;
  why.reserve(256);
  std::uint32_t next = 0;
  bool any = false;
  std::size_t writer = 0;
  while (!stop_.load(std::memory_order_relaxed)) {
    const int slot = pool_->acquire();
    const rt::MutableImageView grey = slot >= 0 ? pool_->grey(slot) : rt::MutableImageView{};
    hal::CapturedFrame frame;
    const hal::CameraStatus status = camera_->next(grey, nullptr, kWaitNs, &frame, &why);
    const bool due = status == hal::CameraStatus::kFrame || status == hal::CameraStatus::kBadFrame;
    if (due) {
      if (any && frame.sequence > next) missed_.fetch_add(frame.sequence - next, std::memory_order_relaxed);
      next = frame.sequence + 1;
      any = true;
    }
    if (status == hal::CameraStatus::kFrame && slot < 0) pool_->count_drop();
    if (status == hal::CameraStatus::kBadFrame) bad_.fetch_add(1, std::memory_order_relaxed);
    if (status != hal::CameraStatus::kFrame || slot < 0) {
      if (slot >= 0) pool_->cancel(slot);
      if (status == hal::CameraStatus::kEnd) break;
      continue;
    }
    pool_->meta(slot) = {frame.t_capture_ns, frame.t_source_ns, frame.sequence};
    pool_->hand_out(slot, 1);
    // Never full: it has room for every slot there is.
    jobs_[writer]->try_push({slot, pool_->meta(slot)});
    wake_[writer].post();
    writer = (writer + 1) % kWriters;
    taken_.fetch_add(1, std::memory_order_relaxed);
  }
  camera_done_.store(true, std::memory_order_release);
  for (rt::WakeUp& wake : wake_) wake.post();
}

void Recording::read_imu() {
  while (!stop_.load(std::memory_order_relaxed)) {
    hal::ImuSample sample;
    const hal::ImuStatus status = imu_->next(&sample, kWaitNs);
    if (status == hal::ImuStatus::kEnd) break;
    if (status == hal::ImuStatus::kSample && samples_->try_push(sample)) continue;
    if (status == hal::ImuStatus::kTimeout) continue;
    imu_faults_.fetch_add(1, std::memory_order_relaxed);
    rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerMs);
  }
}

void Recording::write_pictures(std::size_t writer) {
  rt::FrameReturn give = pool_->reader(static_cast<int>(writer));
  const std::vector<int> packed{cv::IMWRITE_PNG_COMPRESSION, 1, cv::IMWRITE_PNG_STRATEGY,
                                cv::IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY};
  const std::vector<int> as_it_is{cv::IMWRITE_PNG_COMPRESSION, 0};
  while (true) {
    // Before the look into the ring: what was pushed before it was set is then there.
    const bool last = camera_done_.load(std::memory_order_acquire);
    rt::FrameHandle job;
    if (!jobs_[writer]->try_pop(&job)) {
      if (last) return;
      wake_[writer].wait_for(kWaitNs);
      continue;
    }
    const rt::MutableImageView grey = pool_->grey(job.slot);
    const cv::Mat picture(grey.height, grey.width, CV_8U, grey.data, grey.stride);
    const std::string file = fmt::format("{}/{}.png", data_folder(), job.meta.t_capture_ns);
    bool done = false;
    try {
      done = failed_[writer].empty() && cv::imwrite(file, picture, jobs_[writer]->size() > kBehind ? as_it_is : packed);
    } catch (const cv::Exception&) {
    }
    give.give_back(job.slot);
    if (done) {
      written_[writer].push_back(job.meta.t_capture_ns);
      pictures_.fetch_add(1, std::memory_order_relaxed);
    } else if (failed_[writer].empty()) {
      failed_[writer] = file + ": cannot be written";
      failing_.store(true, std::memory_order_relaxed);
    }
  }
}

void Recording::collect_samples() {
  hal::ImuSample s;
  imu_text_.clear();
  while (samples_->try_pop(&s)) {
    const auto &w = s.gyro_rad_s, &a = s.accel_m_s2;
    fmt::format_to(std::back_inserter(imu_text_), "{},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f}\n", s.t_ns, w[0], w[1],
                   w[2], a[0], a[1], a[2]);
    ++samples_written_;
  }
}

Recorded Recording::so_far() const {
  Recorded out;
  out.pictures = pictures_.load(std::memory_order_relaxed);
  out.bad = bad_.load(std::memory_order_relaxed);
  out.missed = missed_.load(std::memory_order_relaxed);
  out.dropped = pool_ != nullptr ? pool_->exhausted() : 0;
  out.samples = samples_written_;
  out.imu_faults = imu_faults_.load(std::memory_order_relaxed);
  out.seconds = rt::to_seconds(rt::monotonic_now_ns() - began_ns_);
  return out;
}

rt::Result<void> Recording::start_threads() {
  if (camera_ != nullptr) {
    for (std::size_t i = 0; i < kWriters; ++i) {
      if (auto r = writers_[i].start("gw-write", {}, [this, i] { write_pictures(i); }); !r) return r;
    }
    if (auto r = camera_thread_.start("gw-camera", {}, [this] { read_camera(); }); !r) return r;
  }
  if (imu_ != nullptr) return imu_thread_.start("gw-imu", {}, [this] { read_imu(); });
  return {};
}

rt::Result<Recorded> Recording::run(const RecorderProgress& progress, const std::atomic<bool>& stop) {
  if (auto r = prepare(); !r) return r.error();
  began_ns_ = rt::monotonic_now_ns();
  rt::Result<void> result = start_threads();
  if (!result) camera_done_.store(true, std::memory_order_release);
  bool full = false;
  while (result.ok() && !stop.load(std::memory_order_relaxed) && !time_is_up() && !full &&
         !failing_.load(std::memory_order_relaxed) &&
         !(camera_ != nullptr && camera_done_.load(std::memory_order_acquire))) {
    rt::sleep_until_ns(rt::monotonic_now_ns() + 2 * kWaitNs);
    collect_samples();
    if (imu_ != nullptr) result = imu_file_.write(imu_text_);
    std::error_code ignored;
    const auto space = fs::space(options_.out, ignored);
    full = !ignored && space.available < options_.free_bytes;
    if (progress) progress(so_far(), space.available);
  }
  stop_.store(true, std::memory_order_relaxed);
  end_writers();
  collect_samples();
  Recorded done = so_far();
  done.disc_full = full;
  const rt::Result<void> finished = finish();  // also after an error: what was written is to be found
  rt::join_in_time(&camera_thread_);
  rt::join_in_time(&imu_thread_);
  if (done.pictures == 0 && done.samples == 0) {
    // Or the same command, once the device is plugged in, would find a recording there.
    std::error_code ignored;
    fs::remove_all(options_.out + "/mav0", ignored);
  }
  if (!result) return result.error();
  for (const std::string& failed : failed_) {
    if (!failed.empty()) return rt::Error{failed};
  }
  if (!finished) return finished.error();
  return done;
}

/// Once no device is read any more, or hangs: the pictures that wait are written.
void Recording::end_writers() {
  const rt::TimeNs hangs_ns = rt::monotonic_now_ns() + kHangsNs;
  const auto comes_back = [&](const rt::Thread& device) {
    while (device.running() && !device.ended() && rt::monotonic_now_ns() < hangs_ns) {
      rt::sleep_until_ns(rt::monotonic_now_ns() + rt::kNsPerMs);
    }
    return !device.running() || device.ended();
  };
  comes_back(imu_thread_);
  if (!comes_back(camera_thread_)) {
    camera_done_.store(true, std::memory_order_release);
    for (rt::WakeUp& wake : wake_) wake.post();
  }
  const auto written = [this] { return pictures_.load(std::memory_order_relaxed); };
  for (rt::Thread& writer : writers_) rt::join_as_it_works(&writer, written, kDiscHangsNs);
}

rt::Result<void> Recording::finish() {
  const auto write = [&](const std::string& name, const std::string& text) -> rt::Result<void> {
    hal::AtomicFile file;
    if (auto r = file.open(options_.out + name); !r) return r;
    if (auto r = file.write(text); !r) return r;
    return file.commit();
  };
  if (imu_ != nullptr) {
    if (auto r = imu_file_.write(imu_text_); !r) return r;
    if (auto r = imu_file_.commit(); !r) return r;
    const std::string ranges = hal::sensor_yaml(imu_->rate_hz(), imu_->ranges());
    if (!ranges.empty()) {
      if (auto r = write("/mav0/imu0/sensor.yaml", ranges); !r) return r;
    }
  }
  if (camera_ == nullptr) return {};
  if (!options_.calibration.empty()) {
    if (auto r = write("/mav0/cam0/" + options_.calibration_name, options_.calibration); !r) return r;
  }
  std::vector<rt::TimeNs> times = written_[0];
  for (std::size_t i = 1; i < kWriters; ++i) times.insert(times.end(), written_[i].begin(), written_[i].end());
  std::sort(times.begin(), times.end());
  std::string list = "#timestamp [ns],filename\n";
  for (const rt::TimeNs t : times) fmt::format_to(std::back_inserter(list), "{},{}.png\n", t, t);
  return write("/mav0/cam0/data.csv", list);
}

}  // namespace

rt::Result<Recorded> record_devices(hal::Camera* camera, hal::Imu* imu, const RecorderOptions& options,
                                    const RecorderProgress& progress, const std::atomic<bool>& stop) {
  return Recording(camera, imu, options).run(progress, stop);
}

}  // namespace godwit::app
