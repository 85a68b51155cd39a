#include "firmware_app/output/flight_log.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <condition_variable>
#include <csignal>
#include <cstring>
#include <fcntl.h>
#include <filesystem>
#include <map>
#include <mutex>
#include <pthread.h>
#include <sys/stat.h>
#include <thread>
#include <unistd.h>

#include "firmware_app/output/event_line.h"
#include "firmware_app/output/ulog.h"

namespace godwit::app {
namespace {
namespace fs = std::filesystem;
using ulog::Field;

constexpr rt::TimeNs kRetryNs = rt::kNsPerSecond;
constexpr auto kTurn = std::chrono::milliseconds(100);
constexpr std::size_t kNameDigits = 6;

constexpr std::array<Field, 17> kPose = {{{"uint64_t", "timestamp"},
                                          {"uint64_t", "t_done"},
                                          {"double[3]", "position"},
                                          {"double[4]", "q_xyzw"},
                                          {"double[21]", "covariance"},
                                          {"double[3]", "velocity"},
                                          {"double[6]", "velocity_covariance"},
                                          {"double[3]", "reference_position"},
                                          {"double[4]", "reference_q_xyzw"},
                                          {"double[21]", "reference_covariance"},
                                          {"double", "median_depth"},
                                          {"uint64_t", "t_reference"},
                                          {"uint32_t", "reference_id"},
                                          {"uint32_t", "sequence"},
                                          {"uint32_t", "map_id"},
                                          {"uint8_t", "tracked"},
                                          {"uint8_t", "metric"}}};
constexpr std::array<Field, 21> kFrame = {
    {{"uint64_t", "timestamp"},  {"uint64_t", "t_delivered"}, {"uint64_t", "t_done"}, {"uint32_t", "sequence"},
     {"uint32_t", "map_id"},     {"int32_t", "features"},     {"float", "wall_ms"},   {"float", "thread_cpu_ms"},
     {"float", "mapper_cpu_ms"}, {"float", "pyramid_ms"},     {"float", "apply_ms"},  {"float", "initialise_ms"},
     {"float", "align_ms"},      {"float", "reproject_ms"},   {"float", "pose_ms"},   {"float", "keyframe_ms"},
     {"float", "map_ms"},        {"uint8_t", "fate"},         {"uint8_t", "tracked"}, {"uint8_t", "is_keyframe"},
     {"uint8_t", "map_moved"}}};
static_assert(kStages == 8, "frame lists the stages by name");
constexpr std::array<Field, 16> kMapper = {{{"uint64_t", "timestamp"},
                                            {"float", "rms_before_px"},
                                            {"float", "rms_after_px"},
                                            {"uint32_t", "messages"},
                                            {"uint32_t", "adjustments"},
                                            {"int32_t", "seeds"},
                                            {"int32_t", "seeds_updated"},
                                            {"int32_t", "points"},
                                            {"int32_t", "points_new"},
                                            {"int32_t", "keyframes"},
                                            {"int32_t", "free_keyframes"},
                                            {"int32_t", "fixed_keyframes"},
                                            {"int32_t", "adjusted_points"},
                                            {"int32_t", "observations"},
                                            {"int32_t", "iterations"},
                                            {"int32_t", "outliers"}}};
constexpr std::array<Field, 3> kMachine = {
    {{"uint64_t", "timestamp"}, {"float", "temperature_c"}, {"uint8_t", "throttled"}}};
constexpr std::array<Field, 4> kLog = {
    {{"uint64_t", "timestamp"}, {"uint64_t", "written_bytes"}, {"uint64_t", "dropped"}, {"uint32_t", "waiting_bytes"}}};

enum Topic : std::uint16_t { kPoseTopic, kFrameTopic, kMapperTopic, kMachineTopic, kLogTopic };

std::uint64_t us(rt::TimeNs t_ns) {
  return static_cast<std::uint64_t>(t_ns / 1000);
}

std::string definitions(const FlightLogOptions& options, rt::TimeNs t_ns) {
  std::string out;
  ulog::append_header(t_ns, &out);
  ulog::append_flags(&out);
  ulog::append_info("sys_name", "godwit", &out);
  for (const auto& [key, value] : options.info) ulog::append_info(key, value, &out);
  const auto topic = [&out](Topic id, const char* name, auto fields) {
    ulog::append_format(name, fields, &out);
    return std::pair<Topic, const char*>{id, name};
  };
  const std::array<std::pair<Topic, const char*>, 5> topics = {
      topic(kPoseTopic, "pose", std::span(kPose)), topic(kFrameTopic, "frame", std::span(kFrame)),
      topic(kMapperTopic, "mapper", std::span(kMapper)), topic(kMachineTopic, "machine", std::span(kMachine)),
      topic(kLogTopic, "log", std::span(kLog))};
  for (const auto& [id, name] : topics) ulog::append_subscription(id, name, &out);
  return out;
}

/// Number of a flight's file; 0: it is none.
std::uint64_t number_of(const fs::path& file) {
  const std::string stem = file.stem().string();
  std::uint64_t n = 0;
  const auto [end, error] = std::from_chars(stem.data(), stem.data() + stem.size(), n);
  const bool whole = error == std::errc() && end == stem.data() + stem.size() && stem.size() >= kNameDigits;
  return whole && file.extension() == ".ulg" ? n : 0;
}

std::string name_of(std::uint64_t number) {
  const std::string digits = std::to_string(number);
  return std::string(kNameDigits - std::min(kNameDigits, digits.size()), '0') + digits + ".ulg";
}
}  // namespace

struct FlightLog::State {
  explicit State(FlightLogOptions o) : options(std::move(o)) {}

