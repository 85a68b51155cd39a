// What people have that is no sequence yet: a video, or a folder of KITTI's odometry benchmark.
#pragma once

#include <atomic>
#include <string>

#include "hal/rt/result.h"

namespace godwit::app {

/// A video's camera; one of the two is needed, and for nothing else.
struct VideoCamera {
  std::string calibration;  ///< camera.yaml of the video's size
  double fov_deg = 0;       ///< horizontal field of view of a pinhole, for a first look; 0: not told
};

/// The folder to fly: `sequence` itself where it is one or nothing is known of it; else OUT/sequence, made anew by
/// from_video or from_kitti, which come with godwit, where nothing or what an earlier run made is there. Those tell
/// what they do and what is wrong on the error stream; in the error of the result it is in a word. Runs a program and
/// waits for it; *stop ends it.
rt::Result<std::string> as_sequence(const std::string& sequence, const VideoCamera& camera, const std::string& out,
                                    const std::atomic<bool>& stop);

}  // namespace godwit::app
