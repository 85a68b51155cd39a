// From light to grey values: motion blur, exposure, glare, flicker, vignetting, noise, 8 bits.
#pragma once

#include <cstdint>
#include <vector>

#include "hal/rt/image.h"
#include "hal/sim/render/renderer.h"

namespace godwit::sim {

/// A change of the camera's gain at a time, as by a clumsy exposure control.
struct GainStep {
  double t_s = 0, factor = 1;
};

struct SensorModel {
  double exposure_ms = 3;      ///< length of the motion blur
  double gain = 1;             ///< fixed part: 1 shows flat ground in the sun as painted
  bool auto_exposure = false;  ///< the gain follows the picture's mean towards mean_target
  double mean_target = 110;
  double read_noise = 1.0;   ///< one sigma at black [grey levels]
  double shot_noise = 0.02;  ///< variance a grey level
  double vignetting = 0.15;  ///< loss of light in the corners
  double glare = 0;          ///< veil of the sun in or near the picture [grey levels at its centre]
  double flicker_hz = 0;     ///< lamps on the mains: frequency of the light, twice the mains'
  double flicker_depth = 0;  ///< 0..1
  std::vector<GainStep> gain_steps;
};

/// Turns renderings into pictures; remembers the exposure. One thread.
class Sensor {
 public:
  Sensor(const SensorModel& model, const CameraRig& rig, const Vec3& sun_world, std::uint64_t seed);
  /// The exposure control alone, of a picture that nobody takes: a camera's does not stop for that. No allocation.
  void control(const Renderer& scene, double t_s);
  /// Picture number `index`, its middle row exposed at t_s, into grey, which has the lens's size. No allocation.
  void expose(const Renderer& scene, double t_s, std::uint32_t index, const rt::MutableImageView& grey);
  /// Gain of the newest picture.
  double gain() const { return gain_; }

 private:
  void blur(const Renderer& scene);
  double mean_of(const Renderer& scene) const;

  SensorModel model_;
  CameraRig rig_;
  Vec3 sun_world_;
  std::uint64_t seed_;
  double gain_ = 0;    ///< of the exposure control
  double wanted_ = 0;  ///< with what the scenario makes of it
  std::vector<float> blurred_, veil_, noise_;
};

}  // namespace godwit::sim
