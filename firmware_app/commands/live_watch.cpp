#include "firmware_app/commands/live_watch.h"

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <mutex>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>
#include <sys/socket.h>
#include <vector>

#include "firmware_app/commands/live_reader.h"
#include "firmware_app/output/base64.h"
#include "firmware_app/output/live_server.h"
#include "hal/rt/image.h"
#include "hal/rt/process_end.h"
#include "hal/rt/thread.h"
#include "hal/rt/time.h"

namespace godwit::app {
namespace {

using Json = nlohmann::json;

constexpr rt::TimeNs kLookingNs = 5 * rt::kNsPerSecond;
constexpr auto kRetry = std::chrono::milliseconds(500);
constexpr int kJpegQuality = 75;
constexpr const char* kNotOurs = "what is told there is not godwitd's";

std::string error_line(const std::string& words) {
  return Json{{"error", words}}.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace

std::string with_jpeg(const std::string& line) {
  try {
    Json j = Json::parse(line);
    Json& picture = j.at("picture");
    const int width = picture.at("width").get<int>(), height = picture.at("height").get<int>();
    if (width < 1 || height < 1 || width > rt::kMaxImageWidth || height > rt::kMaxImageHeight) return "";
    auto grey = from_base64(picture.at("grey").get_ref<const std::string&>());
    if (!grey || grey->size() != static_cast<std::size_t>(width) * static_cast<std::size_t>(height)) return "";
    std::vector<std::uint8_t> jpeg;
    const cv::Mat pixels(height, width, CV_8UC1, grey->data());
    if (!cv::imencode(".jpg", pixels, jpeg, {cv::IMWRITE_JPEG_QUALITY, kJpegQuality})) return "";
    std::string code;
    append_base64(jpeg, &code);
    picture.erase("grey");
    picture["jpeg"] = std::move(code);
    return j.dump(-1, ' ', false, Json::error_handler_t::replace);
  } catch (const std::exception&) {
    return "";
  }
}

struct LiveWatch::State {
  explicit State(std::string s) : socket(std::move(s)) { forget(socket + ": connecting"); }

  const std::string socket;
  std::atomic<bool> stop{false};  // relaxed: nothing is ordered by it
  std::mutex mutex;
  std::condition_variable change;
  std::string status, picture, track;
  rt::TimeNs t_looked_ns = 0;  // 0: nobody has
  rt::Thread thread;

  bool looking() {
    const std::lock_guard<std::mutex> lock(mutex);
    return is_looking();
  }
  /// Under the lock.
  bool is_looking() const { return t_looked_ns != 0 && rt::monotonic_now_ns() - t_looked_ns < kLookingNs; }
  void forget(const std::string& words) {
    const std::lock_guard<std::mutex> lock(mutex);
    status = picture = track = error_line(words);
  }
  std::string tell(const std::string& what) {
    const std::lock_guard<std::mutex> lock(mutex);
    t_looked_ns = rt::monotonic_now_ns();
    change.notify_all();
    return what;
  }
  void run();
  std::string read(int fd);
  std::string take(const std::string& line);
};

/// Words of an error: godwitd's own, or it is no line of godwitd's.
std::string LiveWatch::State::take(const std::string& line) {
  std::string* to = &status;
  std::string told = line;
  if (line.starts_with("{\"picture\":")) {
    told = with_jpeg(line);
    to = &picture;
  } else {
    const Json j = Json::parse(line, nullptr, false);
    if (!j.is_object()) return kNotOurs;
    if (j.contains("error") && j["error"].is_string()) return j["error"].get<std::string>();
    if (!j.contains("track") && !j.contains("state")) return kNotOurs;
    if (j.contains("track")) to = &track;
  }
  if (told.empty()) return kNotOurs;
  const std::lock_guard<std::mutex> lock(mutex);
  *to = std::move(told);
  return "";
}

/// Until it ends, or nobody looks any more. Why, in words.
std::string LiveWatch::State::read(int fd) {
  LiveReader reader(fd);
  const std::string ask = kAskView;
  if (::send(fd, ask.data(), ask.size(), MSG_NOSIGNAL) != static_cast<ssize_t>(ask.size())) return "godwitd has ended";
  while (looking()) {
    const auto line = reader.next(stop);
    if (!line) return line.error().message;
    if (line.value().empty()) break;
    if (const std::string error = take(line.value()); !error.empty()) return error;
  }
  return "connecting";
}

void LiveWatch::State::run() {
  while (!stop.load(std::memory_order_relaxed)) {
    {
      std::unique_lock<std::mutex> lock(mutex);
      change.wait(lock, [this] { return stop.load(std::memory_order_relaxed) || is_looking(); });
    }
    if (stop.load(std::memory_order_relaxed)) return;
    const auto fd = connect_live(socket);
    forget(fd.ok() ? socket + ": " + read(fd.value()) : fd.error().message);
    std::unique_lock<std::mutex> lock(mutex);
    change.wait_for(lock, kRetry, [this] { return stop.load(std::memory_order_relaxed); });
  }
}

LiveWatch::LiveWatch(std::string socket) : state_(std::make_unique<State>(std::move(socket))) {
  if (const auto r = state_->thread.start("gw-watch", {}, [this] { state_->run(); }); !r) {
    state_->forget(r.error().message);
  }
}

LiveWatch::~LiveWatch() {
  {
    const std::lock_guard<std::mutex> lock(state_->mutex);
    state_->stop.store(true, std::memory_order_relaxed);
    state_->change.notify_all();
  }
  rt::join_in_time(&state_->thread);
}

std::string LiveWatch::status() {
  return state_->tell(state_->status);
}

std::string LiveWatch::picture() {
  return state_->tell(state_->picture);
}

std::string LiveWatch::track() {
  return state_->tell(state_->track);
}

}  // namespace godwit::app
