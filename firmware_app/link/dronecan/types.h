// All the DroneCAN data types godwit sends or takes.
#pragma once

#include "firmware_app/link/dronecan/node_types.h"    // IWYU pragma: export
#include "firmware_app/link/dronecan/sensor_types.h"  // IWYU pragma: export

namespace godwit::link::dronecan {

/// Calls `f.template operator()<Type>()` for every type.
template <typename F>
void for_each_type(F&& f) {
  f.template operator()<NodeStatus>();
  f.template operator()<GetNodeInfoRequest>();
  f.template operator()<GetNodeInfoResponse>();
  f.template operator()<GetTransportStatsRequest>();
  f.template operator()<GetTransportStatsResponse>();
  f.template operator()<RestartNodeRequest>();
  f.template operator()<RestartNodeResponse>();
  f.template operator()<ExecuteOpcodeRequest>();
  f.template operator()<ExecuteOpcodeResponse>();
  f.template operator()<GetSetRequest>();
  f.template operator()<GetSetResponse>();
  f.template operator()<BeginFirmwareUpdateRequest>();
  f.template operator()<BeginFirmwareUpdateResponse>();
  f.template operator()<LogMessage>();
  f.template operator()<Allocation>();
  f.template operator()<TunnelTargetted>();
  f.template operator()<TunnelBroadcast>();
  f.template operator()<RangeMeasurement>();
  f.template operator()<FlowMeasurement>();
  f.template operator()<RawImu>();
  f.template operator()<AhrsSolution>();
  f.template operator()<StaticPressure>();
  f.template operator()<GlobalTimeSync>();
  f.template operator()<ArmingStatus>();
}

}  // namespace godwit::link::dronecan
