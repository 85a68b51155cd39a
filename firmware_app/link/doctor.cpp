#include "firmware_app/link/doctor.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>

namespace godwit::link {
namespace {

constexpr int kExternalNav = 6;
constexpr int kBarometer = 1;
constexpr int kCompass = 1;
constexpr double kMostPositionNoise = 1;  // [m]; ArduPilot's default is 0.2
constexpr double kDelayToleranceMs = 5;
constexpr int kRcChannels = 16;
constexpr int kSourceSwitch = 90;  // RCx_OPTION: EKF source set
constexpr std::array<const char*, 5> kSourceParts{"POSXY", "VELXY", "POSZ", "VELZ", "YAW"};
constexpr rt::TimeNs kPatienceNs = 400 * rt::kNsPerMs;
constexpr int kTries = 5;

std::string plain(double value) {
  std::string text = std::to_string(value);
  text.erase(text.find_last_not_of('0') + 1);
  if (text.back() == '.') text.pop_back();
  return text;
}

class Examination {
 public:
  explicit Examination(const std::map<std::string, double>& parameters) : parameters_(parameters) {}

  std::optional<double> value(const std::string& name) const {
    const auto found = parameters_.find(name);
    return found == parameters_.end() ? std::nullopt : std::optional<double>(found->second);
  }
  void add(Severity severity, const std::string& name, double wanted, const std::string& why) {
    const std::string words =
        name + " is " + plain(*value(name)) + ": " + why + ". Set " + name + " " + plain(wanted) + ".";
    findings.push_back({severity, name, words, wanted});
  }
  /// An error unless the parameter has this value; a finding of its own where the autopilot did not tell.
  void must(const std::string& name, double wanted, const std::string& why, Severity severity = Severity::kError) {
    if (!value(name)) {
      unknown(name);
    } else if (std::abs(*value(name) - wanted) > 1e-4) {
      add(severity, name, wanted, why);
    }
  }
  void note(const std::string& name, const std::string& words) {
    findings.push_back({Severity::kNote, name, words, std::nullopt});
  }
  void unknown(const std::string& name) {
    findings.push_back({Severity::kUnknown, name,
                        "The autopilot did not tell " + name +
                            ": it may need a restart after what enables it, or an ArduPilot of 4.5 or later.",
                        std::nullopt});
  }
  std::vector<Finding> findings;

