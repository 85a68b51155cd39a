#include "hal/aid/replay/aid_record.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>

#include "hal/record_file.h"

namespace godwit::hal {
namespace {

constexpr std::array<const char*, kAidKinds> kColumns = {"t,range_m,valid", "t,pressure_pa",
                                                         "t,fix,x,y,z,vx,vy,vz,sigma_m", "t,qw,qx,qy,qz"};

constexpr std::string_view kSpeedSigma = ",speed_sigma_m_s";

constexpr double kUnitTolerance = 1e-3;  // four digits will do

/// The next number of a line.
bool take_number(std::string_view* line, double* value) {
  const std::string_view field = take_field(line, ',');
  const char* const end = field.data() + field.size();
  const auto read = std::from_chars(field.data(), end, *value);
  return read.ec == std::errc() && read.ptr == end && std::isfinite(*value);
}

/// What is wrong with the rest of a line; empty: nothing. *holds: there is a reading in it. speed_sigma: satellites',
/// with that column.
std::string read_rest(AidKind kind, bool speed_sigma, std::string_view line, AidSample* s, bool* holds) {
  std::array<double, 9> v{};
  v[8] = kSatelliteVelocitySigma;
  constexpr std::array<std::size_t, kAidKinds> kNumbers = {2, 1, 8, 4};
  const std::size_t n = kNumbers[static_cast<std::size_t>(kind)] + (speed_sigma ? 1 : 0);
  for (std::size_t i = 0; i < n; ++i) {
    if (!take_number(&line, &v[i])) return "number " + std::to_string(i + 2) + " of the line is none";
  }
  switch (kind) {
    case AidKind::kRange:
      *holds = v[1] != 0;
      s->value[2] = v[0];
      s->sigma = kRangeSigmaM;
      if (*holds && !(v[0] > 0)) return "a distance is above 0 m";
      break;
    case AidKind::kBarometer:
      *holds = true;
      if (!(v[0] > kLeastPressurePa && v[0] < kMostPressurePa)) return "no air that flies has that pressure [Pa]";
      s->value[2] = pressure_height_m(v[0]);
      s->sigma = kPressureSigmaM;
      break;
    case AidKind::kSatellites:
      *holds = v[0] != 0;
      s->value = {v[1], v[2], v[3]};
      s->sigma = v[7];
      s->velocity = {v[4], v[5]};
      s->velocity_sigma = v[8];
      if (*holds && !(v[7] > 0)) return "a sigma is above 0 m";
      if (*holds && !(v[8] > 0)) return "a sigma is above 0 m/s";
      break;
    case AidKind::kAttitude:
      *holds = true;
      s->value = up_of_attitude({v[0], v[1], v[2], v[3]});
      s->sigma = kAttitudeSigmaRad;
      if (!(std::abs(std::hypot(std::hypot(v[0], v[1]), std::hypot(v[2], v[3])) - 1) < kUnitTolerance))
        return "a quaternion of an attitude has length 1";
      break;
  }
  return {};
}

}  // namespace

const char* aid_columns(AidKind kind) {
  return kColumns[static_cast<std::size_t>(kind)];
}

rt::Result<AidRecord> parse_aid(AidKind kind, std::string_view text, const std::string& name, std::string* cut_off) {
  AidRecord record;
  bool named = false, speed_sigma = false;
  const auto read = for_each_record(text, name, [&](std::string_view line, int /*number*/) -> std::string {
    if (!named) {
      named = true;
      const std::string_view wanted = aid_columns(kind);
      speed_sigma =
          kind == AidKind::kSatellites && line.substr(std::min(wanted.size(), line.size())).starts_with(kSpeedSigma);
      return line.substr(0, wanted.size()) == wanted ? std::string() : "the columns begin with " + std::string(wanted);
    }
    AidSample s;
    s.kind = kind;
    const std::string_view time = take_field(&line, ',');
    if (!parse_decimal_seconds(time, &s.t_ns)) return quoted(time) + " is not a time in decimal seconds";
    bool holds = false;
    std::string reason = read_rest(kind, speed_sigma, line, &s, &holds);
    if (!reason.empty()) return reason;
    if (holds && !record.empty() && s.t_ns <= record.back().t_ns) return "a time that is not above the one before";
    if (holds) record.push_back(s);
    return {};
  });
  if (!read) return read.error();
  if (cut_off != nullptr) *cut_off = read.value();
  return record;
}

rt::Result<AidRecord> read_aid_record(const std::string& folder, const std::vector<AidKind>& kinds,
                                      std::vector<std::string>* cut_off) {
  AidRecord all;
  for (const AidKind kind : kinds) {
    const std::string file = folder + "/" + aid_name(kind) + ".csv";
    const auto text = read_text_file(file);
    if (!text) return text.error();
    std::string words;
    auto record = parse_aid(kind, text.value(), file, &words);
    if (!record) return record.error();
    if (cut_off != nullptr && !words.empty()) cut_off->push_back(std::move(words));
    all.insert(all.end(), record.value().begin(), record.value().end());
  }
  std::stable_sort(all.begin(), all.end(), [](const AidSample& a, const AidSample& b) { return a.t_ns < b.t_ns; });
  return all;
}

rt::Result<std::vector<AidKind>> parse_aid_kinds(std::string_view list) {
  std::vector<AidKind> kinds;
  while (!list.empty()) {
    const std::string_view word = take_field(&list, ',');
    int i = 0;
    while (i < kAidKinds && word != aid_name(static_cast<AidKind>(i))) ++i;
    if (i == kAidKinds)
      return rt::Error{quoted(word) + ": one or more of range, baro, gnss, attitude, with commas between"};
    const AidKind kind = static_cast<AidKind>(i);
    if (std::find(kinds.begin(), kinds.end(), kind) != kinds.end())
      return rt::Error{quoted(word) + " stands there twice"};
    kinds.push_back(kind);
  }
  return kinds;
}

}  // namespace godwit::hal
