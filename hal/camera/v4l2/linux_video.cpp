#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <ctime>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <unistd.h>

#include "hal/camera/v4l2/video_system.h"

namespace godwit::hal {
namespace {

namespace fs = std::filesystem;

std::string first_line(const fs::path& file) {
  std::ifstream in(file);
  std::string line;
  std::getline(in, line);
  return line;
}

rt::TimeNs clock_ns(clockid_t id) {
  timespec t{};
  clock_gettime(id, &t);
  return static_cast<rt::TimeNs>(t.tv_sec) * rt::kNsPerSecond + t.tv_nsec;
}

/// What to add to a time of that clock: read between two looks at ours, the narrowest of a few.
rt::TimeNs offset_of(clockid_t id) {
  rt::TimeNs best = 0, width = rt::kNsPerSecond;
  for (int i = 0; i < 5; ++i) {
    const rt::TimeNs before = clock_ns(CLOCK_MONOTONIC), other = clock_ns(id), after = clock_ns(CLOCK_MONOTONIC);
    if (after - before >= width) continue;
    width = after - before;
    best = before + width / 2 - other;
  }
  return best;
}

class LinuxVideo final : public VideoSystem {
 public:
  LinuxVideo(std::string sys, std::string dev) : sys_(std::move(sys)), dev_(std::move(dev)) {}

  int open(const char* path) override { return ::open(path, O_RDWR | O_NONBLOCK | O_CLOEXEC); }
  void close(int descriptor) override { ::close(descriptor); }
  int ioctl(int descriptor, unsigned long request, void* argument) override {
    int result = -1;
    do {
      result = ::ioctl(descriptor, request, argument);
    } while (result == -1 && errno == EINTR);
    return result;
  }
  void* map(int descriptor, std::size_t bytes, std::int64_t offset) override {
    void* const memory = mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, descriptor, offset);
    return memory == MAP_FAILED ? nullptr : memory;
  }
  void unmap(void* memory, std::size_t bytes) override { munmap(memory, bytes); }

  Wait wait_readable(int descriptor, rt::TimeNs timeout_ns) override {
    pollfd p{descriptor, POLLIN, 0};
    const rt::TimeNs wait = std::max<rt::TimeNs>(timeout_ns, 0);
    const timespec t{static_cast<time_t>(wait / rt::kNsPerSecond), static_cast<long>(wait % rt::kNsPerSecond)};
    const int n = ppoll(&p, 1, &t, nullptr);
    if (n <= 0) return Wait::kTimeout;  // a signal: the caller asks again
    // A buffer that is there is taken first: a device that is leaving has sent it.
    if ((p.revents & POLLIN) != 0) return Wait::kReady;
    return Wait::kGone;
  }
  rt::TimeNs now_ns() override { return rt::monotonic_now_ns(); }

  ClockOffsets clock_offsets() override {
    ClockOffsets out;
    out.boottime_ns = offset_of(CLOCK_BOOTTIME);
    out.realtime_ns = offset_of(CLOCK_REALTIME);
    const std::string text = first_line(fs::path(sys_) / "devices/system/clocksource/clocksource0/offset_ns");
    char* end = nullptr;
    const long long counter = std::strtoll(text.c_str(), &end, 10);
    if (end != text.c_str()) out.counter_ns = counter;
    return out;
  }

  std::vector<VideoNode> nodes() override {
    std::vector<VideoNode> out;
    std::error_code ignored;
    for (const auto& entry : fs::directory_iterator(fs::path(sys_) / "class/video4linux", ignored)) {
      const std::string name = entry.path().filename();
      if (name.compare(0, 5, "video") != 0) continue;
      VideoNode node;
      node.path = fs::path(dev_) / name;
      // The device below is a USB interface; the serial number is its parent's.
      const fs::path device = fs::canonical(entry.path() / "device", ignored);
      node.serial = first_line(device / "serial");
      if (node.serial.empty()) node.serial = first_line(device.parent_path() / "serial");
      for (const char* folder : {"v4l/by-id", "v4l/by-path"}) {
        for (const auto& link : fs::directory_iterator(fs::path(dev_) / folder, ignored)) {
          if (fs::read_symlink(link.path(), ignored).filename() == name) node.names.push_back(link.path().filename());
        }
      }
      out.push_back(std::move(node));
    }
    // video2 before video10.
    std::sort(out.begin(), out.end(), [](const VideoNode& a, const VideoNode& b) {
      return a.path.size() != b.path.size() ? a.path.size() < b.path.size() : a.path < b.path;
    });
    return out;
  }

 private:
  const std::string sys_, dev_;
};

}  // namespace

std::unique_ptr<VideoSystem> linux_video_system(const std::string& sys, const std::string& dev) {
  return std::make_unique<LinuxVideo>(sys, dev);
}

}  // namespace godwit::hal