 private:
  const std::map<std::string, double>& parameters_;
};

void examine_can(Examination* e, const DoctorConfig& config) {
  e->must("CAN_P1_DRIVER", 1, "the first CAN port has no driver (restart the autopilot afterwards)");
  e->must("CAN_D1_PROTOCOL", 1, "the first CAN driver does not speak DroneCAN (restart the autopilot afterwards)");
  e->must("CAN_D1_UC_SER_EN", 1,
          "serial ports over DroneCAN are off, so no MAVLink comes through the tunnel (restart afterwards)");
  e->must("CAN_D1_UC_S1_NOD", config.node_id,
          "the tunnel listens to another node than ours (restart once more afterwards)");
  e->must("CAN_D1_UC_S1_IDX", config.serial_index,
          "the tunnel listens to another serial index than VIO_SER_IDX (restart once more afterwards)");
  e->must("CAN_D1_UC_S1_PRO", 2, "the tunnel does not speak MAVLink 2 (restart once more afterwards)");
  // The autopilot dates a message back by 10 bits a byte at this rate: 20 ms for a pose at 115200.
  if (const auto baud = e->value("CAN_D1_UC_S1_BD"); !baud) {
    e->unknown("CAN_D1_UC_S1_BD");
  } else if (*baud < 921 || (*baud > 2000 && *baud < 921600)) {
    e->add(Severity::kWarning, "CAN_D1_UC_S1_BD", 921,
           "the autopilot takes poses for older than they are by the time a serial line of this rate would need");
  }
}

void examine_visual_odometry(Examination* e, const DoctorConfig& config) {
  if (const auto type = e->value("VISO_TYPE"); !type) {
    e->unknown("VISO_TYPE");
  } else if (*type < 1 || *type > 3) {
    e->add(Severity::kError, "VISO_TYPE", 3, "visual odometry is off");
  } else if (*type < 3) {
    e->add(Severity::kWarning, "VISO_TYPE", 3,
           *type < 2 ? "a reset of ours makes the position jump, and arming does not compare attitudes"
                     : "a second of poses is dropped after each reset");
  }
  if (const auto quality = e->value("VISO_QUAL_MIN"); !quality) {
    if (config.submarine) {
      e->note("VISO_QUAL_MIN", "ArduSub 4.5 has no VISO_QUAL_MIN: poses that failed (quality -1) are fused there");
    } else {
      e->unknown("VISO_QUAL_MIN");
    }
  } else if (*quality < 0) {
    e->add(Severity::kError, "VISO_QUAL_MIN", 10, "poses that failed (quality -1) are fused");
  } else if (*quality < 1 || *quality > 50) {
    e->add(Severity::kWarning, "VISO_QUAL_MIN", 10,
           *quality < 1 ? "the poorest poses are fused with full weight"
                        : "good poses (quality 50 and below while coasting) are refused");
  }
  if (const auto delay = e->value("VISO_DELAY_MS"); !delay) {
    e->unknown("VISO_DELAY_MS");
  } else if (config.viso_delay_ms && std::abs(*delay - *config.viso_delay_ms) > kDelayToleranceMs) {
    e->add(Severity::kError, "VISO_DELAY_MS", *config.viso_delay_ms,
           "the latency that you gave is " + std::to_string(*config.viso_delay_ms) + " ms");
  }
  e->must("VISO_SCALE", 1, "positions are multiplied by it, and ours are metres");
  e->must("VISO_ORIENT", 0, "our poses are the body's already, and would be turned");
  if (const auto noise = e->value("VISO_POS_M_NSE"); noise && *noise > kMostPositionNoise) {
    e->add(Severity::kWarning, "VISO_POS_M_NSE", 0.2, "the least sigma of a position; a good pose is hardly believed");
  }
  // Our poses are those of the body's origin; with an offset set here the arm would be counted twice.
  if (config.t_body_cam.norm() > 1e-3) {
    for (const char* name : {"VISO_POS_X", "VISO_POS_Y", "VISO_POS_Z"}) {
      e->must(name, 0, "T_body_cam of godwit already holds the place of the camera");
    }
  }
}

void examine_sources(Examination* e) {
  e->must("AHRS_EKF_TYPE", 3, "EKF3, which alone takes external vision as a source, is not in use");
  e->must("EK3_ENABLE", 1, "EKF3 is off (restart the autopilot afterwards)");
  // 1 up to ArduPilot 4.6: all velocities are fused whatever the source set.
  e->must("EK3_SRC_OPTIONS", 0, "vision's velocity is fused while flying on GPS", Severity::kWarning);
  int sets = 0;
  bool told = false;
  for (const char set : {'1', '2', '3'}) {
    const std::string prefix = std::string("EK3_SRC") + set + "_";
    const auto position = e->value(prefix + "POSXY");
    if (!position) continue;
    told = true;
    if (*position != kExternalNav) continue;
    ++sets;
    e->must(prefix + "VELXY", kExternalNav, "this source set takes position from vision but velocity from elsewhere",
            Severity::kWarning);
    e->must(prefix + "VELZ", kExternalNav, "this source set takes position from vision but climb rate from elsewhere",
            Severity::kWarning);
    const auto height = e->value(prefix + "POSZ"), yaw = e->value(prefix + "YAW");
    if (!height) {
      e->unknown(prefix + "POSZ");
    } else if (*height != kExternalNav && *height != kBarometer) {
      e->add(Severity::kWarning, prefix + "POSZ", kExternalNav,
             "height comes neither from vision nor from the barometer");
    }
    if (!yaw) {
      e->unknown(prefix + "YAW");
    } else if (*yaw != kExternalNav && *yaw != kCompass) {
      e->add(Severity::kError, prefix + "YAW", kExternalNav, "heading comes neither from vision nor from the compass");
    }
  }
  if (!told) {
    e->unknown("EK3_SRC1_POSXY");
  } else if (sets == 0) {
    const std::string name = e->value("EK3_SRC2_POSXY") ? "EK3_SRC2_POSXY" : "EK3_SRC1_POSXY";
    e->add(Severity::kError, name, kExternalNav,
           "no source set takes its position from vision (6), so poses are received and never used; "
           "set VELXY, POSZ, VELZ and YAW of the same set as well");
  }
}

/// RCx_OPTION 90 selects set 1 low, 2 in the middle, 3 high. How many positions a switch has, no parameter tells.
void examine_switch(Examination* e) {
  bool same = true;
  for (const char* what : kSourceParts) {
    const auto second = e->value(std::string("EK3_SRC2_") + what), third = e->value(std::string("EK3_SRC3_") + what);
    same = same && second && third && *second == *third;
  }
  for (int channel = 1; channel <= kRcChannels && !same; ++channel) {
    const std::string name = "RC" + std::to_string(channel) + "_OPTION";
    const auto option = e->value(name);
    if (!option || *option != kSourceSwitch) continue;
    e->note(name, name +
                      " is 90, and source set 3 is not like set 2: a switch of two positions selects sets 1 and 3, "
                      "never 2. Take one of three positions, or fill EK3_SRC3_* like EK3_SRC2_*.");
  }
}

}  // namespace

const std::vector<std::string>& doctor_parameters() {
  static const std::vector<std::string> kNames = [] {
    std::vector<std::string> names{"CAN_P1_DRIVER",    "CAN_D1_PROTOCOL",  "CAN_D1_UC_SER_EN", "CAN_D1_UC_S1_NOD",
                                   "CAN_D1_UC_S1_IDX", "CAN_D1_UC_S1_PRO", "CAN_D1_UC_S1_BD",  "VISO_TYPE",
                                   "VISO_DELAY_MS",    "VISO_QUAL_MIN",    "VISO_POS_X",       "VISO_POS_Y",
                                   "VISO_POS_Z",       "VISO_SCALE",       "VISO_ORIENT",      "VISO_POS_M_NSE",
                                   "AHRS_EKF_TYPE",    "EK3_ENABLE",       "EK3_SRC_OPTIONS"};
    for (const char* set : {"1", "2", "3"}) {
      for (const char* what : kSourceParts) names.push_back(std::string("EK3_SRC") + set + "_" + what);
    }
    for (int channel = 1; channel <= kRcChannels; ++channel) {
      names.push_back("RC" + std::to_string(channel) + "_OPTION");
    }
    return names;
  }();
  return kNames;
}

std::vector<Finding> diagnose(const std::map<std::string, double>& parameters, const DoctorConfig& config) {
  Examination e(parameters);
  if (config.through_tunnel) examine_can(&e, config);
  examine_visual_odometry(&e, config);
  examine_sources(&e);
  examine_switch(&e);
  return std::move(e.findings);
}

bool ParameterReader::step(mavlink::Endpoint* endpoint, rt::TimeNs now_ns) {
  while (const auto answer = endpoint->take_parameter()) {
    const std::string name(answer->param_id.data(), strnlen(answer->param_id.data(), answer->param_id.size()));
    if (std::find(wanted_.begin(), wanted_.end(), name) == wanted_.end()) continue;
    values_[name] = static_cast<double>(answer->param_value);
  }
  while (next_ < wanted_.size()) {
    const bool answered = values_.count(wanted_[next_]) > 0;
    const bool waiting = tries_ > 0 && now_ns - t_asked_ns_ < kPatienceNs;
    if (!answered && waiting) return false;
    if (answered || tries_ >= kTries) {
      ++next_;
      tries_ = 0;
      continue;
    }
    endpoint->request_parameter(wanted_[next_], now_ns);
    t_asked_ns_ = now_ns;
    ++tries_;
    return false;
  }
  return true;
}

}  // namespace godwit::link
