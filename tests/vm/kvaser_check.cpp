// SocketCanBus on the kernel's driver of Kvaser's PCI cards: runs as root where can0 and can1 are two of them on one
// wire (cases/kvaser). Prints what it checked; ends with 1 if anything failed.
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <string>
#include <sys/socket.h>
#include <unistd.h>

#include "hal/can/can_bus.h"
#include "hal/can/can_link.h"
#include "tests/vm/check.h"

namespace {
using namespace godwit;
using namespace godwit::hal;
using godwit::vm::check;
using godwit::vm::failures;
using godwit::vm::run;

std::unique_ptr<CanBus> open_bus(const std::string& name) {
  auto bus = open_can("socketcan:" + name);
  if (bus.ok()) return std::move(bus).value();
  check(false, bus.error().message);
  return nullptr;
}

template <typename Done>
bool soon(Done done) {
  for (int i = 0; i < 5000; ++i) {
    if (done()) return true;
    usleep(1000);
  }
  return false;
}

bool state_soon(CanBus& bus, CanState state) {
  CanFrame ignored;
  return soon([&] {
    bus.receive(&ignored);
    bus.maintain(rt::monotonic_now_ns());
    return bus.state() == state;
  });
}

CanFrame frame_of(std::uint32_t id) {
  CanFrame f;
  f.id = id;
  f.extended = true;
  f.length = 8;
  for (std::uint8_t i = 0; i < 8; ++i) f.data[i] = static_cast<std::uint8_t>(id + i);
  return f;
}

bool crosses(CanBus& from, CanBus& to, std::uint32_t id) {
  CanFrame got;
  if (from.send(frame_of(id)) != CanSend::kSent) return false;
  return soon([&] { return to.receive(&got) && got.id == id && got.extended && got.data == frame_of(id).data; });
}

/// An error frame as a driver sends it: everybody who listens on that card hears it.
void say_error(const char* card, canid_t what) {
  const int fd = socket(PF_CAN, SOCK_RAW, CAN_RAW);
  sockaddr_can to{};
  to.can_family = AF_CAN;
  to.can_ifindex = static_cast<int>(if_nametoindex(card));
  can_frame frame{};
  frame.can_id = CAN_ERR_FLAG | what;
  frame.can_dlc = CAN_ERR_DLC;
  check(sendto(fd, &frame, sizeof frame, 0, reinterpret_cast<const sockaddr*>(&to), sizeof to) == sizeof frame,
        "an error frame is sent");
  close(fd);
}

void describes() {
  const auto link = read_can_link("can0");
  check(link.ok() && link.value().kind == "can" && link.value().up && link.value().bit_rate == 1'000'000 &&
            link.value().restart_ms == 100 && !link.value().fd,
        "the driver tells bit rate, restart-ms and that it has no FD");
}

void frames(CanBus& a, CanBus& b) {
  check(crosses(a, b, 0x1401552A) && crosses(b, a, 0x18010203), "frames cross both ways");
  // A pose in a transfer of 40 frames, again and again: nothing is lost, whatever does not fit is told and sent later.
  std::uint32_t sent = 0, got = 0, full = 0;
  bool in_order = true;
  constexpr std::uint32_t kFrames = 2000;
  const auto hand_over = [&] {
    while (sent < kFrames) {
      const CanSend result = a.send(frame_of(0x100 + sent));
      if (result != CanSend::kSent) {
        full += result == CanSend::kFull ? 1 : 0;
        break;
      }
      if (++sent % 40 == 0) break;
    }
    CanFrame f;
    while (b.receive(&f)) in_order = in_order && f.id == 0x100 + got++;
    return got == kFrames;
  };
  // For as long as frames come: how fast they do is the machine's.
  std::uint32_t before = 0;
  bool all = false;
  do {
    before = got;
    all = soon(hand_over);
  } while (!all && got > before);
  check(all && in_order, std::to_string(got) + " of 2000 frames in bursts of 40 arrive in order, the queue was full " +
                             std::to_string(full) + " times");
  check(!a.supports_fd(), "FD is not offered");
}

void bus_off(CanBus& a, CanBus& b) {
  const std::uint64_t before = a.counters().bus_off;
  say_error("can0", CAN_ERR_BUSOFF);
  CanFrame ignored;
  const bool seen = soon([&] {
    a.receive(&ignored);
    return a.state() == CanState::kBusOff;
  });
  check(seen && a.counters().bus_off == before + 1, "bus-off is seen and counted");
  check(a.send(frame_of(1)) == CanSend::kDown, "and nothing is sent meanwhile");
  // The driver refuses a restart that is not due; asking does no harm, and the frame that tells of one is heeded.
  for (int i = 0; i < 50; ++i) {
    a.maintain(rt::monotonic_now_ns());
    usleep(10'000);
  }
  check(a.state() == CanState::kBusOff, "it stays off until the kernel says otherwise");
  say_error("can0", CAN_ERR_RESTARTED);
  check(state_soon(a, CanState::kActive) && crosses(a, b, 0x77), "restarted, frames cross again");
  say_error("can0", CAN_ERR_BUSOFF);
  check(soon([&] {
          a.receive(&ignored);
          return a.state() == CanState::kBusOff;
        }),
        "off once more");
  b.send(frame_of(0x78));
  check(state_soon(a, CanState::kActive), "a frame that comes says that it is on the bus again");
}

void down_and_pulled(CanBus& a, CanBus& b) {
  run("/bin/ip link set can0 down");
  check(state_soon(b, CanState::kActive) && soon([&] { return a.send(frame_of(2)) == CanSend::kDown; }) &&
            a.state() == CanState::kGone,
        "a card that is set down is gone");
  run("/bin/ip link set can0 up");
  check(state_soon(a, CanState::kActive) && crosses(a, b, 0x80) && crosses(b, a, 0x81), "and back when it is up");
  run("echo 1 > /sys/class/net/can0/device/remove");
  check(state_soon(a, CanState::kGone), "a card that is pulled is gone");
  usleep(300'000);
  check(a.state() == CanState::kGone && b.state() == CanState::kActive, "and stays so, the other does not care");
  run("echo 1 > /sys/bus/pci/rescan");
  check(soon([] { return if_nametoindex("can0") != 0; }), "put back it has its name");
  run("/bin/ip link set can0 type can bitrate 1000000 restart-ms 100 && /bin/ip link set can0 up");
  const rt::TimeNs up = rt::monotonic_now_ns();
  check(state_soon(a, CanState::kActive), "and is taken up again");
  std::printf("      %.2f s after it was up\n", rt::to_seconds(rt::monotonic_now_ns() - up));
  check(crosses(a, b, 0x90) && crosses(b, a, 0x91), "frames cross");
  check(a.counters().reopened == 2, "counters tell");
}

}  // namespace

int main() {
  describes();
  const auto a = open_bus("can0"), b = open_bus("can1");
  if (!a || !b) return 1;
  frames(*a, *b);
  bus_off(*a, *b);
  down_and_pulled(*a, *b);
  return failures == 0 ? 0 : 1;
}
