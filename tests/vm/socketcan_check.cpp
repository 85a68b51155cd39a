// SocketCanBus on a real kernel: runs as root where vcan0 is an interface of its own (cases/socketcan makes one).
// Prints what it checked; the last line is "SOCKETCAN PASSED" or "SOCKETCAN FAILED".
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <unistd.h>

#include "firmware_app/link/link_service.h"
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
  if (!bus.ok()) {
    check(false, bus.error().message);
    return nullptr;
  }
  return std::move(bus).value();
}

bool receive_soon(CanBus& bus, CanFrame* frame) {
  for (int i = 0; i < 200; ++i) {
    if (bus.receive(frame)) return true;
    usleep(1000);
  }
  return false;
}

/// Within the two seconds that are promised, of a time that goes as it is maintained: a busy host does not count.
bool active_soon(CanBus& bus) {
  static rt::TimeNs now_ns = rt::monotonic_now_ns();
  const rt::TimeNs end_ns = (now_ns = std::max(now_ns, rt::monotonic_now_ns())) + 2 * rt::kNsPerSecond;
  for (; now_ns < end_ns && bus.state() != CanState::kActive; now_ns += 10 * rt::kNsPerMs) bus.maintain(now_ns);
  return bus.state() == CanState::kActive;
}

CanFrame frame_of(std::uint32_t id, std::size_t length, bool fd) {
  CanFrame f;
  f.id = id;
  f.fd = fd;
  f.length = static_cast<std::uint8_t>(length);
  for (std::size_t i = 0; i < length; ++i) f.data[i] = static_cast<std::uint8_t>(i + 1);
  return f;
}

void frames_and_filters() {
  const auto a = open_bus("vcan0"), b = open_bus("vcan0");
  if (!a || !b) return;
  CanFrame got;
  check(a->send(frame_of(0x1401552A, 8, false)) == CanSend::kSent && receive_soon(*b, &got) && got.id == 0x1401552A &&
            got.extended && !got.fd && got.length == 8 && got.data[7] == 8,
        "a classic frame crosses");
  check(!a->receive(&got), "and does not come back to its sender");
  check(b->supports_fd() && b->send(frame_of(0x123, 64, true)) == CanSend::kSent && receive_soon(*a, &got) && got.fd &&
            got.length == 64 && got.data[63] == 64,
        "an FD frame crosses");
  const CanFilter filter{0x00015500, 0x00FFFF80, true};
  check(b->set_filters({&filter, 1}).ok(), "the kernel takes filters");
  a->send(frame_of(0x14041A32, 8, false));
  a->send(frame_of(0x1401552A, 8, false));
  CanFrame eleven = frame_of(0x55, 8, false);
  eleven.extended = false;
  a->send(eleven);
  check(receive_soon(*b, &got) && got.id == 0x1401552A && !b->receive(&got), "and keeps back what does not pass");
  check(b->set_filters({}).ok() && a->send(eleven) == CanSend::kSent && receive_soon(*b, &got) && !got.extended &&
            got.id == 0x55,
        "without filters everything comes");
}

void advice() {
  run("/bin/ip link set vcan0 txqueuelen 10");
  const auto link = read_can_link("vcan0");
  check(link.ok() && link.value().kind == "vcan" && link.value().txqueuelen == 10 && link.value().up,
        "the link is described");
  const auto bus = open_bus("vcan0");
  bool told = false;
  if (bus) {
    for (const std::string& text : bus->advice())
      told = told || text.find("ip link set vcan0 txqueuelen 200") != std::string::npos;
  }
  check(told, "a short queue is told");
  run("/bin/ip link set vcan0 txqueuelen 200");
}

void down_and_gone() {
  const auto a = open_bus("vcan0"), b = open_bus("vcan0");
  if (!a || !b) return;
  CanFrame got;
  run("/bin/ip link set vcan0 down");
  check(a->send(frame_of(1, 8, false)) == CanSend::kDown && a->state() == CanState::kGone,
        "down is noticed when sending");
  for (int i = 0; i < 50 && b->state() != CanState::kGone; ++i) b->receive(&got);
  check(b->state() == CanState::kGone, "and when receiving");
  const auto late = open_bus("vcan0");
  bool told = false;
  if (late) {
    for (const std::string& text : late->advice()) told = told || text.find("is down") != std::string::npos;
  }
  check(late && told && late->state() == CanState::kGone, "a bus that is down can be opened and says so");
  run("/bin/ip link set vcan0 up");
  check(active_soon(*a) && active_soon(*b) && late && active_soon(*late), "all are back when it is up");
  check(a->send(frame_of(2, 8, false)) == CanSend::kSent && receive_soon(*b, &got) && got.id == 2,
        "and frames cross again");
  run("/bin/ip link del vcan0");
  check(a->send(frame_of(3, 8, false)) == CanSend::kDown, "a removed interface is noticed");
  for (int i = 0; i < 50; ++i) b->receive(&got);
  run("/bin/ip link add dev vcan0 type vcan && /bin/ip link set vcan0 mtu 72 && /bin/ip link set vcan0 up");
  check(active_soon(*a) && active_soon(*b) && a->send(frame_of(4, 8, false)) == CanSend::kSent &&
            receive_soon(*b, &got) && got.id == 4,
        "and a new one of its name is taken up");
  check(a->counters().reopened == 2, "counters tell");
}

void link_on_it() {
  link::LinkSettings settings;
  settings.can = "socketcan:vcan0";
  settings.link.identity.unique_id = {7};
  auto opened = link::LinkService::open(settings);
  const auto other = open_bus("vcan0");
  if (!check(opened.ok() && other, opened.ok() ? "bus" : opened.error().message)) return;
  link::LinkService& service = *opened.value();
  std::size_t frames = 0;
  CanFrame got;
  for (int i = 0; i < 1000; ++i) {
    if (i % 33 == 0) {
      link::PoseSample sample;
      sample.t_capture_ns = rt::monotonic_now_ns() - rt::kNsPerMs;
      sample.state = link::PoseState::kTracking;
      service.publish(sample);
    }
    service.wait(rt::kNsPerMs);
    service.step(rt::monotonic_now_ns());
    while (other->receive(&got)) ++frames;
    usleep(500);
  }
  const link::LinkStatus& s = service.node().status();
  check(s.odometry_sent >= 28, "the link sends poses: " + std::to_string(s.odometry_sent));
  check(frames == s.bus.sent && frames > 28 * 35, "every frame arrives: " + std::to_string(frames));
}
}  // namespace

int main() {
  frames_and_filters();
  advice();
  down_and_gone();
  link_on_it();
  std::printf(failures == 0 ? "SOCKETCAN PASSED\n" : "SOCKETCAN FAILED\n");
  return failures == 0 ? 0 : 1;
}
