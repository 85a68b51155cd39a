// The configuration: one TOML file into one struct that nobody changes afterwards.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "detector/detector.h"
#include "hal/rt/thread.h"

namespace godwit::app {

/// Every key of config/godwit.toml with its default. Keys and ranges: config_schema.cpp.
struct Config {
  struct Pipeline {
    int frame_slots = 0;          ///< 0: as many as the odometry needs
    int mapper_delay_frames = 2;  ///< --sequential: results of the mapper arrive so many frames later
    int detection_ms = 0;         ///< --sequential: what the detector finds comes so much later than it was asked
  } pipeline;

  struct Threads {
    bool lock_memory = false;
    rt::ThreadPlan camera, imu, tracker, mapper, detector, link;
  } threads;

  struct Scheduling {
    double deadline_ms = 33.3;   ///< a pose that stands later after its delivery is a slip
    double tracker_p95_ms = 15;  ///< above: a rung of the ladder down
    double temperature_c = 85;   ///< the same
    double calm_s = 10;          ///< so long must all be well before a rung up
  } scheduler;

  /// Where godwitd's pictures come from; the tool's commands bring their own.
  struct Camera {
    enum class Source { kNone, kSim, kReplay, kV4l2, kLibcamera };
    /// A device, opened by open_camera.
    bool live() const { return source == Source::kV4l2 || source == Source::kLibcamera; }
    enum class Stamp { kFlags, kStart, kEnd };
    enum class Exposure { kOff, kFixed, kAutomatic };
    Source source = Source::kNone;
    std::string calibration;                     ///< devices: camera.yaml, sensor.yaml, ..
    std::string device = "/dev/video0";          ///< v4l2: path, by-id:NAME or serial:NUMBER; libcamera: index:N or id
    std::string format;                          ///< v4l2: name of a pixel format; empty: the first that the device has
    double fps = 0;                              ///< devices: 0: the calibration's, or else as the device is set
    int shift = -1;                              ///< v4l2, 10 and 16 bits: bits to drop; -1: by the format
    std::string controls;                        ///< v4l2: "name=value, .."
    Stamp stamp = Stamp::kFlags;                 ///< v4l2: what the device's stamps mark
    double exposure_ms = 0;                      ///< v4l2: where the device does not say, and of Exposure::kFixed
    Exposure exposure = Exposure::kOff;          ///< v4l2: who sets the device's exposure and gain
    double gain = 1;                             ///< fixed: a factor
    double brightness = 100;                     ///< automatic: wanted mean of the pictures, 0 to 255
    double blur_px = 1;                          ///< automatic: a point may smear so far while the shutter is open
    double exposure_most_ms = 0;                 ///< automatic; 0: the frame interval less the readout
    double gain_most = 16;                       ///< automatic: a factor
    std::string exposure_control, gain_control;  ///< v4l2: names of the controls; empty: the usual ones
    double exposure_unit_us = 0;                 ///< v4l2: one step of the exposure control; 0: by the control
    double gain_one = 0;                         ///< v4l2: value of the gain control at gain 1; 0: its lowest
    double gain_step_db = 0;                     ///< v4l2: one step of the gain control; 0: it counts linearly
    std::string sequence;                        ///< replay: the folder
    bool allow_simulated = false;                ///< what did not happen now may go out on a real bus
    std::string scenario = "street";             ///< sim: name or file
    std::string scenarios;                       ///< sim: where names are looked up; empty: those that come with godwit
    std::uint64_t seed = 1;
    int pictures = 150;  ///< sim: rendered ahead, flown forth and back
  } camera;

  /// The network that finds what may move. The files that are meant: model_files().
  struct Detector {
    bool enabled = true;
    std::string model;  ///< ONNX, its metadata beside it; empty: the one that comes with godwit
    std::string
        small_model;  ///< for the small input; empty: the one that comes with godwit, or `model` where that is set
    godwit::detector::Backend backend = godwit::detector::Backend::kCpu;
    double min_score = 0.25;
    bool tiled = false;  ///< looks at squares of the picture, too (detector/tiles.h)
    int threads = 1;     ///< OpenCV's
  } detector;

  /// What moves, found by geometry (vo_core/tracking/motion_gate.h).
  struct Gate {
    bool enabled = true;
  } gate;

  struct Imu {
    enum class Source { kNone, kMpu6000, kIio, kReplay, kSim };
    Source source = Source::kNone;
    bool enabled = true;      ///< it is flown by where there is one: poses in metres, z up; false: it is only watched
    std::string calibration;  ///< Kalibr's imu.yaml: how the sensor errs; empty: as its source says, if it does
    double coast_s = 2;       ///< a pose comes from it alone for so long at most
    bool flown_by() const { return enabled && source != Source::kNone; }
    std::string device = "/dev/spidev0.0";  ///< mpu6000: path; iio: name or id
    std::string accel_device;               ///< iio: where acceleration has a device of its own
    int rate_hz = 200;
    int gyro_range_deg_s = 500;  ///< mpu6000
    int accel_range_g = 8;       ///< mpu6000
    std::string axes = "x y z";  ///< the sensor's axes that point forward, right and down
    bool self_test = false;      ///< mpu6000
    double silent_s = 0.5;       ///< an IMU of which nothing is newer is called silent
  } imu;

