// A flight to be simulated, read from a TOML file: world, aircraft, camera, sensors, faults.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "hal/rt/result.h"
#include "hal/sim/render/renderer.h"
#include "hal/sim/sensors/sensor.h"
#include "hal/sim/sensors/sim_imu.h"

namespace godwit::sim {

/// The camera as the scenario describes it.
struct CameraPlan {
  CameraRig rig;
  double fps = 30;
  double pitch_down_deg = 40;  ///< optical axis below the nose
  double time_offset_ms = 0;   ///< capture times are told late by this, as a badly synchronised camera does
};

/// Pictures that do not arrive. Which ones: by seed.
struct CameraFaults {
  double drop_share = 0;   ///< of single pictures
  double gap_every_s = 0;  ///< 0: no gaps; else a gap begins this often
  double gap_s = 0;        ///< and lasts this long
};

/// A wrong reading that comes and goes.
struct RangeJump {
  double t_s = 0, duration_s = 0, offset_m = 0;
};

struct RangePlan {
  bool present = true;
  double rate_hz = 20, noise_m = 0.03, min_m = 0.2, max_m = 40;
  double dropout_share = 0;
  std::vector<RangeJump> jumps;
};

struct GnssPlan {
  bool present = true;
  double rate_hz = 5, sigma_m = 0.6;
  double lost_after_s = 1e9;  ///< fixes until then, none afterwards
};

/// A static-pressure sensor. Defaults: MS5611 (TE, data sheet of 2017: 0.012 mbar at the highest oversampling); weather
/// and self-heating wander by some 20 Pa within minutes; a hole that is not quite static sees a tenth of the dynamic
/// pressure.
struct BaroPlan {
  bool present = true;
  double rate_hz = 25, noise_pa = 1.2;
  double wander_pa = 20, wander_s = 300;  ///< one sigma, and how fast it is forgotten
  double dynamic_share = 0.1;             ///< of the dynamic pressure, taken off
  double delay_ms = 0;                    ///< first-order lag of tube and filter
};

/// What the autopilot says of its attitude. It leans with what it takes for gravity: a degree, for as long as a turn
/// lasts.
struct AttitudePlan {
  double rate_hz = 10;
  double wander_deg = 1, wander_s = 20;  ///< one sigma of an axis, and how fast it is forgotten
  double noise_deg = 0.1;
};

struct Scenario {
  std::string name, title;
  double max_duration_s = 1e9;
  WorldPlan world;
  TrajectoryPlan trajectory;
  CameraPlan camera;
  SensorModel sensor;
  ImuModel imu;
  RangePlan range;
  BaroPlan baro;
  AttitudePlan attitude;
  GnssPlan gnss;
  CameraFaults faults;
};

/// Reads a scenario. Every mistake (unknown key, wrong type, out of range, missing file, contradiction) is an error
/// that names file, line, key and what is allowed; all mistakes of a file are told at once, one a line.
rt::Result<Scenario> read_scenario(const std::filesystem::path& file);

/// Finds NAME.toml in folder and reads it; the error names the scenarios that exist. NAME may also be a path to a file.
rt::Result<Scenario> find_scenario(const std::string& name, const std::filesystem::path& folder);

/// Names of the scenarios in a folder, sorted.
std::vector<std::string> list_scenarios(const std::filesystem::path& folder);

}  // namespace godwit::sim
