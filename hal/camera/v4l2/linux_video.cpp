#include <algorithm>
#include <cerrno>
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

/// Everything in a folder; one that is not there, or that goes while it is read, has no more. An iterator's ++ would
/// throw there.
template <typename Use>
void each_entry(const fs::path& folder, Use use) {
  std::error_code failed;
  for (fs::directory_iterator entry(folder, failed), end; !failed && entry != end; entry.increment(failed)) {
    use(entry->path());
  }
}

class LinuxVideo final : public VideoSystem {
 public:
  LinuxVideo(std::string sys, std::string dev)
      : clocks_(linux_clocks(sys)), sys_(std::move(sys)), dev_(std::move(dev)) {}

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
  rt::TimeNs now_ns() override { return clocks_->now_ns(); }
  ClockOffsets clock_offsets() override { return clocks_->clock_offsets(); }
  void read_clocks(ClockOffsets* offsets) override { clocks_->read_clocks(offsets); }

  std::vector<VideoNode> nodes() override {
    std::vector<VideoNode> out;
    each_entry(fs::path(sys_) / "class/video4linux", [&](const fs::path& entry) {
      const std::string name = entry.filename();
      if (name.compare(0, 5, "video") != 0) return;
      VideoNode node;
      node.path = fs::path(dev_) / name;
      // The device below is a USB interface; the serial number is its parent's.
      std::error_code none;
      const fs::path device = fs::canonical(entry / "device", none);
      if (!none) {
        node.serial = first_line(device / "serial");
        if (node.serial.empty()) node.serial = first_line(device.parent_path() / "serial");
      }
      for (const char* folder : {"v4l/by-id", "v4l/by-path"}) {
        each_entry(fs::path(dev_) / folder, [&](const fs::path& link) {
          if (fs::read_symlink(link, none).filename() == name) node.names.push_back(link.filename());
        });
      }
      out.push_back(std::move(node));
    });
    // video2 before video10.
    std::sort(out.begin(), out.end(), [](const VideoNode& a, const VideoNode& b) {
      return a.path.size() != b.path.size() ? a.path.size() < b.path.size() : a.path < b.path;
    });
    return out;
  }

 private:
  const std::unique_ptr<MachineClocks> clocks_;
  const std::string sys_, dev_;
};

}  // namespace

std::unique_ptr<VideoSystem> linux_video_system(const std::string& sys, const std::string& dev) {
  return std::make_unique<LinuxVideo>(sys, dev);
}

}  // namespace godwit::hal
