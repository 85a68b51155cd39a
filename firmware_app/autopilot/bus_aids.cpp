#include "firmware_app/autopilot/bus_aids.h"

#include <algorithm>
#include <cmath>

namespace godwit::app {
namespace {

constexpr double kEarthRadiusM =
    6371000;  // a local frame of some kilometres: half a percent would be no matter, this is 0.3
constexpr double kRadian = M_PI / 180;
/// A rangefinder's error grows with its distance: a lidar's data sheet.
constexpr double kRangeShare = 0.01;
/// A quaternion in single precision is one to this.
constexpr double kUnitTolerance = 1e-3;
/// Near the sea, where a height's pressure changes fastest [Pa/m].
constexpr double kPressureSlope = 12;

std::size_t index(hal::AidKind kind) {
  return static_cast<std::size_t>(kind);
}

}  // namespace

std::optional<hal::AidKind> BusAids::kind_of(const link::AutopilotInput& input) {
  switch (input.kind) {
    case link::InputKind::kRange:
      return hal::AidKind::kRange;
    case link::InputKind::kPressure:
      return hal::AidKind::kBarometer;
    case link::InputKind::kSatellites:
      return hal::AidKind::kSatellites;
    case link::InputKind::kAttitude:
      return hal::AidKind::kAttitude;
    default:
      // Local and global position are what the autopilot's own filter says: it may have been told by us.
      return std::nullopt;
  }
}

bool BusAids::next_until(rt::TimeNs t_ns, hal::AidSample* sample) {
  link::AutopilotInput input;
  for (std::size_t i = 0; !held_ && i < link::InputRing::capacity(); ++i) {
    if (!link::take_input(inputs_, &input)) return false;
    const auto kind = kind_of(input);
    held_ = kind && options_.used[index(*kind)] && take(input, *kind, &held_sample_);
  }
  if (!held_ || held_sample_.t_ns > t_ns) return false;
  *sample = held_sample_;
  held_ = false;
  return true;
}

bool BusAids::take(const link::AutopilotInput& input, hal::AidKind kind, hal::AidSample* sample) {
  Told& told = told_[index(kind)];
  Chosen& chosen = chosen_[index(kind)];
  const auto relaxed = std::memory_order_relaxed;
  told.t_heard_ns.store(input.t_arrival_ns, relaxed);
  sample->kind = kind;
  Refusal no = choose(input, &chosen);
  if (no.why == nullptr) no = time_of(input, chosen, &sample->t_ns);
  if (no.why == nullptr) no = measured(input, kind, sample);
  if (no.why != nullptr) {
    told.value.store(no.value, relaxed);
    told.why.store(no.why, relaxed);
    told.refused.fetch_add(1, relaxed);
    return false;
  }
  chosen = {true, input.from_autopilot, input.source, input.sensor, input.t_arrival_ns, sample->t_ns};
  told.from_autopilot.store(input.from_autopilot, relaxed);
  told.source.store(input.source, relaxed);
  told.t_used_ns.store(input.t_arrival_ns, relaxed);
  told.used.fetch_add(1, relaxed);
  return true;
}

// Two of a kind would be two opinions of one thing, with other delays and offsets: what one says of a climb the other
// would seem to contradict. An autopilot also forwards what a node has said already.
BusAids::Refusal BusAids::choose(const link::AutopilotInput& input, Chosen* chosen) const {
  const bool same = chosen->from_autopilot == input.from_autopilot && chosen->source == input.source &&
                    chosen->sensor == input.sensor;
  if (!chosen->any || same) return {};
  if (input.t_arrival_ns - chosen->t_heard_ns > options_.silent_ns) return {};
  return {"another source of the same is used", static_cast<double>(input.source)};
}

BusAids::Refusal BusAids::time_of(const link::AutopilotInput& input, const Chosen& chosen, rt::TimeNs* t_ns) const {
  *t_ns = input.t_arrival_ns - options_.delay_ns;
  if (input.t_measured_ns != 0) {
    const rt::TimeNs age = input.t_arrival_ns - input.t_measured_ns;
    if (age > options_.stale_ns) return {"old on arrival [ms]", rt::to_ms(age)};
    if (-age > options_.ahead_ns) return {"measured in the future [ms]", rt::to_ms(-age)};
    *t_ns = std::min(input.t_measured_ns, input.t_arrival_ns);
  }
  // The same measurement once more, or one that overtook it. From another source it counts anew.
  const bool same = chosen.from_autopilot == input.from_autopilot && chosen.source == input.source;
  if (chosen.any && same && *t_ns <= chosen.t_measured_ns) return {"no newer than the one before", 0};
  return {};
}

BusAids::Refusal BusAids::measured(const link::AutopilotInput& input, hal::AidKind kind, hal::AidSample* s) {
  s->value = {};
  s->velocity = {};
  s->velocity_sigma = 0;
  if (kind == hal::AidKind::kSatellites) return place(input, s);
  if (kind == hal::AidKind::kAttitude) {
    const double length =
        std::hypot(std::hypot(input.value[0], input.value[1]), std::hypot(input.value[2], input.value[3]));
    if (!(std::abs(length - 1) < kUnitTolerance)) return {"no attitude: its quaternion has the length", length};
    s->value = hal::up_of_attitude({input.value[0], input.value[1], input.value[2], input.value[3]});
    s->sigma = hal::kAttitudeSigmaRad;
    return {};
  }
  const double value = input.value[0];
  if (kind == hal::AidKind::kBarometer) {
    if (!(value > hal::kLeastPressurePa && value < hal::kMostPressurePa))
      return {"no air that flies has that pressure [Pa]", value};
    s->value[2] = hal::pressure_height_m(value);
    s->sigma = std::max(hal::kPressureSigmaM, std::sqrt(std::max(0.0, input.value[1])) / kPressureSlope);
    return {};
  }
  const double looks = input.value[1];
  const bool named = !input.from_autopilot && options_.range_sensor == input.sensor;
  if (looks == link::kLooksUnknown && !named) {
    return {"a range sensor that does not say where it looks (aids.range_sensor): id",
            static_cast<double>(input.sensor)};
  }
  if (looks != link::kLooksUnknown && looks != link::kLooksDown)
    return {"a range sensor that looks elsewhere than down: id", static_cast<double>(input.sensor)};
  if (!(value > 0)) return {"no distance [m]", value};
  s->value[2] = value;
  s->sigma = std::max(hal::kRangeSigmaM, kRangeShare * value);
  return {};
}

BusAids::Refusal BusAids::place(const link::AutopilotInput& input, hal::AidSample* s) {
  const auto& v = input.value;
  if (!(v[3] >= link::kFix3d && v[3] <= link::kFixBest)) return {"no fix in three dimensions: its type", v[3]};
  if (!(v[4] > 0 && v[5] > 0)) return {"a fix that does not say how sure it is", 0};
  s->sigma = std::max(v[4], v[5]);
  if (!(s->sigma <= options_.most_sigma_m)) return {"a fix that is too unsure: sigma [m]", s->sigma};
  if (!have_origin_) {
    have_origin_ = true;
    latitude0_ = v[0], longitude0_ = v[1], height0_ = v[2];
  }
  // East, north, up, flat about the first fix. Across the date line the long way round is never meant.
  const double east =
      std::remainder(v[1] - longitude0_, 360.0) * kRadian * kEarthRadiusM * std::cos(latitude0_ * kRadian);
  const double north = (v[0] - latitude0_) * kRadian * kEarthRadiusM;
  s->value = {east, north, v[2] - height0_};
  s->velocity = {v[6], v[7]};
  s->velocity_sigma = v[8];
  return {};
}

AidHeard BusAids::heard(hal::AidKind kind) const {
  const Told& t = told_[index(kind)];
  const auto relaxed = std::memory_order_relaxed;
  AidHeard out;
  out.used = t.used.load(relaxed);
  out.refused = t.refused.load(relaxed);
  out.why = t.why.load(relaxed);
  out.value = t.value.load(relaxed);
  out.from_autopilot = t.from_autopilot.load(relaxed);
  out.source = t.source.load(relaxed);
  out.t_used_ns = t.t_used_ns.load(relaxed);
  out.t_heard_ns = t.t_heard_ns.load(relaxed);
  return out;
}

BusAidsOptions bus_aids_options(const Config& config) {
  BusAidsOptions out;
  // Where a sensor of our own tells the vertical nobody else is asked.
  out.used = {config.aids.range, config.aids.barometer, config.aids.satellites,
              config.aids.attitude && !config.imu.flown_by()};
  out.range_sensor = config.aids.range_sensor;
  out.delay_ns = static_cast<rt::TimeNs>(config.aids.delay_ms * 1e6);
  return out;
}

void ask_for_aids(const Config& config, link::LinkSettings* settings) {
  settings->collect_inputs = true;
  link::mavlink::EndpointConfig& asked = settings->link.mavlink;
  asked.imu_hz = asked.local_position_hz = asked.global_position_hz = 0;
  asked.range_hz = config.aids.range ? 10 : 0;
  asked.pressure_hz = config.aids.barometer ? 10 : 0;
  asked.satellites_hz = config.aids.satellites ? 5 : 0;
}

}  // namespace godwit::app
