#include "firmware_app/link/link_service.h"

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>
#include <utility>

#include "firmware_app/link/saved_parameters.h"
#include "hal/machine/machine_id.h"

namespace godwit::link {

mavlink::EndpointConfig asked_for(const LinkSettings& settings) {
  mavlink::EndpointConfig out = settings.link.mavlink;
  if (settings.collect_inputs) return out;
  // The attitude is read by the link itself.
  out.imu_hz = out.range_hz = out.local_position_hz = out.global_position_hz = 0;
  out.pressure_hz = out.satellites_hz = 0;
  return out;
}

rt::Result<std::unique_ptr<LinkService>> LinkService::open(const LinkSettings& settings) {
  std::unique_ptr<LinkService> self(new LinkService(settings));
  if (!settings.can.empty()) {
    auto bus = hal::open_can(settings.can, settings.wait_for_bus);
    if (!bus.ok()) return bus.error();
    self->bus_ = std::move(bus).value();
  }
  if (!settings.mavlink.empty()) {
    auto port = open_byte_port(settings.mavlink, settings.wait_for_bus);
    if (!port.ok()) return port.error();
    self->bytes_ = std::move(port).value();
  }
  auto loaded = self->storage_.load(settings.link.parameters);
  if (!loaded.ok()) return loaded.error();
  StoredState stored = std::move(loaded).value();
  drop_what_does_not_fit(settings.link.parameters,
                         {self->bus_ != nullptr, self->bytes_ != nullptr, !self->bus_ || self->bus_->supports_fd()},
                         &stored);
  self->advice_ = stored.warnings;
  for (std::string& line : overrides(settings.link.parameters, stored)) self->advice_.push_back(std::move(line));
  LinkConfig config = settings.link;
  config.clock = &rt::monotonic_now_ns;
  config.mavlink = asked_for(settings);
  if (config.identity.unique_id == dronecan::UniqueId{}) {
    const auto id = hal::machine_id();
    if (!id.ok()) return rt::Error{"link: no unique id for this node: " + id.error().message};
    config.identity.unique_id = id.value();
  }
  self->wake_fd_ = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
  if (self->wake_fd_ < 0) return rt::Error{"link: eventfd: " + std::string(std::strerror(errno))};
  auto node = LinkNode::create(config,
                               {self->bus_.get(), self->bytes_.get(), &self->storage_, &self->poses_, &self->health_,
                                settings.collect_inputs ? &self->inputs_ : nullptr, &self->status_, settings.departures,
                                settings.between_pictures ? &self->readings_ : nullptr},
                               stored);
  if (!node.ok()) return node.error();
  self->node_ = std::move(node).value();
  return self;
}

LinkService::~LinkService() {
  if (wake_fd_ >= 0) close(wake_fd_);
}

std::vector<std::string> LinkService::advice() const {
  std::vector<std::string> out = bus_ ? bus_->advice() : std::vector<std::string>();
  out.insert(out.end(), advice_.begin(), advice_.end());
  return out;
}

void LinkService::publish(const PoseSample& sample) {
  PoseSample stamped = sample;
  stamped.t_published_ns = rt::monotonic_now_ns();
  poses_.write(stamped);
  const std::uint64_t one = 1;
  // Refused only when the counter is full, and then the link thread is awake or about to be.
  static_cast<void>(write(wake_fd_, &one, sizeof one) == sizeof one);
}

void LinkService::wait(rt::TimeNs timeout_ns) {
  // poll passes over descriptors below zero: a bus that is gone or not there.
  std::array<pollfd, 3> events{pollfd{wake_fd_, POLLIN, 0}, pollfd{bus_ ? bus_->descriptor() : -1, POLLIN, 0},
                               pollfd{bytes_ ? bytes_->descriptor() : -1, POLLIN, 0}};
  const rt::TimeNs silence_ns = node_->t_silence_ns() - rt::monotonic_now_ns();
  if (silence_ns > 0) timeout_ns = std::min(timeout_ns, silence_ns);
  const timespec timeout{timeout_ns / rt::kNsPerSecond, timeout_ns % rt::kNsPerSecond};
  ppoll(events.data(), events.size(), &timeout, nullptr);
  std::uint64_t posts = 0;
  static_cast<void>(read(wake_fd_, &posts, sizeof posts) == sizeof posts);
}

}  // namespace godwit::link