  const FlightLogOptions options;
  std::mutex mutex;
  std::condition_variable change;
  std::string waiting;  // whole messages
  std::uint64_t waiting_messages = 0;
  FlightLogReport report;
  bool ending = false, ended = false, has_thread = false;

  // The writing thread's own.
  int fd = -1;
  std::size_t good_bytes = 0;   // of the present file, up to the end of the last whole chunk
  rt::TimeNs t_retry_ns = 0;    // nothing is tried before
  rt::TimeNs t_trouble_ns = 0;  // since then nothing was written; 0: all is well
  rt::TimeNs t_synced_ns = 0;
  rt::TimeNs t_machine_ns = 0;
  bool unsynced = false;

  ~State() {
    if (fd >= 0) ::close(fd);
  }

  template <typename Append>
  void put(Append append) {
    const std::lock_guard<std::mutex> lock(mutex);
    if (ending) return;  // what comes after the end belongs to no flight
    if (!has_thread || waiting.size() >= options.buffer_bytes) {
      ++report.dropped;
      return;
    }
    append(&waiting);
    ++waiting_messages;
  }

  void run();
  void turn(const std::string& chunk, std::uint64_t messages, rt::TimeNs now_ns);
  bool open(rt::TimeNs now_ns);
  bool write(std::string_view bytes);
  void make_room();
  void look_at_machine(const hal::MachineMonitor& monitor, rt::TimeNs now_ns);
  void fail(const std::string& doing, rt::TimeNs now_ns);
};

void FlightLog::State::fail(const std::string& doing, rt::TimeNs now_ns) {
  const std::string reason = options.folder + ": " + doing + ": " + std::strerror(errno);
  if (fd >= 0) {
    // What was written of the last chunk ends in the middle of a message.
    if (::ftruncate(fd, static_cast<off_t>(good_bytes)) != 0) {
    }
    ::close(fd);
    fd = -1;
  }
  if (t_trouble_ns == 0) t_trouble_ns = now_ns;
  t_retry_ns = now_ns + kRetryNs;
  const std::lock_guard<std::mutex> lock(mutex);
  report.trouble = reason;
}

bool FlightLog::State::write(std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t n = ::write(fd, bytes.data(), bytes.size());
    if (n > 0) {
      bytes.remove_prefix(static_cast<std::size_t>(n));
    } else if (n < 0 && errno != EINTR) {
      return false;
    }
  }
  return true;
}

void FlightLog::State::make_room() {
  std::error_code error;
  std::map<std::uint64_t, std::uintmax_t> flights;
  std::uintmax_t sum = options.file_bytes;  // the one that begins
  for (fs::directory_iterator i(options.folder, error), end; !error && i != end; i.increment(error)) {
    const std::uint64_t n = number_of(i->path());
    std::error_code unknown;
    if (n == 0 || !i->is_regular_file(unknown)) continue;
    const std::uintmax_t bytes = i->file_size(unknown);
    if (!unknown) sum += flights[n] = bytes;
  }
  for (const auto& [n, bytes] : flights) {
    if (sum <= options.budget_bytes) break;
    if (fs::remove(fs::path(options.folder) / name_of(n), error) && !error) sum -= bytes;
  }
}

