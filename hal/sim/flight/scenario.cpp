#include "hal/sim/flight/scenario.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <fstream>
#include <numbers>
#include <sstream>
#include <string_view>
#include <utility>

#include "hal/sim/flight/scenario_section.h"

namespace godwit::sim {
namespace {

void read_world(Section s, WorldPlan* w) {
  constexpr std::array<std::pair<std::string_view, WorldKind>, 7> kKinds = {{{"residential", WorldKind::kResidential},
                                                                             {"fields", WorldKind::kFields},
                                                                             {"snow", WorldKind::kSnow},
                                                                             {"plaza", WorldKind::kPlaza},
                                                                             {"highway", WorldKind::kHighway},
                                                                             {"airfield", WorldKind::kAirfield},
                                                                             {"corridor", WorldKind::kCorridor}}};
  s.choice("kind", kKinds, &w->kind);
  s.real("relief_m", 0, 60, &w->relief_m);
  s.integer("cars", 0, 200, &w->cars);
  s.integer("people", 0, 400, &w->people);
  s.real("trees", 0, 3, &w->trees);
  s.real("sun_elevation_deg", 3, 90, &w->sun_elevation_deg);
  s.real("sun_azimuth_deg", -360, 360, &w->sun_azimuth_deg);
  s.real("ambient", 0.05, 1, &w->ambient);
  s.flag("night", &w->night);
  s.real("haze_m", 50, 1e5, &w->haze_m);
  s.integer("ground_texels", 512, 4096, &w->ground_texels);
  if ((w->ground_texels & (w->ground_texels - 1)) != 0) {
    s.complain("ground_texels", "must be 512, 1024, 2048 or 4096");
  }
  s.finish();
}

void read_leg(Section& s, Leg* leg) {
  constexpr std::array<std::pair<std::string_view, LegKind>, 9> kKinds = {{{"take_off", LegKind::kTakeOff},
                                                                           {"hover", LegKind::kHover},
                                                                           {"path", LegKind::kPath},
                                                                           {"survey", LegKind::kSurvey},
                                                                           {"dash", LegKind::kDash},
                                                                           {"spin", LegKind::kSpin},
                                                                           {"climb", LegKind::kClimb},
                                                                           {"land", LegKind::kLand},
                                                                           {"tilt", LegKind::kTilt}}};
  if (s.get("kind") == nullptr) {
    s.complain("kind", "is missing; allowed: take_off, hover, path, survey, dash, spin, climb, land, tilt");
    return;
  }
  s.choice("kind", kKinds, &leg->kind);
  const LegKind k = leg->kind;
  const auto need = [&](std::string_view name, double low, double high, double* out) {
    *out = std::nan("");
    s.real(name, low, high, out);
    if (std::isnan(*out)) s.complain(name, "is needed here, from " + number(low) + " to " + number(high));
  };
  if (k == LegKind::kHover) need("duration_s", 0.1, 600, &leg->duration_s);
  if (k == LegKind::kTakeOff || k == LegKind::kClimb) need("height_m", 0.3, 500, &leg->height_m);
  const bool in_place = k == LegKind::kHover || k == LegKind::kSpin || k == LegKind::kTilt;
  if (!in_place) need("speed_m_s", 0.05, 30, &leg->speed_m_s);
  if (k == LegKind::kDash) need("distance_m", 0.1, 2000, &leg->distance_m);
  if (k == LegKind::kSpin) {
    need("angle_deg", -3600, 3600, &leg->angle_deg);
    need("rate_deg_s", 1, 360, &leg->rate_deg_s);
    if (std::abs(leg->angle_deg) < 1) s.complain("angle_deg", "a spin turns at least 1 degree");
  }
  if (k == LegKind::kTilt) {
    need("pitch_deg", -60, 60, &leg->pitch_deg);
    need("roll_deg", -60, 60, &leg->roll_deg);
    need("rate_deg_s", 1, 90, &leg->rate_deg_s);
  }
  if (k == LegKind::kSurvey) {
    need("length_m", 1, 1000, &leg->length_m);
    need("width_m", 1, 1000, &leg->width_m);
    need("spacing_m", 1, 500, &leg->spacing_m);
  }
  if (k == LegKind::kPath) {
    s.points("points_m", &leg->points_m);
    if (leg->points_m.empty()) s.complain("points_m", "is needed here: a list of [x, y]");
  }
  if (k == LegKind::kPath || k == LegKind::kSurvey) s.flag("face_path", &leg->face_path);
}

void read_flight(Section s, TrajectoryPlan* t) {
  s.reals("start_m", -2000, 2000, {t->start_m.data(), 2});
  s.real("start_height_m", 0.1, 500, &t->start_height_m);
  s.real("heading_deg", -360, 360, &t->heading_deg);
  s.real("sway", 0, 10, &t->sway);
  s.real("acceleration_m_s2", 0.1, 6, &t->acceleration_m_s2);
  Section v = s.table("vibration");
  v.real("frequency_hz", 5, 400, &t->vibration.frequency_hz);
  v.real("angle_deg", 0, 2, &t->vibration.angle_deg);
  v.real("position_mm", 0, 10, &t->vibration.position_mm);
  v.finish();
  s.each("leg", [&](Section& leg) { read_leg(leg, &t->legs.emplace_back()); });
  if (t->legs.empty()) s.complain("leg", "a flight needs at least one [[flight.leg]]");
  s.finish();
}

void read_camera(Section s, CameraPlan* c) {
  Lens& lens = c->rig.lens;
  s.integer("width", 64, 1280, &lens.width);
  s.integer("height", 64, 1024, &lens.height);
  lens.cx = (lens.width - 1) / 2.0;
  lens.cy = (lens.height - 1) / 2.0;
  s.real("fx", 50, 5000, &lens.fx);
  lens.fy = lens.fx;
  s.real("fy", 50, 5000, &lens.fy);
  s.real("cx", 0, 1280, &lens.cx);
  s.real("cy", 0, 1024, &lens.cy);
  s.reals("distortion", -2, 2, lens.distortion);
  if (!lens.monotonic()) s.complain("distortion", "folds the picture over inside its corners");
  s.real("fps", 1, 200, &c->fps);
  s.real("pitch_down_deg", -45, 90, &c->pitch_down_deg);
  s.reals("position_m", -3, 3, {c->rig.t_body_cam_m.data(), 3});
  double readout_ms = 0;
  s.real("readout_ms", 0, 40, &readout_ms);
  c->rig.readout_s = readout_ms * 1e-3;
  s.real("time_offset_ms", -100, 100, &c->time_offset_ms);
  s.finish();
  if (readout_ms > 1000 / c->fps) s.complain("readout_ms", "is longer than the time between two pictures");
  const double p = c->pitch_down_deg * std::numbers::pi / 180;
  c->rig.R_body_cam << 0, -std::sin(p), std::cos(p), 1, 0, 0, 0, std::cos(p), std::sin(p);
}

void read_sensor(Section s, SensorModel* m) {
  s.real("exposure_ms", 0.01, 33, &m->exposure_ms);
  s.real("gain", 0.05, 50, &m->gain);
  s.flag("auto_exposure", &m->auto_exposure);
  s.real("mean_target", 20, 230, &m->mean_target);
  s.real("read_noise", 0, 30, &m->read_noise);
  s.real("shot_noise", 0, 2, &m->shot_noise);
  s.real("vignetting", 0, 0.8, &m->vignetting);
  s.real("glare", 0, 500, &m->glare);
  s.real("flicker_hz", 0, 1000, &m->flicker_hz);
  s.real("flicker_depth", 0, 0.95, &m->flicker_depth);
  s.each("gain_step", [&](Section& step) {
    GainStep& g = m->gain_steps.emplace_back();
    step.real("t_s", 0, 1e4, &g.t_s);
    step.real("factor", 0.05, 20, &g.factor);
  });
  s.finish();
}

void read_imu(Section s, ImuModel* m) {
  s.real("rate_hz", 20, 8000, &m->rate_hz);
  s.real("gyro_noise", 0, 0.1, &m->gyro_noise);
  s.real("accel_noise", 0, 1, &m->accel_noise);
  s.real("gyro_bias_walk", 0, 0.01, &m->gyro_bias_walk);
  s.real("accel_bias_walk", 0, 0.1, &m->accel_bias_walk);
  s.real("gyro_bias", 0, 1, &m->gyro_bias);
  s.real("accel_bias", 0, 5, &m->accel_bias);
  s.real("gyro_range_rad_s", 1, 100, &m->gyro_range_rad_s);
  s.real("accel_range_m_s2", 15, 1000, &m->accel_range_m_s2);
  s.real("noise_times", 0, 100, &m->noise_times);
  s.real("delay_ms", 0, 50, &m->delay_ms);
  s.real("clock_jitter_ms", 0, 20, &m->clock_jitter_ms);
  s.real("mounting_error_deg", 0, 20, &m->mounting_error_deg);
  s.real("gyro_bias_ramp", 0, 0.01, &m->gyro_bias_ramp);
  s.real("accel_bias_ramp", 0, 0.1, &m->accel_bias_ramp);
  s.finish();
}

void read_baro(Section s, BaroPlan* b) {
  s.flag("present", &b->present);
  s.real("rate_hz", 0.5, 200, &b->rate_hz);
  s.real("noise_pa", 0, 100, &b->noise_pa);
  s.real("wander_pa", 0, 1000, &b->wander_pa);
  s.real("wander_s", 1, 1e4, &b->wander_s);
  s.real("dynamic_share", -1, 1, &b->dynamic_share);
  s.real("delay_ms", 0, 1000, &b->delay_ms);
  s.finish();
}

void read_attitude(Section s, AttitudePlan* a) {
  s.real("rate_hz", 0.5, 200, &a->rate_hz);
  s.real("wander_deg", 0, 30, &a->wander_deg);
  s.real("wander_s", 0.1, 1e4, &a->wander_s);
  s.real("noise_deg", 0, 10, &a->noise_deg);
  s.finish();
}

void read_range(Section s, RangePlan* r) {
  s.flag("present", &r->present);
  s.real("rate_hz", 1, 1000, &r->rate_hz);
  s.real("noise_m", 0, 2, &r->noise_m);
  s.real("min_m", 0.01, 10, &r->min_m);
  s.real("max_m", 1, 500, &r->max_m);
  s.real("dropout_share", 0, 1, &r->dropout_share);
  if (r->min_m >= r->max_m) s.complain("min_m", "must be below max_m");
  s.each("jump", [&](Section& jump) {
    RangeJump& j = r->jumps.emplace_back();
    jump.real("t_s", 0, 1e4, &j.t_s);
    jump.real("duration_s", 0.01, 1e4, &j.duration_s);
    jump.real("offset_m", -100, 100, &j.offset_m);
  });
  s.finish();
}

}  // namespace

rt::Result<Scenario> read_scenario(const std::filesystem::path& file) {
  std::error_code unreadable;
  if (!std::filesystem::is_regular_file(file, unreadable)) return rt::Error{file.string() + ": no such file"};
  std::ifstream in(file, std::ios::binary);
  std::stringstream content;
  content << in.rdbuf();
  if (!in) return rt::Error{file.string() + ": cannot be read"};
  const std::string text = content.str();
  // With exceptions, as all that reads TOML: the parts of toml++'s header that both ways share are of one name, and a
  // program with both has the one or the other.
  toml::table parsed;
  try {
    parsed = toml::parse(std::string_view(text), file.string());
  } catch (const toml::parse_error& e) {
    return rt::Error{file.string() + ':' + std::to_string(e.source().begin.line) +
                     ": not TOML: " + std::string(e.description())};
  }
  Complaints complaints{file.string(), {}};
  Section root(&parsed, "", &complaints);
  Scenario out;
  out.name = file.stem().string();
  root.text("title", &out.title);
  root.real("max_duration_s", 1, 3600, &out.max_duration_s);
  read_world(root.table("world"), &out.world);
  read_flight(root.table("flight"), &out.trajectory);
  read_camera(root.table("camera"), &out.camera);
  read_sensor(root.table("sensor"), &out.sensor);
  read_imu(root.table("imu"), &out.imu);
  read_range(root.table("range"), &out.range);
  read_baro(root.table("baro"), &out.baro);
  read_attitude(root.table("attitude"), &out.attitude);
  Section gnss = root.table("gnss");
  gnss.flag("present", &out.gnss.present);
  gnss.real("rate_hz", 0.1, 50, &out.gnss.rate_hz);
  gnss.real("sigma_m", 0, 50, &out.gnss.sigma_m);
  gnss.real("lost_after_s", 0, 1e9, &out.gnss.lost_after_s);
  gnss.finish();
  Section faults = root.table("faults");
  faults.real("drop_share", 0, 0.9, &out.faults.drop_share);
  faults.real("gap_every_s", 0.1, 1e4, &out.faults.gap_every_s);
  faults.real("gap_s", 0, 1e3, &out.faults.gap_s);
  if (out.faults.gap_s > 0 && out.faults.gap_every_s <= out.faults.gap_s)
    faults.complain("gap_s", "must be shorter than gap_every_s");
  faults.finish();
  root.finish();
  if (!complaints.text.empty()) return rt::Error{complaints.text};
  return out;
}

std::vector<std::string> list_scenarios(const std::filesystem::path& folder) {
  std::vector<std::string> names;
  std::error_code missing;
  for (const auto& entry : std::filesystem::directory_iterator(folder, missing)) {
    if (entry.path().extension() == ".toml") names.push_back(entry.path().stem().string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

rt::Result<Scenario> find_scenario(const std::string& name, const std::filesystem::path& folder) {
  const std::vector<std::string> names = list_scenarios(folder);
  if (std::find(names.begin(), names.end(), name) != names.end()) return read_scenario(folder / (name + ".toml"));
  if (name.ends_with(".toml")) return read_scenario(name);
  std::string known;
  for (const std::string& n : names) known += (known.empty() ? "" : ", ") + n;
  if (known.empty()) return rt::Error{"no scenario '" + name + "': " + folder.string() + " holds none"};
  return rt::Error{"no scenario '" + name + "'; there are: " + known};
}

}  // namespace godwit::sim
