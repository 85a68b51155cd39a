#include "firmware_app/commands/doctor_service.h"

#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <map>
#include <optional>
#include <set>
#include <sstream>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <vector>
#include <zlib.h>

namespace godwit::app {
namespace {
namespace fs = std::filesystem;

constexpr const char* kUnit = "godwitd.service";
constexpr int kCapSysResource = 24;  // linux/capability.h: it may raise limits
constexpr std::size_t kMostConfigBytes = 4U << 20;

std::string read_all(const fs::path& file) {
  std::ostringstream text;
  text << std::ifstream(file).rdbuf();
  return text.str();
}

std::string first_word(const fs::path& file) {
  std::string word;
  std::ifstream(file) >> word;
  return word;
}

/// The keys of [Service] that count here, of the unit and what an administrator laid beside it; lists go on, the rest
/// is as said last.
struct Unit {
  bool installed = false;
  std::string user = "root";
  std::vector<std::string> groups, device_classes;
  bool devices_closed = false;
  std::optional<std::string> memlock, rtprio;
};

void read_unit(const std::string& text, Unit* unit) {
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) {
    const std::size_t equals = line.find('=');
    if (equals == std::string::npos || line[0] == '#') continue;
    const std::string key = line.substr(0, equals), value = line.substr(equals + 1);
    std::istringstream words(value);
    if (key == "User") unit->user = value;
    if (key == "LimitMEMLOCK") unit->memlock = value;
    if (key == "LimitRTPRIO") unit->rtprio = value;
    if (key == "DevicePolicy") unit->devices_closed = value == "closed" || value == "strict";
    std::string word;
    if (key == "SupplementaryGroups") {
      while (words >> word) unit->groups.push_back(word);
    }
    if (key == "DeviceAllow" && words >> word) unit->device_classes.push_back(word);
  }
}

Unit find_unit(const fs::path& root) {
  Unit unit;
  std::error_code missing;
  for (const char* folder : {"etc", "usr/local/lib", "usr/lib", "lib"}) {
    const fs::path file = root / folder / "systemd/system" / kUnit;
    if (!fs::is_regular_file(file, missing)) continue;
    unit.installed = true;
    read_unit(read_all(file), &unit);
    break;
  }
  std::set<fs::path> beside;
  for (const auto& entry : fs::directory_iterator(root / "etc/systemd/system" / (std::string(kUnit) + ".d"), missing)) {
    if (entry.path().extension() == ".conf") beside.insert(entry.path());
  }
  for (const fs::path& file : beside) read_unit(read_all(file), &unit);
  return unit;
}

/// A hard limit out of /proc/PID/limits; nullopt: unlimited, or not told.
std::optional<long> hard_limit(const fs::path& limits, const std::string& name) {
  std::ifstream in(limits);
  for (std::string line; std::getline(in, line);) {
    if (!line.starts_with(name)) continue;
    std::istringstream words(line.substr(name.size()));
    std::string soft, hard;
    words >> soft >> hard;
    long value = 0;
    if (std::istringstream(hard) >> value) return value;
  }
  return std::nullopt;
}

bool may_raise_limits(const fs::path& status) {
  std::ifstream in(status);
  for (std::string word; in >> word;) {
    std::uint64_t capabilities = 0;
    if (word == "CapEff:" && in >> std::hex >> capabilities) return (capabilities >> kCapSysResource & 1) != 0;
  }
  return false;
}

int highest_priority(const Config::Threads& t) {
  return std::max(
      {t.camera.priority, t.imu.priority, t.tracker.priority, t.mapper.priority, t.detector.priority, t.link.priority});
}

/// What the unit asks for is what it gets, unless whoever starts it may not raise limits, and is limited itself.
void examine_limits(const fs::path& root, const Config& config, const Unit& unit, bool systemd, DoctorReport* report) {
  const fs::path starter = root / (systemd ? "proc/1" : "proc/self");
  const std::string who = systemd ? "systemd" : "whoever starts it here";
  const bool raises = systemd && may_raise_limits(starter / "status");
  if (!config.threads.lock_memory) {
    report->note("service: threads.lock_memory is off: memory may be paged out in flight");
  } else if (const auto limit = hard_limit(starter / "limits", "Max locked memory"); limit && !raises) {
    report->wrong(
        fmt::format("service: locked memory: {} may lock {} kB and raise no limit: the flight's memory will "
                    "not be locked; give it CAP_SYS_RESOURCE, or a higher limit",
                    who, *limit / 1024));
  } else if (systemd && unit.installed && unit.memlock != "infinity") {
    report->wrong("service: locked memory: the unit says LimitMEMLOCK=" + unit.memlock.value_or("(nothing)") +
                  ": \"infinity\" is needed");
  } else {
    report->fits("service: memory may be locked");
  }
  const int priority = highest_priority(config.threads);
  if (priority == 0) {
    report->note("service: no thread has a priority (threads.*.priority): any program may hold a frame up");
    return;
  }
  if (first_word(root / "proc/sys/kernel/sched_rt_runtime_us") == "0") {
    report->wrong(
        "service: priorities: the kernel gives real-time threads no time: sysctl kernel.sched_rt_runtime_us=950000");
  }
  long unit_limit = 0;
  if (const auto limit = hard_limit(starter / "limits", "Max realtime priority");
      limit && *limit < priority && !raises) {
    report->wrong(
        fmt::format("service: priorities: {} may give {} and raise no limit, {} is configured: threads will "
                    "run as any program; give it CAP_SYS_RESOURCE, or a higher limit",
                    who, *limit, priority));
  } else if (systemd && unit.installed && unit.rtprio != "infinity" &&
             (!(std::istringstream(unit.rtprio.value_or("0")) >> unit_limit) || unit_limit < priority)) {
    report->wrong(fmt::format("service: priorities: the unit says LimitRTPRIO={}, {} is configured",
                              unit.rtprio.value_or("(nothing)"), priority));
  } else {
    report->fits(fmt::format("service: priorities up to {} may be had", priority));
  }
}

/// Whether the kernel was built with CONFIG_RT_GROUP_SCHED, by its own word; nullopt: it gives none. gzread reads plain
/// files as well.
std::optional<bool> kernel_has_rt_groups(const fs::path& root) {
  for (const fs::path& file :
       {root / "proc/config.gz",
        root / "boot" / fmt::format("config-{}", first_word(root / "proc/sys/kernel/osrelease"))}) {
    gzFile in = gzopen(file.c_str(), "rb");
    if (in == nullptr) continue;
    std::string text(kMostConfigBytes, '\0');
    const int got = gzread(in, text.data(), static_cast<unsigned>(text.size()));
    gzclose(in);
    if (got <= 0) continue;
    text.resize(got);
    return text.find("\nCONFIG_RT_GROUP_SCHED=y") != std::string::npos;
  }
  return std::nullopt;
}

/// With RT_GROUP_SCHED a group without a share of real time gets no SCHED_FIFO, whatever its limits say.
void examine_rt_groups(const fs::path& root, const Config& config, DoctorReport* report) {
  if (highest_priority(config.threads) == 0) return;
  // No budget at all: the kernel asks no group for one.
  if (first_word(root / "proc/sys/kernel/sched_rt_runtime_us") == "-1") {
    report->fits("service: no group has a budget of real time (kernel.sched_rt_runtime_us = -1)");
    return;
  }
  std::error_code missing;
  for (const char* hierarchy : {"sys/fs/cgroup/cpu", "sys/fs/cgroup/cpu,cpuacct"}) {
    const fs::path all = root / hierarchy;
    if (!fs::exists(all / "cpu.rt_runtime_us", missing)) continue;
    // A service is in the deepest group that there is; where systemd made none, in the outermost, which has its share.
    for (const fs::path& group : {all / "system.slice" / kUnit, all / "system.slice"}) {
      if (!fs::exists(group / "cpu.rt_runtime_us", missing)) continue;
      if (first_word(group / "cpu.rt_runtime_us") != "0") break;
      report->wrong("service: priorities: this kernel has RT_GROUP_SCHED, and " + group.string() +
                    " has no share of real time: every priority will be refused; sysctl "
                    "kernel.sched_rt_runtime_us=-1 (docs/jetson.md)");
      return;
    }
    report->fits("service: RT_GROUP_SCHED is on, and leaves the service its real time");
    return;
  }
  const std::optional<bool> groups = kernel_has_rt_groups(root);
  if (!groups) {
    report->note("service: whether the kernel has RT_GROUP_SCHED is not told (no /proc/config.gz, no /boot/config-*)");
    return;
  }
  bool cpu_controller = false;
  std::istringstream controllers(read_all(root / "sys/fs/cgroup/cgroup.subtree_control"));
  for (std::string word; controllers >> word;) cpu_controller = cpu_controller || word == "cpu";
  if (*groups && cpu_controller) {
    report->wrong(
        "service: priorities: this kernel has RT_GROUP_SCHED, and systemd uses the cpu controller: every priority will "
        "be refused; sysctl kernel.sched_rt_runtime_us=-1 (docs/jetson.md)");
  } else {
    report->fits(std::string("service: RT_GROUP_SCHED is ") + (*groups ? "on, and systemd leaves it alone" : "off"));
  }
}

/// The ids that a user has, by the machine's own files.
struct Ids {
  bool known = false;
  unsigned uid = 0;
  std::set<unsigned> groups;
};

Ids ids_of(const fs::path& root, const Unit& unit) {
  Ids out;
  const auto fields = [](const std::string& line, char between) {
    std::vector<std::string> parts;
    std::istringstream in(line);
    for (std::string part; std::getline(in, part, between);) parts.push_back(part);
    return parts;
  };
  const auto contains = [](const std::vector<std::string>& names, const std::string& name) {
    return std::find(names.begin(), names.end(), name) != names.end();
  };
  std::ifstream users(root / "etc/passwd");
  for (std::string line; std::getline(users, line);) {
    const auto parts = fields(line, ':');
    unsigned group = 0;
    if (parts.size() < 4 || parts[0] != unit.user || !(std::istringstream(parts[2]) >> out.uid) ||
        !(std::istringstream(parts[3]) >> group))
      continue;
    out.known = true;
    out.groups.insert(group);
  }
  std::ifstream groups(root / "etc/group");
  for (std::string line; std::getline(groups, line);) {
    const auto parts = fields(line, ':');
    unsigned id = 0;
    if (parts.size() < 3 || !(std::istringstream(parts[2]) >> id)) continue;
    const bool member = parts.size() > 3 && contains(fields(parts[3], ','), unit.user);
    if (member || contains(unit.groups, parts[0])) out.groups.insert(id);
  }
  return out;
}

/// The class of a character device as DeviceAllow=char-CLASS names it; empty: unknown.
std::string class_of(const fs::path& root, unsigned number) {
  std::ifstream in(root / "proc/devices");
  for (std::string line; std::getline(in, line) && line != "Block devices:";) {
    unsigned id = 0;
    std::string name;
    std::istringstream words(line);
    if (words >> id >> name && id == number) return name;
  }
  return "";
}

void examine_device(const fs::path& root, const std::string& device, const Unit& unit, const Ids& ids,
                    DoctorReport* report) {
  struct stat about {};
  const std::string name = "service: " + device;
  if (stat((root.string() + device).c_str(), &about) != 0) {
    report->note(name + " is not there; the service will look for it");
    return;
  }
  if (S_ISCHR(about.st_mode) && unit.devices_closed) {
    const std::string kind = class_of(root, major(about.st_rdev));
    const auto& allowed = unit.device_classes;
    if (!kind.empty() && std::find(allowed.begin(), allowed.end(), fmt::format("char-{}", kind)) == allowed.end() &&
        std::find(allowed.begin(), allowed.end(), device) == allowed.end()) {
      report->wrong(fmt::format("{}: systemd will refuse it: DeviceAllow={} rw is missing (systemctl edit godwitd)",
                                name, device));
      return;
    }
  }
  constexpr unsigned kReadWrite = 06;
  const unsigned mode = about.st_mode & 0777U;
  const unsigned granted = about.st_uid == ids.uid             ? mode >> 6
                           : ids.groups.contains(about.st_gid) ? mode >> 3 & 7
                                                               : mode & 7;
  if (ids.uid != 0 && (granted & kReadWrite) != kReadWrite) {
    report->wrong(
        fmt::format("{}: the service's user {} may not read and write it (group {}, mode {:o}): "
                    "80-godwit.rules says who may; udevadm control --reload; udevadm trigger",
                    name, unit.user, about.st_gid, mode));
    return;
  }
  report->fits(name + " is open to the service");
}

std::vector<std::string> devices_of(const Config& config) {
  std::vector<std::string> out;
  if (config.camera.source == Config::Camera::Source::kV4l2) out.push_back(config.camera.device);
  if (config.imu.source == Config::Imu::Source::kMpu6000) out.push_back(config.imu.device);
  const std::string serial = "serial:";
  if (config.link.mavlink.starts_with(serial)) {
    out.push_back(config.link.mavlink.substr(serial.size(), config.link.mavlink.rfind(':') - serial.size()));
  }
  // The others are named by what they are, not by where they are.
  std::erase_if(out, [](const std::string& device) { return !device.starts_with("/"); });
  return out;
}

}  // namespace

void examine_service(const std::string& root, const Config& config, DoctorReport* report) {
  const fs::path base = root;
  const bool systemd = first_word(base / "proc/1/comm") == "systemd";
  if (!systemd) report->note("service: systemd does not run this machine: godwitd is what starts it makes of it");
  const Unit unit = find_unit(base);
  if (!unit.installed) report->note(std::string("service: ") + kUnit + " is not installed");
  examine_limits(base, config, unit, systemd, report);
  examine_rt_groups(base, config, report);
  if (!unit.installed) return;
  const Ids ids = ids_of(base, unit);
  if (!ids.known) {
    report->wrong("service: there is no user \"" + unit.user +
                  "\": systemd will not start it; systemd-sysusers PREFIX/lib/sysusers.d/godwit.conf");
    return;
  }
  for (const std::string& device : devices_of(config)) examine_device(base, device, unit, ids, report);
}

}  // namespace godwit::app
