#include "firmware_app/daemon/daemon_imu.h"

#include "firmware_app/flight/devices.h"
#include "firmware_app/sim/flight_imu.h"
#include "hal/imu/replay/replay_imu.h"

namespace godwit::app {

bool imu_goes_with_camera(const Config& config) {
  return config.imu.source == Config::Imu::Source::kReplay || config.imu.source == Config::Imu::Source::kSim;
}

rt::Result<hal::ImuErrorModel> daemon_imu_errors(const Config& config, const DaemonCamera& camera) {
  if (!imu_goes_with_camera(config)) return hal::ImuErrorModel{};
  if (camera.flight() != nullptr) return imu_errors_of(camera.flight()->scenario());
  auto errors = hal::read_imu_record_errors(config.camera.sequence);
  if (!errors) return rt::Error{"imu.source: " + errors.error().message};
  return errors;
}

rt::Result<std::unique_ptr<hal::Imu>> open_daemon_imu(const Config& config, const DaemonCamera& camera,
                                                      const std::function<void(const std::string&)>& say) {
  if (!imu_goes_with_camera(config)) return open_imu(config.imu, say);
  if (camera.flight() != nullptr) {
    return std::unique_ptr<hal::Imu>(
        std::make_unique<hal::ReplayImu>(imu_record_of(*camera.flight()), camera.time(), true));
  }
  auto record = hal::read_imu_record(config.camera.sequence);
  if (!record) return rt::Error{"imu.source: " + record.error().message};
  for (const std::string& words : record.value().warnings(config.camera.sequence)) say("warning: imu.source: " + words);
  return std::unique_ptr<hal::Imu>(std::make_unique<hal::ReplayImu>(std::move(record).value(), camera.time(), true));
}

}  // namespace godwit::app
