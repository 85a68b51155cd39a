// The DroneCAN data types of a node and of the tunnel. Field names and order are those of the DSDL definitions
// (dronecan/DSDL); a test recomputes each signature and length from their text.
#pragma once

#include <array>
#include <cstdint>

#include "firmware_app/link/dronecan/codec.h"
#include "firmware_app/link/dronecan/type_info.h"

namespace godwit::link::dronecan {

// ---- the node -------------------------------------------------------------------------------------------------------

enum class NodeHealth : std::uint8_t { kOk = 0, kWarning = 1, kError = 2, kCritical = 3 };
enum class NodeMode : std::uint8_t { kOperational = 0, kInitialization = 1, kMaintenance = 2, kOffline = 7 };

struct NodeStatus {
  static constexpr TypeInfo kType{"uavcan.protocol.NodeStatus", TransferKind::kMessage, 341, 0x0F0868D0C1A7C6F1, 7};
  std::uint32_t uptime_s = 0;
  std::uint8_t health = 0;
  std::uint8_t mode = 0;
  std::uint8_t sub_mode = 0;
  std::uint16_t vendor_code = 0;
  static void visit(auto& v, auto& s) {
    v.number("uptime_sec", s.uptime_s, 32);
    v.number("health", s.health, 2);
    v.number("mode", s.mode, 3);
    v.number("sub_mode", s.sub_mode, 3);
    v.number("vendor_specific_status_code", s.vendor_code, 16);
  }
};

struct GetNodeInfoRequest {
  static constexpr TypeInfo kType{"uavcan.protocol.GetNodeInfo", TransferKind::kRequest, 1, 0xEE468A8121C46A9E, 0};
  static void visit(auto&, auto&) {}
};

struct SoftwareVersion {
  static constexpr std::uint8_t kHasVcsCommit = 1;
  std::uint8_t major = 0;
  std::uint8_t minor = 0;
  std::uint8_t flags = 0;
  std::uint32_t vcs_commit = 0;
  std::uint64_t image_crc = 0;
  static void visit(auto& v, auto& s) {
    v.number("major", s.major, 8);
    v.number("minor", s.minor, 8);
    v.number("optional_field_flags", s.flags, 8);
    v.number("vcs_commit", s.vcs_commit, 32);
    v.number("image_crc", s.image_crc, 64);
  }
};

using UniqueId = std::array<std::uint8_t, 16>;

struct HardwareVersion {
  std::uint8_t major = 0;
  std::uint8_t minor = 0;
  UniqueId unique_id{};
  Bytes<255> certificate;
  static void visit(auto& v, auto& s) {
    v.number("major", s.major, 8);
    v.number("minor", s.minor, 8);
    for (auto& byte : s.unique_id) v.number("unique_id", byte, 8);
    v.bytes("certificate_of_authenticity", s.certificate, Tail::kNo);
  }
};

struct GetNodeInfoResponse {
  static constexpr TypeInfo kType{"uavcan.protocol.GetNodeInfo", TransferKind::kResponse, 1, 0xEE468A8121C46A9E, 377};
  NodeStatus status;
  SoftwareVersion software;
  HardwareVersion hardware;
  Bytes<80> name;
  static void visit(auto& v, auto& s) {
    v.nested("status", s.status);
    v.nested("software_version", s.software);
    v.nested("hardware_version", s.hardware);
    v.bytes("name", s.name, Tail::kYes);
  }
};

struct GetTransportStatsRequest {
  static constexpr TypeInfo kType{"uavcan.protocol.GetTransportStats", TransferKind::kRequest, 4, 0xBE6F76A7EC312B04,
                                  0};
  static void visit(auto&, auto&) {}
};

struct CanInterfaceStats {
  std::uint64_t frames_tx = 0;
  std::uint64_t frames_rx = 0;
  std::uint64_t errors = 0;
  static void visit(auto& v, auto& s) {
    v.number("frames_tx", s.frames_tx, 48);
    v.number("frames_rx", s.frames_rx, 48);
    v.number("errors", s.errors, 48);
  }
};

struct GetTransportStatsResponse {
  static constexpr TypeInfo kType{"uavcan.protocol.GetTransportStats", TransferKind::kResponse, 4, 0xBE6F76A7EC312B04,
                                  73};
  std::uint64_t transfers_tx = 0;
  std::uint64_t transfers_rx = 0;
  std::uint64_t transfer_errors = 0;
  List<CanInterfaceStats, 3> interfaces;
  static void visit(auto& v, auto& s) {
    v.number("transfers_tx", s.transfers_tx, 48);
    v.number("transfers_rx", s.transfers_rx, 48);
    v.number("transfer_errors", s.transfer_errors, 48);
    v.list("can_iface_stats", s.interfaces, Tail::kYes, 144,
           [](auto& w, auto& item) { w.nested("can_iface_stats", item); });
  }
};

struct RestartNodeRequest {
  static constexpr TypeInfo kType{"uavcan.protocol.RestartNode", TransferKind::kRequest, 5, 0x569E05394A3017F0, 5};
  static constexpr std::uint64_t kMagic = 0xACCE551B1E;
  std::uint64_t magic = 0;
  static void visit(auto& v, auto& s) { v.number("magic_number", s.magic, 40); }
};

struct RestartNodeResponse {
  static constexpr TypeInfo kType{"uavcan.protocol.RestartNode", TransferKind::kResponse, 5, 0x569E05394A3017F0, 1};
  bool ok = false;
  static void visit(auto& v, auto& s) { v.boolean("ok", s.ok); }
};

struct ExecuteOpcodeRequest {
  static constexpr TypeInfo kType{"uavcan.protocol.param.ExecuteOpcode", TransferKind::kRequest, 10, 0x3B131AC5EB69D2CD,
                                  7};
  static constexpr std::uint8_t kSave = 0;
  static constexpr std::uint8_t kErase = 1;
  std::uint8_t opcode = 0;
  std::int64_t argument = 0;
  static void visit(auto& v, auto& s) {
    v.number("opcode", s.opcode, 8);
    v.number("argument", s.argument, 48);
  }
};

struct ExecuteOpcodeResponse {
  static constexpr TypeInfo kType{"uavcan.protocol.param.ExecuteOpcode", TransferKind::kResponse, 10,
                                  0x3B131AC5EB69D2CD, 7};
  std::int64_t argument = 0;
  bool ok = false;
  static void visit(auto& v, auto& s) {
    v.number("argument", s.argument, 48);
    v.boolean("ok", s.ok);
  }
};

/// Value of a parameter on the bus: a union of which `tag` says the member.
struct Value {
  enum Tag : std::uint8_t { kEmpty = 0, kInteger = 1, kReal = 2, kBoolean = 3, kString = 4, kTags = 5 };
  std::uint8_t tag = kEmpty;
  std::int64_t integer = 0;
  float real = 0;
  std::uint8_t boolean = 0;
  Bytes<128> text;
  static void visit(auto& v, auto& s) {
    v.number("tag", s.tag, 3);
    if (s.tag == kInteger) v.number("integer_value", s.integer, 64);
    if (s.tag == kReal) v.single("real_value", s.real);
    if (s.tag == kBoolean) v.number("boolean_value", s.boolean, 8);
    if (s.tag == kString) {
      v.bytes("string_value", s.text, Tail::kNo);
    }
  }
};

/// Limit of a parameter on the bus.
struct NumericValue {
  std::uint8_t tag = Value::kEmpty;
  std::int64_t integer = 0;
  float real = 0;
  static void visit(auto& v, auto& s) {
    v.number("tag", s.tag, 2);
    if (s.tag == Value::kInteger) v.number("integer_value", s.integer, 64);
    if (s.tag == Value::kReal) v.single("real_value", s.real);
  }
};

struct GetSetRequest {
  static constexpr TypeInfo kType{"uavcan.protocol.param.GetSet", TransferKind::kRequest, 11, 0xA7B622F939D1A4D5, 224};
  std::uint16_t index = 0;
  Value value;
  Bytes<92> name;
  static void visit(auto& v, auto& s) {
    v.number("index", s.index, 13);
    v.nested("value", s.value);
    v.bytes("name", s.name, Tail::kYes);
  }
};

struct GetSetResponse {
  static constexpr TypeInfo kType{"uavcan.protocol.param.GetSet", TransferKind::kResponse, 11, 0xA7B622F939D1A4D5, 371};
  Value value;
  Value default_value;
  NumericValue max_value;
  NumericValue min_value;
  Bytes<92> name;
  static void visit(auto& v, auto& s) {
    v.padding(5);
    v.nested("value", s.value);
    v.padding(5);
    v.nested("default_value", s.default_value);
    v.padding(6);
    v.nested("max_value", s.max_value);
    v.padding(6);
    v.nested("min_value", s.min_value);
    v.bytes("name", s.name, Tail::kYes);
  }
};

struct BeginFirmwareUpdateRequest {
  static constexpr TypeInfo kType{"uavcan.protocol.file.BeginFirmwareUpdate", TransferKind::kRequest, 40,
                                  0xB7D725DF72724126, 202};
  std::uint8_t source_node_id = 0;
  Bytes<200> path;
  static void visit(auto& v, auto& s) {
    v.number("source_node_id", s.source_node_id, 8);
    v.bytes("path", s.path, Tail::kYes);
  }
};

struct BeginFirmwareUpdateResponse {
  static constexpr TypeInfo kType{"uavcan.protocol.file.BeginFirmwareUpdate", TransferKind::kResponse, 40,
                                  0xB7D725DF72724126, 129};
  static constexpr std::uint8_t kInvalidMode = 1;
  std::uint8_t error = 0;
  Bytes<127> text;
  static void visit(auto& v, auto& s) {
    v.number("error", s.error, 8);
    v.bytes("optional_error_message", s.text, Tail::kYes);
  }
};

struct LogMessage {
  static constexpr TypeInfo kType{"uavcan.protocol.debug.LogMessage", TransferKind::kMessage, 16383, 0xD654A48E0C049D75,
                                  123};
  enum Level : std::uint8_t { kDebug = 0, kInfo = 1, kWarning = 2, kError = 3 };
  std::uint8_t level = 0;
  Bytes<31> source;
  Bytes<90> text;
  static void visit(auto& v, auto& s) {
    v.number("level", s.level, 3);
    v.bytes("source", s.source, Tail::kNo);
    v.bytes("text", s.text, Tail::kYes);
  }
};

struct Allocation {
  static constexpr TypeInfo kType{"uavcan.protocol.dynamic_node_id.Allocation", TransferKind::kMessage, 1,
                                  0x0B2A812620A11D40, 18};
  std::uint8_t node_id = 0;
  bool first_part = false;
  Bytes<16> unique_id;
  static void visit(auto& v, auto& s) {
    v.number("node_id", s.node_id, 7);
    v.boolean("first_part_of_unique_id", s.first_part);
    v.bytes("unique_id", s.unique_id, Tail::kYes);
  }
};

// ---- the tunnel -----------------------------------------------------------------------------------------------------

enum class TunnelProtocol : std::uint8_t { kMavlink = 0, kMavlink2 = 1, kUndefined = 255 };

struct TunnelTargetted {
  static constexpr TypeInfo kType{"uavcan.tunnel.Targetted", TransferKind::kMessage, 3001, 0xB138E7EA72A2A2E9, 127};
  static constexpr std::uint8_t kLockPort = 1;
  static constexpr std::size_t kMaxBuffer = 120;
  std::uint8_t protocol = 0;
  std::uint8_t target_node = 0;
  std::int8_t serial_id = 0;
  std::uint8_t options = 0;
  std::uint32_t baudrate = 0;
  Bytes<kMaxBuffer> buffer;
  static void visit(auto& v, auto& s) {
    v.number("protocol", s.protocol, 8);
    v.number("target_node", s.target_node, 7);
    v.number("serial_id", s.serial_id, 5);
    v.number("options", s.options, 4);
    v.number("baudrate", s.baudrate, 24);
    v.bytes("buffer", s.buffer, Tail::kYes);
  }
};

struct TunnelBroadcast {
  static constexpr TypeInfo kType{"uavcan.tunnel.Broadcast", TransferKind::kMessage, 2010, 0x5AA2D4D9CF4B1E85, 63};
  std::uint8_t protocol = 0;
  std::uint8_t channel_id = 0;
  Bytes<60> buffer;
  static void visit(auto& v, auto& s) {
    v.number("protocol", s.protocol, 8);
    v.number("channel_id", s.channel_id, 8);
    v.bytes("buffer", s.buffer, Tail::kYes);
  }
};

}  // namespace godwit::link::dronecan
