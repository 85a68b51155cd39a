#include "firmware_app/output/event_folder.h"

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <cstring>
#include <ctime>
#include <fcntl.h>
#include <filesystem>
#include <fmt/chrono.h>
#include <fmt/format.h>
#include <map>
#include <nlohmann/json.hpp>
#include <span>
#include <string_view>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "hal/camera/replay/png_encoder.h"

namespace godwit::app {
namespace {
namespace fs = std::filesystem;

constexpr std::size_t kNameDigits = 6;
constexpr std::string_view kPart = ".part";

rt::Error error_of(const std::string& what, const char* doing) {
  return {what + ": " + doing + ": " + std::strerror(errno)};
}

/// Number of an event's folder, or of one that was begun; 0: it is neither.
std::uint64_t number_of(std::string name, bool begun) {
  if (begun != name.ends_with(kPart)) return 0;
  if (begun) name.resize(name.size() - kPart.size());
  std::uint64_t n = 0;
  const auto [end, error] = std::from_chars(name.data(), name.data() + name.size(), n);
  if (error != std::errc() || end < name.data() + kNameDigits || end == name.data() + name.size() || *end != '-')
    return 0;
  const std::string_view kind(end + 1, name.data() + name.size());
  for (std::size_t k = 0; k < kEventKinds; ++k) {
    if (kind == event_kind_name(static_cast<EventKind>(k))) return n;
  }
  return 0;
}

void sync_folder(const std::string& folder) {
  const int fd = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return;
  ::fsync(fd);
  ::close(fd);
}

rt::Result<void> make_folder(const std::string& folder) {
  if (::mkdir(folder.c_str(), 0750) == 0) return {};
  return error_of(folder, "cannot be made");
}

/// A new file, on the disc.
rt::Result<void> put(const std::string& file, std::span<const std::uint8_t> bytes) {
  const int fd = ::open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0640);
  if (fd < 0) return error_of(file, "cannot be made");
  bool well = true;
  while (well && !bytes.empty()) {
    const ssize_t n = ::write(fd, bytes.data(), bytes.size());
    if (n > 0) bytes = bytes.subspan(n);
    well = n > 0 || (n < 0 && errno == EINTR);
  }
  well = well && ::fdatasync(fd) == 0;
  const rt::Error why = error_of(file, "cannot be written");
  ::close(fd);
  if (!well) return why;
  return {};
}

rt::Result<void> put(const std::string& file, const std::string& text) {
  return put(file, std::span(reinterpret_cast<const std::uint8_t*>(text.data()), text.size()));
}

std::string readings(const std::vector<hal::ImuSample>& samples) {
  std::string out =
      "#timestamp [ns],w_x [rad s^-1],w_y [rad s^-1],w_z [rad s^-1],a_x [m s^-2],a_y [m s^-2],a_z [m s^-2]\n";
  for (const hal::ImuSample& s : samples) {
    fmt::format_to(std::back_inserter(out), "{}", s.t_ns);
    // So that they read back to the same bits.
    for (const double v : s.gyro_rad_s) fmt::format_to(std::back_inserter(out), ",{}", v);
    for (const double v : s.accel_m_s2) fmt::format_to(std::back_inserter(out), ",{}", v);
    out += "\n";
  }
  return out;
}

std::uintmax_t bytes_in(const fs::path& folder) {
  std::error_code error;
  std::uintmax_t sum = 0;
  for (fs::recursive_directory_iterator i(folder, error), end; !error && i != end; i.increment(error)) {
    std::error_code unknown;
    if (!i->is_regular_file(unknown)) continue;
    const std::uintmax_t bytes = i->file_size(unknown);
    if (!unknown) sum += bytes;
  }
  return sum;
}

}  // namespace

EventFolders::~EventFolders() {
  if (fd_ >= 0) ::close(fd_);
}