bool FlightLog::State::open(rt::TimeNs now_ns) {
  ::mkdir(options.folder.c_str(), 0750);
  make_room();
  std::error_code error;
  std::uint64_t last = 0;
  for (fs::directory_iterator i(options.folder, error), end; !error && i != end; i.increment(error)) {
    last = std::max(last, number_of(i->path()));
  }
  const std::string file = (fs::path(options.folder) / name_of(last + 1)).string();
  fd = ::open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0640);
  if (fd < 0) {
    fail("a file cannot be made", now_ns);
    return false;
  }
  good_bytes = 0;
  std::string begin = definitions(options, now_ns);
  if (t_trouble_ns != 0) ulog::append_dropout(now_ns - t_trouble_ns, &begin);
  if (!write(begin)) {
    fail("cannot be written", now_ns);
    return false;
  }
  good_bytes = begin.size();
  t_trouble_ns = 0;
  const std::lock_guard<std::mutex> lock(mutex);
  ++report.files;
  report.written_bytes += begin.size();
  return true;
}

void FlightLog::State::turn(const std::string& chunk, std::uint64_t messages, rt::TimeNs now_ns) {
  if (fd >= 0 && good_bytes >= options.file_bytes) {
    ::fdatasync(fd);
    ::close(fd);
    fd = -1;
  }
  const bool ready = fd >= 0 || (!chunk.empty() && now_ns >= t_retry_ns && open(now_ns));
  if (!chunk.empty()) {
    const bool written = ready && write(chunk);
    if (ready && !written) fail("cannot be written", now_ns);
    if (written) good_bytes += chunk.size();
    unsynced = unsynced || written;
    const std::lock_guard<std::mutex> lock(mutex);
    if (written) {
      report.written_bytes += chunk.size();
    } else {
      report.dropped += messages;
    }
  }
  if (fd >= 0 && unsynced && now_ns - t_synced_ns >= options.sync_ns) {
    if (::fdatasync(fd) != 0) fail("cannot be synchronised", now_ns);
    t_synced_ns = now_ns;
    unsynced = false;
  }
}

void FlightLog::State::look_at_machine(const hal::MachineMonitor& monitor, rt::TimeNs now_ns) {
  if (now_ns - t_machine_ns < rt::kNsPerSecond) return;
  t_machine_ns = now_ns;
  if (options.machine) {
    const hal::MachineState m = monitor.read();
    const auto sample =
        ulog::Sample(now_ns).put(static_cast<float>(m.temperature_c)).put(static_cast<std::uint8_t>(m.throttled));
    put([&](std::string* out) { ulog::append_sample(kMachineTopic, sample.bytes(), out); });
  }
  std::uint64_t written = 0, dropped = 0;
  std::uint32_t bytes = 0;
  {
    const std::lock_guard<std::mutex> lock(mutex);
    written = report.written_bytes;
    dropped = report.dropped;
    bytes = static_cast<std::uint32_t>(waiting.size());
  }
  const auto sample = ulog::Sample(now_ns).put(written).put(dropped).put(bytes);
  put([&](std::string* out) { ulog::append_sample(kLogTopic, sample.bytes(), out); });
}

void FlightLog::State::run() {
  const hal::MachineMonitor monitor(options.machine ? "/sys" : "");
  std::string chunk;
  chunk.reserve(options.buffer_bytes + 65536);
  for (bool last = false; !last;) {
    look_at_machine(monitor, rt::monotonic_now_ns());
    std::uint64_t messages = 0;
    {
      std::unique_lock<std::mutex> lock(mutex);
      change.wait_for(lock, kTurn, [this] { return ending; });
      last = ending;
      chunk.clear();
      chunk.swap(waiting);
      messages = waiting_messages;
      waiting_messages = 0;
    }
    turn(chunk, messages, rt::monotonic_now_ns());
  }
  if (fd >= 0) {
    ::fdatasync(fd);
    ::close(fd);
    fd = -1;
  }
  const std::lock_guard<std::mutex> lock(mutex);
  ended = true;
  change.notify_all();
}

