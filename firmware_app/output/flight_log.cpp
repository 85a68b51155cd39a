#include "firmware_app/output/flight_log.h"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <condition_variable>
#include <cstring>
#include <fcntl.h>
#include <filesystem>
#include <map>
#include <mutex>
#include <sys/stat.h>
#include <unistd.h>

#include "firmware_app/output/detached_thread.h"
#include "firmware_app/output/event_line.h"
#include "firmware_app/output/flight_topics.h"
#include "firmware_app/output/ulog.h"
#include "hal/rt/process_end.h"

namespace godwit::app {
namespace {
namespace fs = std::filesystem;

constexpr rt::TimeNs kRetryNs = rt::kNsPerSecond;
constexpr auto kTurn = std::chrono::milliseconds(100);
constexpr std::size_t kNameDigits = 6;

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

/// The disc is made to have the folder's list of files: a file without its name is lost. A file system that cannot do
/// it keeps the list by other means.
void keep_names(const fs::path& folder) {
  const int fd = ::open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return;
  ::fsync(fd);
  ::close(fd);
}
}  // namespace

std::string next_flight_file(const std::string& file) {
  const std::uint64_t n = number_of(file);
  return n > 0 ? (fs::path(file).parent_path() / name_of(n + 1)).string() : "";
}

struct FlightLog::State {
  explicit State(FlightLogOptions o) : options(std::move(o)) {}

  const FlightLogOptions options;
  std::mutex mutex;
  std::condition_variable change;
  std::string waiting;  // whole messages
  std::uint64_t waiting_messages = 0;
  rt::TimeNs t_full_ns = 0;  // since then there was no room for what came; 0: there is
  FlightLogReport report;
  std::uint64_t frames = 0;  // number of the newest one that was tracked; the caller's own
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
      if (t_full_ns == 0) t_full_ns = rt::monotonic_now_ns();
      return;
    }
    if (t_full_ns != 0) ulog::append_dropout(rt::monotonic_now_ns() - t_full_ns, &waiting);
    t_full_ns = 0;
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
      bytes.remove_prefix(n);
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
  if (::mkdir(options.folder.c_str(), 0750) == 0) keep_names(fs::path(options.folder).parent_path());
  make_room();
  if (!has_room(options.folder, options.room)) {
    fail("nearly full", now_ns);
    return false;
  }
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
  keep_names(options.folder);
  good_bytes = 0;
  std::string begin = flight_topics::definitions(options.info, options.parameters, now_ns);
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
    if (fd >= 0 && !has_room(options.folder, options.room)) fail("nearly full", now_ns);
  }
}

void FlightLog::State::look_at_machine(const hal::MachineMonitor& monitor, rt::TimeNs now_ns) {
  if (now_ns - t_machine_ns < rt::kNsPerSecond) return;
  t_machine_ns = now_ns;
  if (options.machine) {
    const hal::MachineState m = monitor.read();
    const ulog::Sample sample = flight_topics::machine(m, now_ns);
    put([&](std::string* out) { ulog::append_sample(flight_topics::kMachine, sample.bytes(), out); });
  }
  std::uint64_t written = 0, dropped = 0;
  std::uint32_t bytes = 0;
  {
    const std::lock_guard<std::mutex> lock(mutex);
    written = report.written_bytes;
    dropped = report.dropped;
    bytes = static_cast<std::uint32_t>(waiting.size());
  }
  const ulog::Sample sample = flight_topics::log(written, dropped, bytes, now_ns);
  put([&](std::string* out) { ulog::append_sample(flight_topics::kLog, sample.bytes(), out); });
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
  try {
    state_->waiting.reserve(state_->options.buffer_bytes + 65536);
    state_->has_thread = true;
    // With a share of the state: a disc that hangs keeps no end away.
    const bool started = start_detached("gw-flightlog", [state = state_] {
      try {
        state->run();
      } catch (const std::exception&) {
        // Out of memory: what comes from now on is counted as dropped.
        const std::lock_guard<std::mutex> lock(state->mutex);
        state->has_thread = false;
        state->ended = true;
        state->change.notify_all();
      }
    });
    if (!started) throw std::bad_alloc();
  } catch (const std::exception&) {
    state_->has_thread = false;
    state_->report.trouble = "no thread to be had for the flight log";
  }
}

FlightLog::~FlightLog() {
  finish(rt::kNsPerSecond);
}

void FlightLog::frame(const FrameRecord& r) noexcept {
  try {
    const auto put = [this](const ulog::Sample& sample, flight_topics::Topic topic) {
      state_->put([&](std::string* out) { ulog::append_sample(topic, sample.bytes(), out); });
    };
    put(flight_topics::frame(r), flight_topics::kFrame);
    if (r.has_pose) put(flight_topics::pose(r), flight_topics::kPose);
    if (r.mapping.messages > 0) put(flight_topics::mapper(r), flight_topics::kMapper);
    if (r.load.known) put(flight_topics::load(r), flight_topics::kLoad);
    if (r.order.number > 0) {
      state_->frames = r.order.number;
      put(flight_topics::order(r), flight_topics::kOrder);
    }
    if (r.fate != FrameFate::kProcessed) text(4, r.t_capture_ns, r.reason.view());
  } catch (const std::exception&) {
  }
}

void FlightLog::reading(const hal::ImuSample& s) noexcept {
  try {
    const ulog::Sample sample = flight_topics::imu(s);
    state_->put([&](std::string* out) { ulog::append_sample(flight_topics::kImu, sample.bytes(), out); });
  } catch (const std::exception&) {
  }
}

void FlightLog::bus(const link::LinkStatus& s) noexcept {
  try {
    const ulog::Sample sample = flight_topics::bus(s);
    state_->put([&](std::string* out) { ulog::append_sample(flight_topics::kBus, sample.bytes(), out); });
  } catch (const std::exception&) {
  }
}

void FlightLog::detection(const FoundBoxes& found) noexcept {
  try {
    // As one: all of its boxes or none.
    const ulog::Sample head = flight_topics::detection(found);
    state_->put([&](std::string* out) {
      ulog::append_sample(flight_topics::kDetection, head.bytes(), out);
      for (const detector::Box& b : found.boxes.view())
        ulog::append_sample(flight_topics::kBox, flight_topics::box(found.t_capture_ns, b).bytes(), out);
    });
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
    const ulog::Sample end = flight_topics::end(state_->frames, rt::monotonic_now_ns());
    state_->put([&](std::string* out) { ulog::append_sample(flight_topics::kEnd, end.bytes(), out); });
    std::unique_lock<std::mutex> lock(state_->mutex);
    state_->ending = true;
    state_->change.notify_all();
    if (state_->has_thread) {
      state_->change.wait_for(lock, std::chrono::nanoseconds(rt::patience_left_ns(patience_ns)),
                              [this] { return state_->ended; });
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