rt::Result<void> EventFolders::open() {
  if (fd_ >= 0) return {};
  ::mkdir(options_.folder.c_str(), 0750);
  const int fd = ::open(options_.folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return error_of(options_.folder, "cannot be made");
  if (::flock(fd, LOCK_EX | LOCK_NB) != 0) {
    ::close(fd);
    return rt::Error{options_.folder + ": another program writes its events there"};
  }
  fd_ = fd;
  // What a program that was killed had begun.
  std::error_code error;
  std::vector<fs::path> begun;
  for (fs::directory_iterator i(options_.folder, error), end; !error && i != end; i.increment(error)) {
    if (number_of(i->path().filename().string(), true) != 0) begun.push_back(i->path());
  }
  for (const fs::path& folder : begun) fs::remove_all(folder, error);
  return {};
}

std::uint64_t EventFolders::next_number() const {
  std::error_code error;
  std::uint64_t last = 0;
  for (fs::directory_iterator i(options_.folder, error), end; !error && i != end; i.increment(error)) {
    last = std::max(last, number_of(i->path().filename().string(), false));
  }
  return last + 1;
}

rt::Result<void> EventFolders::make_room(std::uint64_t bytes) {
  if (bytes > options_.budget_bytes) {
    return rt::Error{fmt::format("{}: an event may take {} MB, and all of them are allowed {} MB", options_.folder,
                                 bytes / 1'000'000, options_.budget_bytes / 1'000'000)};
  }
  std::error_code error;
  std::map<std::uint64_t, std::pair<fs::path, std::uintmax_t>> events;
  std::uintmax_t sum = bytes;
  for (fs::directory_iterator i(options_.folder, error), end; !error && i != end; i.increment(error)) {
    const std::uint64_t n = number_of(i->path().filename().string(), false);
    std::error_code unknown;
    if (n == 0 || !fs::is_directory(i->symlink_status(unknown))) continue;
    const std::uintmax_t here = bytes_in(i->path());
    events[n] = {i->path(), here};
    sum += here;
  }
  for (const auto& [n, event] : events) {
    if (sum <= options_.budget_bytes) break;
    fs::remove_all(event.first, error);
    if (!error) sum -= event.second;
  }
  // All of it at once: half an event would be in the way of the flight log meanwhile.
  if (!has_room(options_.folder, options_.room, bytes)) return error_of(options_.folder, "nearly full");
  return {};
}

rt::Result<void> EventFolders::fill(const std::string& part, const Event& event, const Picture& picture,
                                    const Done& done) {
  const std::string cam = part + "/mav0/cam0", imu = part + "/mav0/imu0", data = cam + "/data/";
  for (const std::string& folder : {part, part + "/mav0", cam, data}) {
    if (auto r = make_folder(folder); !r) return r;
  }
  std::string list = "#timestamp [ns],filename\n";
  rt::FrameMeta first, last;
  for (std::uint64_t n = event.first; n < event.end; ++n) {
    const auto [meta, pixels] = picture(n);
    if (n == event.first) first = meta;
    last = meta;
    if (!has_room(options_.folder, options_.room)) return error_of(options_.folder, "nearly full");
    if (const std::string why = hal::encode_png(pixels, &packed_); !why.empty()) return rt::Error{why};
    const std::string name = fmt::format("{}.png", meta.t_capture_ns);
    if (auto r = put(data + name, packed_); !r) return r;
    fmt::format_to(std::back_inserter(list), "{},{}\n", meta.t_capture_ns, name);
    if (!done(n)) return rt::Error{part + ": given up, the program ends"};
  }
  if (auto r = put(cam + "/sensor.yaml", options_.calibration); !r) return r;
  if (auto r = put(cam + "/data.csv", list); !r) return r;
  if (!event.samples->empty()) {
    if (auto r = make_folder(imu); !r) return r;
    if (auto r = put(imu + "/data.csv", readings(*event.samples)); !r) return r;
  }

  using Json = nlohmann::ordered_json;
  const std::uint64_t pictures = event.end - event.first;
  Json causes = Json::array();
  for (const EventCause& c : event.causes) {
    causes.push_back({{"kind", event_kind_name(c.kind)}, {"t_ns", c.t_ns}, {"reason", c.reason}});
  }
  Json about{{"kind", event_kind_name(event.causes.front().kind)},
             {"t_ns", event.causes.front().t_ns},
             {"reason", event.causes.front().reason},
             {"causes", causes},
             {"written", fmt::format("{:%Y-%m-%dT%H:%M:%SZ}", fmt::gmtime(std::time(nullptr)))},
             {"pictures", pictures},
             {"pictures_missing", last.sequence - first.sequence + 1 - pictures},
             {"t_first_ns", first.t_capture_ns},
             {"t_last_ns", last.t_capture_ns},
             {"t_source_first_ns", first.t_source_ns},
             {"samples", event.samples->size()}};
  for (const auto& [key, value] : options_.info) {
    if (key != "configuration") {
      about[key] = value;
    } else if (auto r = put(part + "/configuration.toml", value); !r) {
      return r;
    }
  }
  if (auto r = put(part + "/event.json", about.dump(2, ' ', false, Json::error_handler_t::replace) + "\n"); !r)
    return r;
  for (const std::string& folder : {data, cam, imu, part + "/mav0", part}) sync_folder(folder);
  return {};
}

rt::Result<std::string> EventFolders::write(const Event& event, const Picture& picture, const Done& done) {
  if (auto r = open(); !r) return r.error();
  if (event.first >= event.end) return rt::Error{"there was no picture"};
  // Before room is made: a number is never given twice.
  const std::string name =
      fmt::format("{}/{:06}-{}", options_.folder, next_number(), event_kind_name(event.causes.front().kind));
  if (auto r = make_room(event.most_bytes); !r) return r.error();
  const std::string part = name + std::string(kPart);
  auto filled = fill(part, event, picture, done);
  if (filled.ok() && ::rename(part.c_str(), name.c_str()) != 0) filled = error_of(name, "cannot be named");
  if (!filled) {
    std::error_code ignored;
    fs::remove_all(part, ignored);
    return filled.error();
  }
  ::fsync(fd_);
  return name;
}

}  // namespace godwit::app
