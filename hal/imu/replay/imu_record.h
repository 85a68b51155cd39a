// The readings of a recorded inertial sensor: EuRoC's imu0/data.csv and TUM-like imu.txt. Pure functions over text.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "hal/imu/error_model.h"
#include "hal/imu/imu.h"
#include "hal/rt/result.h"

namespace godwit::hal {

struct ImuRecord {
  std::vector<ImuSample> samples;         ///< times as recorded, each above the one before; never empty
  std::uint64_t time_repeated = 0;        ///< left out: the same time as the one before, or an earlier one
  std::uint64_t time_ahead = 0;           ///< left out: more than a second ahead of the one before and of the one after
  int repeated_line = 0, ahead_line = 0;  ///< the first of them in the file, counted from 1; 0: there is none
  std::uint64_t stuck = 0;      ///< the same readings as in so many lines before that no sensor that works gives them
  std::uint64_t saturated = 0;  ///< flagged: an axis at the end of its range, where `errors` says that
  double rate_hz = 0;           ///< by the median of the steps; 0: a single sample
  ImuErrorModel errors;         ///< as the recording says it
  std::string cut_off;          ///< where and how it breaks off in its last line; empty: it does not

  /// What is wrong with a record that is used all the same, a line each; name: of the recording.
  std::vector<std::string> warnings(const std::string& name) const;
};

/// Lines "nanoseconds,wx,wy,wz,ax,ay,az" [rad/s], [m/s^2]; '#' starts a comment. Error: names the file, line and
/// reason; a line that cannot be read refuses the whole record (but the last, cut_off; also one that is not finite,
/// beyond 100 rad/s or 1000 m/s^2), and so does a record without samples.
rt::Result<ImuRecord> parse_euroc_imu(std::string_view text, const std::string& name);

/// Lines "seconds wx wy wz ax ay az". Errors as above.
rt::Result<ImuRecord> parse_tum_imu(std::string_view text, const std::string& name);

/// Reads what lies in a sequence's folder, in the layouts that cameras are replayed from: imu.txt; or mav0/imu0, imu0,
/// or imu0 beside the folder; with how the sensor errs, out of imu.yaml beside imu.txt or of imu0's sensor.yaml, where
/// that is there; readings at the end of a range that it names are flagged. Error: no readings are there, or as above.
/// Blocks.
rt::Result<ImuRecord> read_imu_record(const std::string& folder);
/// Of that how the sensor errs alone.
rt::Result<ImuErrorModel> read_imu_record_errors(const std::string& folder);

}  // namespace godwit::hal