  /// What the autopilot and sensors on the bus tell beside camera and inertial sensor: used where it is heard.
  struct Aids {
    bool range = true, barometer = true, satellites = true;
    bool attitude = true;          ///< the autopilot's roll and pitch, where no inertial sensor is flown by
    double starting_height_m = 0;  ///< of the camera above flat ground where its first map begins; 0: not known
    int range_sensor = -1;         ///< id of a DroneCAN range sensor that looks down and does not say so; -1: none
    double delay_ms = 20;  ///< a measurement is so old on arrival, where its message does not say on a clock we know
    bool any() const { return range || barometer || satellites || attitude; }
  } aids;

  /// The CAN bus, and godwit as a DroneCAN node on it.
  struct Can {
    std::string bus;  ///< "multicast:N" or "socketcan:IFACE"; empty: no bus
    int node_id = 42;
    int autopilot_node = 10;
    int serial_index = 0;
    int baud_rate = 921600;
    bool fd = false;
    int telemetry_rate = 10;  ///< snapshots a second
    int telemetry_base = 0x300;
    bool telemetry_fd = false;
    bool lock_parameters = false;  ///< nobody sets, saves or erases parameters, or restarts the node, over the bus
    std::vector<int> writers;      ///< these nodes alone may; empty: any
  } can;

  /// What the autopilot is told, and how.
  struct Link {
    enum class Profile { kArdupilot, kPx4 };
    enum class Arming { kAllowWithoutPose, kRequirePose };
    std::string mavlink;  ///< "udp:HOST:PORT[:LOCALPORT]" or "serial:DEVICE:BAUD"; empty: through the bus
    Profile profile = Profile::kArdupilot;
    int rate = 30;                  ///< ODOMETRY a second
    bool between_pictures = false;  ///< at that rate and for the newest reading's time, whatever the camera's
    int system_id = 0;              ///< 0: the autopilot's
    Arming arming = Arming::kAllowWithoutPose;
    std::vector<double> T_body_cam;   ///< 4 x 4 by rows; empty: the calibration's, or else looking ahead
    double world_heading_deg = 0;     ///< of the body's front when the map begins
    bool north_by_satellites = true;  ///< the frame points north once they showed where that is
    std::vector<double> origin;       ///< latitude, longitude [degree], height [m]; empty: none
    bool bench_metric = false;        ///< replay only: lengths of the map pass for metres, its start for level
    std::string state_folder;         ///< parameters and reset counter are kept there; empty: nowhere
  } link;

  /// What godwitd writes down of each flight (output/flight_log.h).
  struct FlightLog {
    bool enabled = true;
    std::string folder;    ///< empty: `flights` in link.state_folder; without that there is no log
    int budget_mb = 2000;  ///< of all flights in it
  } flight_log;

  /// What is kept of pictures and readings, and written down when something goes wrong (output/event_recorder.h).
  struct Recorder {
    bool enabled = true;
    std::string folder;  ///< empty: `events` in link.state_folder; without that nothing is kept
    double before_s = 5, after_s = 3;
    int memory_mb = 100;
    int budget_mb = 2000;  ///< of all events in it
    int events = 20;       ///< of one flight
  } recorder;

  /// Where godwitd tells whoever looks at it (output/live_server.h).
  struct Live {
    bool enabled = true;
    std::string socket;  ///< empty: `live` in the service's runtime folder; without that nowhere
  } live;
};

/// A configuration, or everything that is wrong with it.
struct ConfigReport {
  Config config;                      ///< valid if mistakes is empty
  std::vector<std::string> mistakes;  ///< each names file, line, key and what is allowed
  std::string file;                   ///< what the file is called in mistakes
  std::map<std::string, int> lines;   ///< full name of each known key that the file holds -> its line
  bool ok() const { return mistakes.empty(); }

  /// Adds "file:line: key: message"; without the line where the file does not hold the key, which then has its default.
  void mistake(const std::string& key, const std::string& message);
  /// Puts the mistakes into the order of the file.
  void sort();
};

/// Pure function over text; collects all mistakes (unknown keys, wrong types, out of range, contradictions) instead of
/// stopping at the first.
ConfigReport parse_config(std::string_view toml, const std::string& name);

/// The same from a file; a file that cannot be read is a mistake.
ConfigReport load_config(const std::string& file);

/// "key = default  # what is allowed" for every key, in the order of config/godwit.toml.
std::vector<std::string> describe_config();

/// "key = value" for every key, as TOML, in the order of config/godwit.toml.
std::vector<std::string> show_config(const Config& config);

}  // namespace godwit::app
