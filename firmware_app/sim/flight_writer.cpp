#include "firmware_app/sim/flight_writer.h"

#include <Eigen/Geometry>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fmt/format.h>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <vector>

#include "firmware_app/output/progress_bar.h"
#include "hal/atomic_file.h"
#include "hal/sim/flight/sim_attitude.h"
#include "hal/sim/flight/sim_baro.h"

namespace godwit::app {
namespace {

constexpr double kTruthHz = 200;

rt::Result<void> write_text(const std::string& file, std::string_view text) {
  hal::AtomicFile out;
  if (auto r = out.open(file); !r) return r;
  if (auto r = out.write(text); !r) return r;
  return out.commit();
}

std::string pose_text(const sim::Vec3& p, const sim::Mat3& R) {
  const Eigen::Quaterniond q = Eigen::Quaterniond(R).normalized();
  return fmt::format("{:.6f} {:.6f} {:.6f} {:.9f} {:.9f} {:.9f} {:.9f}", p.x(), p.y(), p.z(), q.x(), q.y(), q.z(),
                     q.w());
}

std::string seconds(rt::TimeNs t) {
  return fmt::format("{}.{:09}", t / rt::kNsPerSecond, t % rt::kNsPerSecond);
}

rt::TimeNs epoch_ns(double epoch_s) {
  return static_cast<rt::TimeNs>(std::llround(epoch_s * 1e9));
}

std::string mounting(const sim::CameraRig& rig) {
  std::string out;
  for (int i = 0; i < 3; ++i) {
    out += fmt::format("{:.12g}, {:.12g}, {:.12g}, {:.12g}, ", rig.R_body_cam(i, 0), rig.R_body_cam(i, 1),
                       rig.R_body_cam(i, 2), rig.t_body_cam_m[i]);
  }
  return out + "0.0, 0.0, 0.0, 1.0";
}

std::string camera_yaml(const sim::Flight& flight) {
  const sim::CameraPlan& camera = flight.scenario().camera;
  const sim::Lens& lens = camera.rig.lens;
  const auto& d = lens.distortion;
  std::string out = fmt::format(
      "# pinhole camera of the simulated flight '{}', seed {}\nmodel: pinhole\nwidth: {}\nheight: {}\nfx: {:.12g}\nfy: "
      "{:.12g}\n"
      "cx: {:.12g}\ncy: {:.12g}\ndistortion_model: radtan (k1 k2 p1 p2 k3)\ndistortion: [{:.12g}, {:.12g}, {:.12g}, "
      "{:.12g}, {:.12g}]\n"
      "fps: {:.12g}\nimage_channels: 1 (grey 8 bit)\n",
      flight.scenario().name, flight.seed(), lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy, d[0], d[1],
      d[2], d[3], d[4], camera.fps);
  out += camera.rig.readout_s > 0 ? fmt::format("shutter: rolling\nreadout_s: {:.12g}\n", camera.rig.readout_s)
                                  : "shutter: global\n";
  out += fmt::format(
      "# body: x forward, y right, z down; row by row, maps camera points into the body\nT_body_cam: [{}]\n",
      mounting(camera.rig));
  return out;
}

std::string asl_camera_yaml(const sim::Flight& flight) {
  const sim::CameraPlan& camera = flight.scenario().camera;
  const sim::Lens& lens = camera.rig.lens;
  const auto& d = lens.distortion;
  // EuRoC knows four coefficients; a fifth is told only where it is not zero.
  const std::string k3 = d[4] != 0 ? fmt::format(", {:.12g}", d[4]) : "";
  return fmt::format(
      "sensor_type: camera\ncomment: simulated flight '{}', seed {}\nT_BS:\n  cols: 4\n  rows: 4\n  data: "
      "[{}]\nrate_hz: {:.12g}\n"
      "resolution: [{}, {}]\ncamera_model: pinhole\nintrinsics: [{:.12g}, {:.12g}, {:.12g}, {:.12g}]\n"
      "distortion_model: radial-tangential\ndistortion_coefficients: [{:.12g}, {:.12g}, {:.12g}, {:.12g}{}]\n",
      flight.scenario().name, flight.seed(), mounting(camera.rig), camera.fps, lens.width, lens.height, lens.fx,
      lens.fy, lens.cx, lens.cy, d[0], d[1], d[2], d[3], k3);
}

rt::Result<void> write_imu(const sim::Flight& flight, const std::string& out) {
  std::string tum =
      "# timestamp[s] gyro_x gyro_y gyro_z [rad/s] acc_x acc_y acc_z [m/s^2]  (body: x forward, y right, z down)\n";
  std::string asl =
      "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m s^-2],a_RS_S_y [m "
      "s^-2],a_RS_S_z [m s^-2]\n";
  const auto imu = flight.imu(epoch_ns(kFlightEpochS));
  hal::ImuSample s;
  const rt::TimeNs last = epoch_ns(kFlightEpochS + flight.duration_s());
  while (imu->next(&s, 0) == hal::ImuStatus::kSample && s.t_ns <= last) {
    const auto &w = s.gyro_rad_s, &a = s.accel_m_s2;
    tum += fmt::format("{} {:.9f} {:.9f} {:.9f} {:.9f} {:.9f} {:.9f}\n", seconds(s.t_ns), w[0], w[1], w[2], a[0], a[1],
                       a[2]);
    asl += fmt::format("{},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f}\n", s.t_ns, w[0], w[1], w[2], a[0], a[1], a[2]);
  }
  const sim::ImuModel& m = flight.scenario().imu;
  const std::string yaml = fmt::format(
      "sensor_type: imu\ncomment: simulated MPU-6000\nT_BS:\n  cols: 4\n  rows: 4\n  data: [1.0, 0.0, 0.0, 0.0, 0.0, "
      "1.0, 0.0, 0.0, 0.0, "
      "0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]\nrate_hz: {:.12g}\ngyroscope_noise_density: {:.12g}\ngyroscope_random_walk: "
      "{:.12g}\n"
      "accelerometer_noise_density: {:.12g}\naccelerometer_random_walk: {:.12g}\n"
      "accelerometer_bias_sigma: {:.12g}\naccelerometer_scale_sigma: 0\n"
      "gyroscope_range: {:.12g}\naccelerometer_range: {:.12g}\n",
      m.rate_hz, m.gyro_noise, m.gyro_bias_walk, m.accel_noise, m.accel_bias_walk, m.accel_bias, m.gyro_range_rad_s,
      m.accel_range_m_s2);
  if (auto r = write_text(out + "/imu.txt", tum); !r) return r;
  if (auto r = write_text(out + "/imu.yaml", yaml); !r) return r;
  if (auto r = write_text(out + "/mav0/imu0/data.csv", asl); !r) return r;
  return write_text(out + "/mav0/imu0/sensor.yaml", yaml);
}

rt::Result<void> write_asl_truth(const sim::Flight& flight, const std::string& file) {
  std::string asl =
      "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],v_RS_R_x [m "
      "s^-1],v_RS_R_y [m s^-1],"
      "v_RS_R_z [m s^-1]\n";
  for (int i = 0; i <= static_cast<int>(flight.duration_s() * kTruthHz); ++i) {
    const sim::BodyState s = flight.trajectory().at(i / kTruthHz);
    const rt::TimeNs t = epoch_ns(kFlightEpochS + i / kTruthHz);
    const Eigen::Quaterniond q = Eigen::Quaterniond(s.R_world_body).normalized();
    asl += fmt::format("{},{:.6f},{:.6f},{:.6f},{:.9f},{:.9f},{:.9f},{:.9f},{:.6f},{:.6f},{:.6f}\n", t,
                       s.position_m.x(), s.position_m.y(), s.position_m.z(), q.w(), q.x(), q.y(), q.z(),
                       s.velocity_m_s.x(), s.velocity_m_s.y(), s.velocity_m_s.z());
  }
  return write_text(file, asl);
}

rt::Result<void> write_imu_truth(const sim::Flight& flight, const std::string& file, double epoch_s) {
  std::string text =
      "t,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z,true_gyro_x,true_gyro_y,true_gyro_z,true_accel_x,true_accel_y,"
      "true_accel_z\n";
  const auto imu = flight.imu(epoch_ns(epoch_s));
  hal::ImuSample s;
  const rt::TimeNs last = epoch_ns(epoch_s + flight.duration_s());
  while (imu->next(&s, 0) == hal::ImuStatus::kSample && s.t_ns <= last) {
    const auto &w = s.gyro_rad_s, &a = s.accel_m_s2;
    const sim::Vec3 &tw = imu->truth().gyro_rad_s, &ta = imu->truth().accel_m_s2;
    text += fmt::format("{},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f},{:.9f}\n",
                        seconds(s.t_ns), w[0], w[1], w[2], a[0], a[1], a[2], tw.x(), tw.y(), tw.z(), ta.x(), ta.y(),
                        ta.z());
  }
  return write_text(file, text);
}

rt::Result<void> write_aids(const sim::Flight& flight, const std::string& out, double epoch_s) {
  if (const auto range = flight.rangefinder(epoch_ns(epoch_s))) {
    std::string text = "t,range_m,valid,truth_m\n";
    hal::RangeSample s;
    while (range->next(&s, 0) == hal::RangeStatus::kSample) {
      text += fmt::format("{},{:.4f},{},{:.4f}\n", seconds(s.t_ns), s.range_m, s.valid ? 1 : 0, range->truth_m());
    }
    if (auto r = write_text(out + "/range.csv", text); !r) return r;
  }
  if (const auto gnss = flight.gnss(epoch_ns(epoch_s))) {
    std::string text = "t,fix,x,y,z,vx,vy,vz,sigma_m,speed_sigma_m_s\n";
    hal::GnssSample s;
    while (gnss->next(&s, 0) == hal::GnssStatus::kSample) {
      const auto &p = s.position_m, &v = s.velocity_m_s;
      text += fmt::format("{},{},{:.4f},{:.4f},{:.4f},{:.4f},{:.4f},{:.4f},{:.3f},{:.3f}\n", seconds(s.t_ns),
                          s.fix ? 1 : 0, p[0], p[1], p[2], v[0], v[1], v[2], s.sigma_position_m, s.sigma_velocity_m_s);
    }
    if (auto r = write_text(out + "/gnss.csv", text); !r) return r;
  }
  if (const auto baro = flight.barometer(epoch_ns(epoch_s))) {
    std::string text = "t,pressure_pa,true_pressure_pa\n";
    hal::BaroSample s;
    while (baro->next(&s, 0) == hal::BaroStatus::kSample) {
      text += fmt::format("{},{:.3f},{:.3f}\n", seconds(s.t_ns), s.pressure_pa, baro->truth_pa());
    }
    if (auto r = write_text(out + "/baro.csv", text); !r) return r;
  }
  sim::SimAttitude attitude(flight, epoch_ns(epoch_s));
  std::string text = "t,qw,qx,qy,qz,off_deg\n";
  sim::AttitudeSample s;
  while (attitude.next(&s)) {
    const auto& q = s.q_ned_body;
    text += fmt::format("{},{:.7f},{:.7f},{:.7f},{:.7f},{:.3f}\n", seconds(s.t_ns), q[0], q[1], q[2], q[3],
                        attitude.off_deg());
  }
  return write_text(out + "/attitude.csv", text);
}

}  // namespace

rt::Result<void> write_ground_truth(const sim::Flight& flight, const std::string& file, double epoch_s) {
  std::string text = "# timestamp tx ty tz qx qy qz qw   (pose of the camera in the world, z up)\n";
  for (int i = 0; i <= static_cast<int>(flight.duration_s() * kTruthHz); ++i) {
    const sim::CameraPose pose = sim::camera_pose(flight.trajectory(), flight.scenario().camera.rig, i / kTruthHz);
    text += seconds(epoch_ns(epoch_s + i / kTruthHz)) + ' ' + pose_text(pose.position_m, pose.R_world_cam) + '\n';
  }
  return write_text(file, text);
}

rt::Result<void> write_sensors(const sim::Flight& flight, const std::string& out, double epoch_s) {
  std::string body = "# timestamp tx ty tz qx qy qz qw   (pose of the body in the world, z up)\n";
  for (int i = 0; i <= static_cast<int>(flight.duration_s() * kTruthHz); ++i) {
    const sim::BodyState s = flight.trajectory().at(i / kTruthHz);
    body += seconds(epoch_ns(epoch_s + i / kTruthHz)) + ' ' + pose_text(s.position_m, s.R_world_body) + '\n';
  }
  if (auto r = write_text(out + "/groundtruth_body.txt", body); !r) return r;
  if (auto r = write_imu_truth(flight, out + "/imu.csv", epoch_s); !r) return r;
  return write_aids(flight, out, epoch_s);
}

std::string boxes_head() {
  return "t,mover,kind,moving,x0,y0,x1,y1,visible_px\n";
}

std::string boxes_lines(std::span<const sim::TrueBox> boxes, rt::TimeNs t_ns) {
  constexpr const char* kKinds[] = {"person", "car", "truck"};
  std::string text;
  for (const sim::TrueBox& b : boxes) {
    text += fmt::format("{},{},{},{},{:.1f},{:.1f},{:.1f},{:.1f},{}\n", seconds(t_ns), b.mover,
                        kKinds[static_cast<int>(b.kind)], b.moving ? 1 : 0, b.x0, b.y0, b.x1, b.y1, b.visible_px);
  }
  return text;
}

rt::Result<FlightWritten> write_flight(const sim::Flight& flight, const FlightWriterOptions& options,
                                       const std::atomic<bool>& stop) {
  namespace fs = std::filesystem;
  for (const char* folder : {"/mav0/cam0/data", "/mav0/imu0", "/mav0/state_groundtruth_estimate0"}) {
    std::error_code error;
    fs::create_directories(options.out + folder, error);
    if (error) return rt::Error{options.out + folder + ": cannot make the folder: " + error.message()};
  }
  const std::string index_file = options.out + "/rgb.txt";
  std::error_code ignored;
  fs::remove(index_file, ignored);  // an older flight here is no longer whole

  FlightWritten done;
  const auto camera = flight.camera(epoch_ns(kFlightEpochS));
  const int last = options.frames > 0 ? std::min(camera->frames(), options.start + options.frames) : camera->frames();
  if (options.start >= camera->frames())
    return rt::Error{
        fmt::format("the flight has {} pictures, none is left behind the first {}", camera->frames(), options.start)};
  camera->skip_to(options.start);
  std::vector<std::uint8_t> pixels(camera->width() * camera->height());
  const rt::MutableImageView grey{pixels.data(), camera->width(), camera->height(), camera->width()};
  const cv::Mat picture(grey.height, grey.width, CV_8U, pixels.data());
  std::string rgb = "# timestamp filename\n", asl = "#timestamp [ns],filename\n", boxes = boxes_head();
  ProgressBar bar(last - options.start);
  rt::TimeNs cpu = 0;
  for (int i = options.start; i < last; ++i) {
    if (stop.load(std::memory_order_relaxed))
      return rt::Error{"interrupted; the folder " + options.out + " is not whole"};
    hal::CapturedFrame frame;
    std::string why;
    const rt::TimeNs before = rt::thread_cpu_now_ns();
    const hal::CameraStatus status = camera->next(grey, nullptr, 0, &frame, &why);
    cpu += rt::thread_cpu_now_ns() - before;
    bar.show(i - options.start + 1, "");
    if (status != hal::CameraStatus::kFrame) {
      ++done.dropped;
      continue;
    }
    const std::string name = fmt::format("{}.{}", frame.t_capture_ns, options.png ? "png" : "jpg");
    const std::string file = options.out + "/mav0/cam0/data/" + name;
    const std::vector<int> how =
        options.png ? std::vector<int>{cv::IMWRITE_PNG_COMPRESSION, 3} : std::vector<int>{cv::IMWRITE_JPEG_QUALITY, 95};
    bool written = false;
    try {
      written = cv::imwrite(file, picture, how);
    } catch (const cv::Exception& e) {
      return rt::Error{file + ": cannot be written: " + e.what()};
    }
    if (!written) return rt::Error{file + ": cannot be written"};
    rgb += seconds(frame.t_capture_ns) + " mav0/cam0/data/" + name + '\n';
    asl += fmt::format("{},{}\n", frame.t_capture_ns, name);
    boxes += boxes_lines(camera->scene().boxes(), frame.t_capture_ns);
    ++done.pictures;
  }
  done.seconds = (last - options.start) / flight.scenario().camera.fps;
  done.render_ms = rt::to_ms(cpu) / std::max(1, done.pictures);
  sim::Vec3 at = flight.trajectory().at(options.start / flight.scenario().camera.fps).position_m;
  for (int i = options.start + 1; i < last; ++i) {
    const sim::Vec3 next = flight.trajectory().at(flight.frame_time_s(i)).position_m;
    done.path_m += (next - at).norm();
    at = next;
  }
  for (const auto& [name, text] : {std::pair<const char*, std::string>{"/camera.yaml", camera_yaml(flight)},
                                   {"/mav0/cam0/sensor.yaml", asl_camera_yaml(flight)},
                                   {"/mav0/cam0/data.csv", asl},
                                   {"/boxes.csv", boxes}}) {
    if (auto r = write_text(options.out + name, text); !r) return r.error();
  }
  if (auto r = write_imu(flight, options.out); !r) return r.error();
  if (auto r = write_asl_truth(flight, options.out + "/mav0/state_groundtruth_estimate0/data.csv"); !r)
    return r.error();
  if (auto r = write_ground_truth(flight, options.out + "/groundtruth.txt", kFlightEpochS); !r) return r.error();
  if (auto r = write_sensors(flight, options.out, kFlightEpochS); !r) return r.error();
  if (auto r = write_text(index_file, rgb); !r) return r.error();
  return done;
}

}  // namespace godwit::app
