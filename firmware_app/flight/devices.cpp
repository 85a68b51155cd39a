#include "firmware_app/flight/devices.h"

#include <algorithm>
#include <cstdlib>
#include <filesystem>

#include "hal/camera/device/fed_camera.h"
#include "hal/camera/libcamera/libcamera_camera.h"
#include "hal/camera/v4l2/v4l2_camera.h"
#include "hal/imu/error_model.h"
#include "hal/imu/iio/iio_imu.h"
#include "hal/imu/mpu6000/mpu6000.h"
#include "hal/record_file.h"

namespace godwit::app {
namespace {

rt::Result<hal::CameraCalibration> read_calibration(const Config::Camera& config) {
  if (config.calibration.empty()) {
    return rt::Error{"camera.calibration: a camera without one cannot be flown; a file is needed"};
  }
  const auto text = hal::read_text_file(config.calibration);
  if (!text) return rt::Error{"camera.calibration: " + text.error().message};
  auto parsed = hal::parse_calibration(text.value(), config.calibration);
  if (!parsed) return rt::Error{"camera.calibration: " + parsed.error().message};
  return parsed;
}

std::string trimmed(const std::string& text) {
  const std::size_t first = text.find_first_not_of(' ');
  return first == std::string::npos ? std::string() : text.substr(first, text.find_last_not_of(' ') - first + 1);
}

/// "name=value, name=value". False: not of that form.
bool read_controls(const std::string& text, std::vector<std::pair<std::string, std::int64_t>>* out) {
  std::size_t at = 0;
  while (at < text.size()) {
    const std::size_t comma = std::min(text.find(',', at), text.size());
    const std::string item = text.substr(at, comma - at);
    at = comma + 1;
    const std::size_t equals = item.find('=');
    if (equals == std::string::npos) return false;
    const std::string name = trimmed(item.substr(0, equals)), value = trimmed(item.substr(equals + 1));
    char* end = nullptr;
    const std::int64_t number = std::strtoll(value.c_str(), &end, 10);
    if (name.empty() || value.empty() || *end != '\0') return false;
    out->emplace_back(name, number);
  }
  return true;
}

constexpr rt::TimeNs ns(double seconds) {
  return static_cast<rt::TimeNs>(seconds * 1e9);
}

hal::ExposurePlan exposure_plan(const Config::Camera& c, const hal::CameraCalibration& calibration, double fps) {
  using Mode = Config::Camera::Exposure;
  hal::ExposurePlan out;
  out.mode = c.exposure == Mode::kOff     ? hal::ExposureMode::kOff
             : c.exposure == Mode::kFixed ? hal::ExposureMode::kFixed
                                          : hal::ExposureMode::kAutomatic;
  out.fixed = {ns(c.exposure_ms * 1e-3), c.gain};
  out.automatic.target_mean = c.brightness;
  out.automatic.most_gain = c.gain_most;
  out.automatic.blur_px = c.blur_px;
  out.automatic.focal_px = calibration.fx;
  if (c.exposure_most_ms > 0) {
    out.automatic.most_ns = ns(c.exposure_most_ms * 1e-3);
  } else if (fps > 0) {
    // A readout as long as the interval leaves nothing: such sensors read while they expose.
    out.automatic.most_ns = ns(std::max(1 / fps - calibration.readout_s(), 0.5 / fps));
  }
  out.exposure_control = c.exposure_control;
  out.gain_control = c.gain_control;
  out.exposure_unit_ns = ns(c.exposure_unit_us * 1e-6);
  out.gain_one = c.gain_one;
  out.gain_step_db = c.gain_step_db;
  return out;
}

/// What V4L2 and libcamera have in common.
rt::Result<hal::DeviceSettings> device_settings(const Config::Camera& config,
                                                const hal::CameraCalibration& calibration) {
  hal::DeviceSettings out;
  out.device = config.device;
  out.width = calibration.width;
  out.height = calibration.height;
  if (!config.format.empty()) {
    out.format = hal::pixel_format_named(config.format);
    if (!out.format) {
      std::string all;
      for (const hal::PixelFormat format : hal::kPixelFormats) all.append(hal::name(format)).append(", ");
      return rt::Error{"camera.format: " + all + "or nothing is allowed"};
    }
  }
  out.fps = config.fps > 0 ? config.fps : calibration.fps;
  out.shift = config.shift;
  out.stamp_at = config.stamp == Config::Camera::Stamp::kFlags   ? hal::StampAt::kAsFlagged
                 : config.stamp == Config::Camera::Stamp::kStart ? hal::StampAt::kStartOfExposure
                                                                 : hal::StampAt::kEndOfReadout;
  out.exposure_ns = ns(config.exposure_ms * 1e-3);
  out.readout_ns = ns(calibration.readout_s());
  out.rolling = calibration.readout_frames > 0;
  out.exposure = exposure_plan(config, calibration, out.fps);
  return out;
}

rt::Result<hal::Mpu6000Settings> mpu6000_settings(const Config::Imu& config, const hal::AxisMap& axes) {
  const int g = config.accel_range_g;
  if (g != 2 && g != 4 && g != 8 && g != 16) return rt::Error{"imu.accel_range_g: 2, 4, 8 or 16 is allowed"};
  if (1000 % config.rate_hz != 0) return rt::Error{"imu.rate_hz: 1000 over a whole number is allowed for an MPU-6000"};
  const int r = config.gyro_range_deg_s;
  if (r != 250 && r != 500 && r != 1000 && r != 2000) {
    return rt::Error{"imu.gyro_range_deg_s: 250, 500, 1000 or 2000 is allowed"};
  }
  return hal::Mpu6000Settings{config.device, config.rate_hz, r, g, axes, config.self_test};
}

rt::Result<hal::AxisMap> axis_map(const Config::Imu& config) {
  const auto axes = hal::parse_axis_map(config.axes);
  if (axes) return *axes;
  return rt::Error{"imu.axes: three different axes that make a right-handed frame are allowed, such as \"x -y -z\""};
}

}  // namespace

rt::Result<hal::V4l2Settings> v4l2_settings(const Config::Camera& config, const hal::CameraCalibration& calibration) {
  auto any = device_settings(config, calibration);
  if (!any) return any.error();
  hal::V4l2Settings out;
  static_cast<hal::DeviceSettings&>(out) = std::move(any).value();
  if (!read_controls(config.controls, &out.controls)) {
    return rt::Error{"camera.controls: \"NAME=NUMBER, ..\" is allowed, such as \"exposure_auto=1, gain=20\""};
  }
  return out;
}

rt::Result<hal::DeviceSettings> libcamera_settings(const Config::Camera& config,
                                                   const hal::CameraCalibration& calibration) {
  if (config.device.empty() || config.device.starts_with("/dev/")) {
    return rt::Error{
        "camera.device: with libcamera \"index:0\" and so on, or the camera's id or a part of it is allowed"};
  }
  if (!config.controls.empty()) {
    return rt::Error{"camera.controls: V4L2's; with libcamera none is allowed, but camera.exposure, gain and fps"};
  }
  if (config.exposure == Config::Camera::Exposure::kAutomatic) {
    return rt::Error{"camera.exposure: with libcamera \"off\" (it exposes by itself) or \"fixed\" is allowed"};
  }
  return device_settings(config, calibration);
}

namespace {

rt::Result<std::unique_ptr<hal::Camera>> open_device(const Config::Camera& config,
                                                     const hal::CameraCalibration& calibration,
                                                     const rt::ThreadPlan& feeder, const DeviceLog& log) {
  const auto tell = [log](const std::string& text) {
    log(text.empty() ? "camera: the device is well again" : "warning: camera: " + text);
  };
  std::unique_ptr<hal::Camera> camera;
  if (config.source == Config::Camera::Source::kLibcamera) {
    const auto settings = libcamera_settings(config, calibration);
    if (!settings) return settings.error();
    auto library = hal::load_libcamera();
    if (!library) return rt::Error{"camera.source: " + library.error().message};
    auto opened = hal::LibcameraCamera::open(std::move(library).value(), hal::linux_clocks(), settings.value(), tell);
    if (!opened) return opened.error();
    camera = std::move(opened).value();
  } else {
    const auto settings = v4l2_settings(config, calibration);
    if (!settings) return settings.error();
    auto opened = hal::V4l2Camera::open(hal::linux_video_system(), settings.value(), tell);
    if (!opened) return opened.error();
    camera = std::move(opened).value();
  }
  if (camera->real_time()) return camera;
  // MJPEG, or a device of which nobody knows yet.
  auto fed = hal::FedCamera::start(std::move(camera), feeder);
  if (!fed) return fed.error();
  camera = std::move(fed).value();
  return camera;
}

}  // namespace

rt::Result<std::unique_ptr<hal::Camera>> open_camera_of_size(const Config::Camera& config, int width, int height,
                                                             const rt::ThreadPlan& feeder, const DeviceLog& log) {
  hal::CameraCalibration size;
  size.width = width;
  size.height = height;
  return open_device(config, size, feeder, log);
}

rt::Result<OpenedCamera> open_camera(const Config::Camera& config, const DeviceLog& log, const rt::ThreadPlan& feeder) {
  auto calibration = read_calibration(config);
  if (!calibration) return calibration.error();
  auto camera = open_device(config, calibration.value(), feeder, log);
  if (!camera) return camera.error();
  OpenedCamera out{std::move(camera).value(), calibration.value()};
  out.calibration.channels = out.camera->channels();
  if (!(out.calibration.fps > 0)) out.calibration.fps = config.fps;
  return out;
}

rt::Result<std::unique_ptr<hal::Imu>> open_imu(const Config::Imu& config, const DeviceLog& log) {
  std::unique_ptr<hal::Imu> out;
  using Source = Config::Imu::Source;
  if (config.source != Source::kMpu6000 && config.source != Source::kIio) return out;
  const auto axes = axis_map(config);
  if (!axes) return axes.error();
  std::string trouble;
  if (config.source == Config::Imu::Source::kMpu6000) {
    const auto settings = mpu6000_settings(config, axes.value());
    if (!settings) return settings.error();
    auto opened = hal::Mpu6000::open(hal::spidev_port(), settings.value());
    if (!opened) return opened.error();
    if (opened.value()->trouble() != nullptr) trouble = opened.value()->trouble();
    out = std::move(opened).value();
  } else {
    // Each port tells on its own what keeps it from opening.
    const auto tell = [log](const std::string& text) {
      if (!text.empty()) log("warning: IMU: " + text);
    };
    const double rate_hz = config.rate_hz;
    auto opened =
        hal::IioImu::open(hal::libiio_port(config.device, rate_hz, tell),
                          config.accel_device.empty() ? nullptr : hal::libiio_port(config.accel_device, rate_hz, tell),
                          {rate_hz, axes.value()});
    out = std::move(opened);
  }
  if (!trouble.empty()) log("warning: IMU " + config.device + ": " + trouble);
  return out;
}

void check_devices(ConfigReport* report) {
  const Config& c = report->config;
  // Errors name their key before the first colon.
  const auto mistake = [&](const std::string& message) {
    const std::size_t colon = message.find(": ");
    report->mistake(message.substr(0, colon), message.substr(colon + 2));
  };
  if (!c.imu.calibration.empty()) {
    const auto errors = hal::read_imu_error_model(c.imu.calibration);
    if (!errors) report->mistake("imu.calibration", errors.error().message);
  }
  if (c.camera.live()) {
    const auto calibration = read_calibration(c.camera);
    if (!calibration) mistake(calibration.error().message);
    const hal::CameraCalibration known = calibration ? calibration.value() : hal::CameraCalibration();
    if (c.camera.source == Config::Camera::Source::kLibcamera) {
      std::error_code unreadable;
      if (!std::filesystem::exists(hal::libcamera_library(), unreadable)) {
        report->mistake("camera.source",
                        "\"libcamera\": this godwit was built without it (libcamera-dev was not there; " +
                            hal::libcamera_library() + " is missing); \"v4l2\" is allowed");
      }
      const auto settings = libcamera_settings(c.camera, known);
      if (!settings) mistake(settings.error().message);
    } else if (const auto settings = v4l2_settings(c.camera, known); !settings) {
      mistake(settings.error().message);
    }
    if (calibration && c.imu.flown_by() && !calibration.value().T_body_cam && c.link.T_body_cam.empty()) {
      report->mistake("imu.enabled",
                      "neither camera.calibration nor link.T_body_cam says where the camera sits on the sensor; "
                      "without that only false is allowed");
    }
  }
  if (c.imu.source != Config::Imu::Source::kMpu6000 && c.imu.source != Config::Imu::Source::kIio) return;
  const auto axes = axis_map(c.imu);
  if (!axes) return mistake(axes.error().message);
  if (c.imu.source != Config::Imu::Source::kMpu6000) return;
  const auto settings = mpu6000_settings(c.imu, axes.value());
  if (!settings) mistake(settings.error().message);
}

}  // namespace godwit::app