FlightLog::FlightLog(FlightLogOptions options) : state_(std::make_shared<State>(std::move(options))) {
  // Signals are the other threads' business.
  sigset_t all, before;
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &before);
  try {
    state_->waiting.reserve(state_->options.buffer_bytes + 65536);
    state_->has_thread = true;
    // Detached, and with a share of the state: a disc that hangs keeps no end away.
    std::thread([state = state_] {
      pthread_setname_np(pthread_self(), "gw-flightlog");
      try {
        state->run();
      } catch (const std::exception&) {
        // Out of memory: what comes from now on is counted as dropped.
        const std::lock_guard<std::mutex> lock(state->mutex);
        state->has_thread = false;
        state->ended = true;
        state->change.notify_all();
      }
    }).detach();
  } catch (const std::exception&) {
    state_->has_thread = false;
    state_->report.trouble = "no thread to be had for the flight log";
  }
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
}

FlightLog::~FlightLog() {
  finish(rt::kNsPerSecond);
}

void FlightLog::frame(const FrameRecord& r) noexcept {
  try {
    const auto ms = [](rt::TimeNs ns) { return static_cast<float>(rt::to_ms(ns)); };
    ulog::Sample frame(r.t_capture_ns);
    frame.put(us(r.t_delivered_ns)).put(us(r.t_done_ns)).put(r.sequence).put(r.map_id).put(r.features);
    frame.put(ms(r.wall_ns)).put(ms(r.thread_cpu_ns)).put(ms(r.mapper_cpu_ns));
    for (const rt::TimeNs stage : r.stage_ns) frame.put(ms(stage));
    frame.put(static_cast<std::uint8_t>(r.fate));
    for (const bool flag : {r.tracked, r.is_keyframe, r.map_moved}) frame.put(static_cast<std::uint8_t>(flag));
    ulog::Sample pose(r.t_capture_ns);
    if (r.has_pose) {
      pose.put(us(r.t_done_ns)).put_all<double>(r.t_world_cam).put_all<double>(r.q_world_cam);
      pose.put_all<double>(r.covariance).put_all<double>(r.velocity).put_all<double>(r.velocity_covariance);
      pose.put_all<double>(r.t_ref_cam).put_all<double>(r.q_ref_cam).put_all<double>(r.reference_covariance);
      pose.put(r.median_depth).put(us(r.t_reference_ns)).put(r.reference_id).put(r.sequence).put(r.map_id);
      for (const bool flag : {r.tracked, r.metric}) pose.put(static_cast<std::uint8_t>(flag));
    }
    const MappingRecord& m = r.mapping;
    ulog::Sample mapper(r.t_capture_ns);
    if (m.messages > 0) {
      mapper.put(static_cast<float>(m.rms_before_px)).put(static_cast<float>(m.rms_after_px));
      mapper.put(m.messages).put(m.adjustments);
      for (const std::int32_t n : {m.seeds, m.seeds_updated, m.points, m.points_new, m.keyframes, m.free_keyframes,
                                   m.fixed_keyframes, m.adjusted_points, m.observations, m.iterations, m.outliers})
        mapper.put(n);
    }
    state_->put([&](std::string* out) { ulog::append_sample(kFrameTopic, frame.bytes(), out); });
    if (r.has_pose) state_->put([&](std::string* out) { ulog::append_sample(kPoseTopic, pose.bytes(), out); });
    if (m.messages > 0) state_->put([&](std::string* out) { ulog::append_sample(kMapperTopic, mapper.bytes(), out); });
    if (r.fate != FrameFate::kProcessed) text(4, r.t_capture_ns, r.reason.view());
  } catch (const std::exception&) {
  }
}

void FlightLog::event(const rt::LogEntry& e) noexcept {
  try {
    text(e.level == rt::LogLevel::kWarning ? 4 : 6, e.t_ns, event_line(e, 0));
  } catch (const std::exception&) {
  }
}

void FlightLog::text(int level, rt::TimeNs t_ns, std::string_view line) noexcept {
  try {
    state_->put([&](std::string* out) { ulog::append_text(level, t_ns, line, out); });
  } catch (const std::exception&) {
  }
}

FlightLogReport FlightLog::finish(rt::TimeNs patience_ns) noexcept {
  try {
    std::unique_lock<std::mutex> lock(state_->mutex);
    state_->ending = true;
    state_->change.notify_all();
    if (state_->has_thread) {
      state_->change.wait_for(lock, std::chrono::nanoseconds(patience_ns), [this] { return state_->ended; });
    }
    return state_->report;
  } catch (const std::exception&) {
    return {};
  }
}

FlightLogReport FlightLog::report() const noexcept {
  try {
    const std::lock_guard<std::mutex> lock(state_->mutex);
    return state_->report;
  } catch (const std::exception&) {
    return {};
  }
}

}  // namespace godwit::app
