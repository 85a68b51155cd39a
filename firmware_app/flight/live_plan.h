// From a configuration to the flight log and to the socket that others look at a flight by. What every program that
// flies shares.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "firmware_app/config/config.h"
#include "firmware_app/output/flight_log.h"
#include "firmware_app/output/live_picture.h"
#include "firmware_app/output/live_server.h"
#include "firmware_app/output/live_status.h"
#include "firmware_app/output/live_track.h"

namespace godwit::app {

/// What whoever looks is shown (docs/live.md); fed by the sink of the flight.
struct Live {
  LiveStatus status;
  LiveTrack track;
};

using Say = std::function<void(const std::string&)>;

/// Null: none is wanted, or nowhere to write it.
std::unique_ptr<FlightLog> begin_flight_log(const Config& config, const Say& say);

/// The same in a folder of one's own, whatever is configured; nobody but the disc limits it.
std::unique_ptr<FlightLog> begin_flight_log_in(const std::string& folder, const Config& config);

/// What the tracker leaves for those who look; null: nobody may. Before the odometry is made.
std::unique_ptr<LivePicture> live_picture(const Config& config, int width, int height);

/// Null: nobody may look, or it cannot be had, which grounds nobody. picture: of live_picture(); both outlive it.
/// abandon: see LiveServerOptions.
std::unique_ptr<LiveServer> begin_live(const Config& config, Live* live, LivePicture* picture, const Say& say,
                                       std::function<void(const char*)> abandon);

}  // namespace godwit::app
