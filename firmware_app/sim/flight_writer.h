// A simulated flight as a folder that this program and others read: TUM RGB-D and EuRoC/ASL layout in one.
#pragma once

#include <atomic>
#include <cstdint>
#include <span>
#include <string>

#include "hal/rt/result.h"
#include "hal/sim/flight/flight.h"

namespace godwit::app {

struct FlightWriterOptions {
  std::string out;
  bool png = false;  ///< lossless, twice as large; else JPEG at quality 95
  int start = 0;     ///< pictures left out at the beginning
  int frames = 0;    ///< 0: all
};

/// What was written.
struct FlightWritten {
  int pictures = 0, dropped = 0;
  double seconds = 0, path_m = 0, render_ms = 0;  ///< render_ms: mean processor time of a picture
};

/// Times in the files count from this second, so that they look like times to those who expect them so.
constexpr double kFlightEpochS = 1000;

/// Flies and writes to options.out:
///   mav0/cam0/data/NANOSECONDS.jpg, mav0/cam0/data.csv, mav0/cam0/sensor.yaml, mav0/imu0/data.csv,
///   mav0/imu0/sensor.yaml, mav0/state_groundtruth_estimate0/data.csv     EuRoC/ASL
///   rgb.txt (the same pictures), camera.yaml, groundtruth.txt (camera to world), groundtruth_body.txt, imu.txt    TUM
///   boxes.csv (true boxes), imu.csv (readings and truth), range.csv, gnss.csv, baro.csv
/// rgb.txt comes last: a folder that has one is whole. Error: what could not be written and why. Ends early, with an
/// error, when *stop becomes true.
rt::Result<FlightWritten> write_flight(const sim::Flight& flight, const FlightWriterOptions& options,
                                       const std::atomic<bool>& stop);

/// groundtruth.txt alone: the camera's true pose, 200 times a second. epoch_s is added to all times.
rt::Result<void> write_ground_truth(const sim::Flight& flight, const std::string& file, double epoch_s);

/// Into the folder `out`: groundtruth_body.txt (pose of the body, 200 times a second), imu.csv (readings, and what an
/// ideal sensor would have read), and range.csv, gnss.csv and baro.csv where the scenario has these sensors. epoch_s is
/// added to all times.
rt::Result<void> write_sensors(const sim::Flight& flight, const std::string& out, double epoch_s);

/// boxes.csv's first line, and the lines of one picture.
std::string boxes_head();
std::string boxes_lines(std::span<const sim::TrueBox> boxes, rt::TimeNs t_ns);

}  // namespace godwit::app
