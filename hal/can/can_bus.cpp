#include "hal/can/can_bus.h"

#include <algorithm>

#include "hal/can/multicast_bus.h"
#include "hal/can/socketcan_bus.h"

namespace godwit::hal {
namespace {

struct Address {
  int multicast_bus = -1;  ///< -1: a SocketCAN interface
  std::string interface;   ///< multicast: IPv4 address of a network interface, or empty
};

rt::Result<Address> parse(const std::string& address) {
  const std::string multicast = "multicast:", socketcan = "socketcan:";
  if (address.starts_with(multicast)) {
    const std::string rest = address.substr(multicast.size());
    const bool digit = !rest.empty() && rest[0] >= '0' && rest[0] <= '9';
    if (!digit || (rest.size() > 1 && rest[1] != ':') || rest.size() == 2) {
      return rt::Error{"CAN bus \"" + address + "\": multicast takes a bus number 0 to 9, as in multicast:0"};
    }
    return Address{rest[0] - '0', rest.size() > 2 ? rest.substr(2) : std::string()};
  }
  if (address.starts_with(socketcan) && address.size() > socketcan.size()) {
    return Address{-1, address.substr(socketcan.size())};
  }
  return rt::Error{"CAN bus \"" + address + "\": expected multicast:N or socketcan:IFACE"};
}

template <typename Bus>
rt::Result<std::unique_ptr<CanBus>> upcast(rt::Result<std::unique_ptr<Bus>> bus) {
  if (!bus.ok()) return bus.error();
  return std::unique_ptr<CanBus>(std::move(bus).value());
}

}  // namespace

rt::Result<std::unique_ptr<CanBus>> open_can(const std::string& address, bool wait_for_it) {
  const auto parsed = parse(address);
  if (!parsed.ok()) return parsed.error();
  const Address& a = parsed.value();
  if (a.multicast_bus < 0) return upcast(SocketCanBus::open(a.interface, wait_for_it));
  return upcast(MulticastBus::open(a.multicast_bus, a.interface));
}

rt::Result<void> check_can_address(const std::string& address) {
  const auto parsed = parse(address);
  if (!parsed.ok()) return parsed.error();
  return {};
}

bool passes(std::span<const CanFilter> filters, const CanFrame& frame) {
  if (filters.empty()) return true;
  return std::any_of(filters.begin(), filters.end(), [&](const CanFilter& f) {
    return f.extended == frame.extended && (frame.id & f.mask) == (f.id & f.mask);
  });
}

}  // namespace godwit::hal
