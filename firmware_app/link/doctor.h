// What `godwit doctor` knows of an autopilot's parameters: which do not fit, in words with the value to set. Pure
// logic; the command asks the autopilot and prints.
#pragma once

#include <Eigen/Core>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "firmware_app/link/mavlink_endpoint.h"
#include "hal/rt/time.h"

namespace godwit::link {

struct DoctorConfig {
  int node_id = 42;            ///< ours
  int serial_index = 0;        ///< VIO_SER_IDX
  bool through_tunnel = true;  ///< else over a serial line or network, and the bus' parameters do not matter
  Eigen::Vector3d t_body_cam = Eigen::Vector3d::Zero();
  std::optional<int> viso_delay_ms;  ///< as the user gave it; absent: not compared
  bool submarine = false;            ///< ArduSub, which has no VISO_QUAL_MIN up to 4.5
};

enum class Severity : std::uint8_t {
  kError,    ///< vision will not be used, or wrongly
  kWarning,  ///< it works, but not as it should
  kUnknown,  ///< the autopilot did not tell the value
  kNote      ///< to be known; it may be right as it is
};

struct Finding {
  Severity severity = Severity::kError;
  std::string parameter;
  std::string words;             ///< a sentence: what is set, what that means, what to set
  std::optional<double> wanted;  ///< the value to set
};

/// The parameters that diagnose() looks at.
const std::vector<std::string>& doctor_parameters();

/// Compares an ArduPilot's parameters with what it needs to fly on our poses. Empty: all fits. Allocates.
std::vector<Finding> diagnose(const std::map<std::string, double>& parameters, const DoctorConfig& config);

/// Reads parameters one after another over an endpoint, asking again what was not answered.
class ParameterReader {
 public:
  explicit ParameterReader(std::vector<std::string> names) : wanted_(std::move(names)) {}
  /// Call it after each step of the link. True when all were answered or given up (five tries, 400 ms apart).
  bool step(mavlink::Endpoint* endpoint, rt::TimeNs now_ns);
  const std::map<std::string, double>& values() const { return values_; }

 private:
  std::vector<std::string> wanted_;
  std::map<std::string, double> values_;
  std::size_t next_ = 0;
  int tries_ = 0;
  rt::TimeNs t_asked_ns_ = 0;
};

}  // namespace godwit::link
