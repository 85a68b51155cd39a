// From a configuration to the event recorder. What every program that flies shares.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "firmware_app/config/config.h"
#include "firmware_app/output/event_recorder.h"
#include "hal/camera/calibration.h"
#include "hal/rt/frame_pool.h"
#include "hal/rt/result.h"

namespace godwit::app {

/// Where godwitd writes events; empty: none are wanted, or there is nowhere.
std::string events_folder(const Config& config);

/// live: at real pace. Error: see EventRecorder::start.
rt::Result<std::unique_ptr<EventRecorder>> start_recorder(const Config& config, const std::string& folder,
                                                          const hal::CameraCalibration& calibration,
                                                          rt::FramePool* pool, bool live,
                                                          std::function<void(const std::string&)> say,
                                                          std::function<void(const char*)> abandon);

/// godwitd's: null where the folder is empty, and where it cannot be had, which is told: that grounds nobody.
std::unique_ptr<EventRecorder> begin_recorder(const Config& config, const std::string& folder,
                                              const hal::CameraCalibration& calibration, rt::FramePool* pool,
                                              const std::function<void(const std::string&)>& say,
                                              std::function<void(const char*)> abandon);

/// "2 events written, 0 not, ..": no word that a look for trouble in the journal would find.
std::string recorder_words(const EventReport& report);

}  // namespace godwit::app
