#include "firmware_app/sim/flight_imu.h"

#include "hal/sim/sensors/sim_imu.h"

namespace godwit::app {

hal::ImuErrorModel imu_errors_of(const sim::Scenario& scenario) {
  const sim::ImuModel& m = scenario.imu;
  hal::ImuErrorModel out;
  out.gyroscope_noise_density = m.gyro_noise;
  out.gyroscope_random_walk = m.gyro_bias_walk;
  out.accelerometer_noise_density = m.accel_noise;
  out.accelerometer_random_walk = m.accel_bias_walk;
  out.accelerometer_bias_sigma = m.accel_bias;
  out.accelerometer_scale_sigma = 0;
  out.gyroscope_range = m.gyro_range_rad_s;
  out.accelerometer_range = m.accel_range_m_s2;
  return out;
}

hal::ImuRecord imu_record_of(const sim::Flight& flight) {
  hal::ImuRecord record;
  const auto imu = flight.imu(0);
  record.rate_hz = imu->rate_hz();
  record.errors = imu_errors_of(flight.scenario());
  hal::ImuSample sample;
  while (imu->next(&sample, 0) == hal::ImuStatus::kSample) record.samples.push_back(sample);
  return record;
}

}  // namespace godwit::app
