#include <cstdlib>
#include <ctime>
#include <fstream>
#include <utility>

#include "hal/camera/device/machine_clocks.h"

namespace godwit::hal {
namespace {

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

class LinuxClocks final : public MachineClocks {
 public:
  explicit LinuxClocks(std::string sys) : sys_(std::move(sys)) {}

  rt::TimeNs now_ns() override { return rt::monotonic_now_ns(); }

  ClockOffsets clock_offsets() override {
    ClockOffsets out;
    read_clocks(&out);
    std::ifstream in(sys_ + "/devices/system/clocksource/clocksource0/offset_ns");
    std::string text;
    std::getline(in, text);
    char* end = nullptr;
    const long long counter = std::strtoll(text.c_str(), &end, 10);
    if (end != text.c_str()) out.counter_ns = counter;
    return out;
  }

  void read_clocks(ClockOffsets* offsets) override {
    offsets->boottime_ns = offset_of(CLOCK_BOOTTIME);
    offsets->realtime_ns = offset_of(CLOCK_REALTIME);
  }

 private:
  const std::string sys_;
};

}  // namespace

std::unique_ptr<MachineClocks> linux_clocks(const std::string& sys) {
  return std::make_unique<LinuxClocks>(sys);
}

}  // namespace godwit::hal
