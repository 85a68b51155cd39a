#include "firmware_app/sim/flight_imu.h"

#include "hal/sim/sensors/sim_imu.h"

namespace godwit::app {

hal::ImuRecord imu_record_of(const sim::Flight& flight) {
  hal::ImuRecord record;
  const auto imu = flight.imu(0);
  record.rate_hz = imu->rate_hz();
  hal::ImuSample sample;
  while (imu->next(&sample, 0) == hal::ImuStatus::kSample) record.samples.push_back(sample);
  return record;
}

}  // namespace godwit::app
