#include "firmware_app/daemon/daemon_imu.h"

#include "firmware_app/flight/devices.h"
#include "firmware_app/sim/flight_imu.h"
#include "hal/imu/replay/replay_imu.h"

namespace godwit::app {

bool imu_goes_with_camera(const Config& config) {
  return config.imu.source == Config::Imu::Source::kReplay || config.imu.source == Config::Imu::Source::kSim;
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
  if (!record.value().cut_off.empty()) say("warning: imu.source: " + record.value().cut_off);
  return std::unique_ptr<hal::Imu>(std::make_unique<hal::ReplayImu>(std::move(record).value(), camera.time(), true));
}

}  // namespace godwit::app
