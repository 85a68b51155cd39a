#include "firmware_app/link/dronecan_node.h"

#include <algorithm>
#include <cmath>

namespace godwit::link::dronecan {
namespace {

constexpr std::uint8_t kStatusPriority = 20;
constexpr std::uint8_t kLogPriority = 30;
constexpr std::uint8_t kAllocationPriority = 30;
constexpr rt::TimeNs kStatusPeriodNs = rt::kNsPerSecond;
constexpr rt::TimeNs kMinStatusGapNs = 20 * rt::kNsPerMs;
constexpr rt::TimeNs kRestartDelayNs = 200 * rt::kNsPerMs;
constexpr rt::TimeNs kOpcodePatienceNs = 400 * rt::kNsPerMs;  // askers give up after half a second

Value to_value(Parameter p, std::int64_t number) {
  Value v;
  if (info(p).type == ParameterType::kBoolean) {
    v.tag = Value::kBoolean;
    v.boolean = number != 0 ? 1 : 0;
  } else {
    v.tag = Value::kInteger;
    v.integer = number;
  }
  return v;
}

NumericValue limit(Parameter p, std::int64_t number) {
  NumericValue v;  // booleans have no limits
  if (info(p).type == ParameterType::kInteger) {
    v.tag = Value::kInteger;
    v.integer = number;
  }
  return v;
}

}  // namespace

Node::Node(NodeIdentity identity, bool fd, ParameterSet* parameters, Storage* storage, TxQueue* queue, WriteRules rules)
    : identity_(std::move(identity)),
      fd_(fd),
      parameters_(parameters),
      storage_(storage),
      queue_(queue),
      rules_(std::move(rules)),
      allocation_(identity_.unique_id, 0),
      node_id_(static_cast<std::uint8_t>(parameters->get(Parameter::kNodeId))) {}

std::vector<TypeInfo> Node::accepted_types() {
  return {GetNodeInfoRequest::kType, GetTransportStatsRequest::kType, RestartNodeRequest::kType,
          GetSetRequest::kType,      ExecuteOpcodeRequest::kType,     BeginFirmwareUpdateRequest::kType,
          Allocation::kType};
}

template <typename T>
void Node::respond(const T& response, const Transfer& request, rt::TimeNs now_ns) {
  std::array<std::uint8_t, kMaxPayload> payload;
  Transfer t;
  t.kind = TransferKind::kResponse;
  t.type_id = T::kType.id;
  t.priority = request.priority;
  t.source = node_id_;
  t.destination = request.source;
  t.transfer_id = request.transfer_id;
  t.fd = request.fd;  // whoever asks in classic frames may not understand others
  t.payload = {payload.data(), encode(response, payload, t.fd)};
  if (!queue_->begin(TxClass::kService, now_ns)) return;
  queue_->add(t, T::kType.signature, nullptr);
  queue_->commit();
}

// Decodes a request and answers it with what `answer` makes of it.
template <typename Request, typename Answer>
void Node::serve(const Transfer& transfer, rt::TimeNs now_ns, Answer answer) {
  Request request;
  if (!decode(transfer.payload, transfer.fd, &request)) {
    ++counters_.malformed;
    return;
  }
  respond(answer(request), transfer, now_ns);
}

void Node::handle(const Transfer& transfer, rt::TimeNs now_ns, bool armed) {
  if (transfer.kind == TransferKind::kMessage) {
    Allocation message;
    if (transfer.type_id != Allocation::kType.id) return;
    if (!decode(transfer.payload, transfer.fd, &message)) {
      ++counters_.malformed;
      return;
    }
    if (node_id_ == 0) {
      allocation_.take(message, transfer.source, now_ns);
      node_id_ = allocation_.node_id();
    }
    return;
  }
  if (transfer.kind != TransferKind::kRequest || node_id_ == 0) return;
  ++counters_.requests;
  switch (transfer.type_id) {
    case GetNodeInfoRequest::kType.id:
      serve<GetNodeInfoRequest>(transfer, now_ns, [&](const auto&) { return node_info(); });
      break;
    case GetTransportStatsRequest::kType.id:
      serve<GetTransportStatsRequest>(transfer, now_ns, [&](const auto&) { return transport_stats(); });
      break;
    case GetSetRequest::kType.id:
      serve<GetSetRequest>(transfer, now_ns, [&](const GetSetRequest& r) {
        return get_set(r, r.value.tag == Value::kEmpty || may_write(transfer.source, armed));
      });
      break;
    case RestartNodeRequest::kType.id:
      serve<RestartNodeRequest>(transfer, now_ns, [&](const RestartNodeRequest& r) {
        RestartNodeResponse response;
        response.ok = r.magic == RestartNodeRequest::kMagic && may_write(transfer.source, armed);
        if (response.ok) restart_at_ns_ = now_ns + kRestartDelayNs;
        return response;
      });
      break;
    case BeginFirmwareUpdateRequest::kType.id:
      serve<BeginFirmwareUpdateRequest>(transfer, now_ns, [](const auto&) {
        BeginFirmwareUpdateResponse response;
        response.error = BeginFirmwareUpdateResponse::kInvalidMode;
        assign(&response.text, "this node is updated through its operating system, not over the bus");
        return response;
      });
      break;
    case ExecuteOpcodeRequest::kType.id: {
      ExecuteOpcodeRequest request;
      if (decode(transfer.payload, transfer.fd, &request)) {
        execute_opcode(request, transfer, now_ns, may_write(transfer.source, armed));
      } else {
        ++counters_.malformed;
      }
      break;
    }
    default:
      break;
  }
}

GetNodeInfoResponse Node::node_info() const {
  GetNodeInfoResponse r;
  r.status = status_;
  r.software.major = identity_.software_major;
  r.software.minor = identity_.software_minor;
  r.software.flags = identity_.vcs_commit != 0 ? SoftwareVersion::kHasVcsCommit : 0;
  r.software.vcs_commit = identity_.vcs_commit;
  r.hardware.major = 1;
  r.hardware.unique_id = identity_.unique_id;
  assign(&r.name, identity_.name);
  return r;
}

GetTransportStatsResponse Node::transport_stats() const {
  GetTransportStatsResponse r;
  r.transfers_tx = queue_->counters().transfers;
  r.transfers_rx = transfers_rx_;
  r.transfer_errors = transfer_errors_;
  r.interfaces.size = 1;
  r.interfaces.item[0].frames_tx = bus_counters_.sent;
  r.interfaces.item[0].frames_rx = bus_counters_.received;
  r.interfaces.item[0].errors = bus_counters_.error_frames + bus_counters_.send_failed + bus_counters_.receive_failed +
                                bus_counters_.receive_malformed + bus_counters_.receive_overflow;
  return r;
}

// Integers are taken for booleans and whole numbers in real form for integers, as ground stations send them; the limits
// hold for all. False: nothing changed.
bool Node::take_value(Parameter p, const Value& value) {
  switch (value.tag) {
    case Value::kInteger:
      return parameters_->set(p, value.integer);
    case Value::kBoolean:
      return info(p).type == ParameterType::kBoolean && value.boolean <= 1 && parameters_->set(p, value.boolean);
    case Value::kReal: {
      // Beyond 2^24 not every whole number is a float, and no limit of ours lies there.
      const bool whole =
          std::isfinite(value.real) && std::abs(value.real) < 16777216.0F && std::trunc(value.real) == value.real;
      return whole && parameters_->set(p, static_cast<std::int64_t>(value.real));
    }
    default:
      return false;
  }
}

bool Node::may_write(std::uint8_t node, bool armed) {
  const bool allowed = rules_.allow(node);
  if (!allowed) {
    ++counters_.refused_source;
  } else if (armed) {
    ++counters_.refused_armed;
  }
  return allowed && !armed;
}

GetSetResponse Node::get_set(const GetSetRequest& request, bool may_write) {
  GetSetResponse r;
  const Parameter p = request.name.size > 0 ? ParameterSet::find(text_of(request.name))
                                            : static_cast<Parameter>(std::min<std::size_t>(request.index, kParameters));
  if (p == Parameter::kCount) return r;  // an unknown one: everything empty
  if (request.value.tag != Value::kEmpty && may_write && !take_value(p, request.value)) ++counters_.refused_value;
  // The value in force tells the asker whether it was taken.
  r.value = to_value(p, parameters_->get(p));
  r.default_value = to_value(p, parameters_->default_of(p));
  r.max_value = limit(p, info(p).max);
  r.min_value = limit(p, info(p).min);
  assign(&r.name, info(p).name);
  return r;
}

void Node::execute_opcode(const ExecuteOpcodeRequest& request, const Transfer& transfer, rt::TimeNs now_ns,
                          bool may_write) {
  StorageRequest storage;
  storage.kind = request.opcode == ExecuteOpcodeRequest::kErase ? StorageRequest::Kind::kEraseParameters
                                                                : StorageRequest::Kind::kSaveParameters;
  storage.ticket = opcode_ticket_ + 1;
  storage.parameters = parameters_->values();
  storage.parameters[static_cast<std::size_t>(Parameter::kSendOrigin)] = 0;
  for (std::size_t i = 0; i < kParameters; ++i) {
    storage.defaults[i] = parameters_->default_of(static_cast<Parameter>(i));
  }
  const bool known = request.opcode == ExecuteOpcodeRequest::kSave || request.opcode == ExecuteOpcodeRequest::kErase;
  if (!known || !may_write || opcode_waits_ || !storage_->request(storage)) {
    respond(ExecuteOpcodeResponse{}, transfer, now_ns);
    return;
  }
  opcode_waits_ = true;
  ++opcode_ticket_;
  opcode_deadline_ns_ = now_ns + kOpcodePatienceNs;
  opcode_request_ = transfer;
  opcode_request_.payload = {};
  if (storage.kind == StorageRequest::Kind::kEraseParameters) parameters_->restore_defaults();
}

void Node::finish_opcode(bool ok, rt::TimeNs now_ns) {
  opcode_waits_ = false;
  ExecuteOpcodeResponse response;
  response.ok = ok;
  respond(response, opcode_request_, now_ns);
}

void Node::allocate(rt::TimeNs now_ns) {
  Allocation request;
  if (!allocation_.step(now_ns, &request)) return;
  std::array<std::uint8_t, kMaxPayload> payload;
  Transfer t;
  t.type_id = Allocation::kType.id;
  t.priority = kAllocationPriority;
  t.payload = {payload.data(), encode(request, payload, false)};
  if (!queue_->begin(TxClass::kFlight, now_ns)) return;
  queue_->add(t, Allocation::kType.signature, &allocation_transfer_id_);
  queue_->commit();
}

void Node::step(rt::TimeNs now_ns, const NodeCondition& condition, const ReassemblyCounters& reception,
                const hal::CanCounters& bus) {
  if (!started_) {
    started_ = true;
    t_start_ns_ = now_ns;
    t_status_ns_ = now_ns - kStatusPeriodNs;
  }
  transfers_rx_ = reception.transfers;
  transfer_errors_ = reception.errors();
  bus_counters_ = bus;
  StorageReply reply;
  while (storage_->reply(&reply)) {
    if (opcode_waits_ && reply.ticket == opcode_ticket_) finish_opcode(reply.ok, now_ns);
  }
  if (opcode_waits_ && now_ns > opcode_deadline_ns_) finish_opcode(false, now_ns);
  status_.uptime_s = static_cast<std::uint32_t>((now_ns - t_start_ns_) / rt::kNsPerSecond);
  status_.health = static_cast<std::uint8_t>(condition.health);
  status_.mode = static_cast<std::uint8_t>(condition.mode);
  status_.vendor_code = condition.reasons;
  if (node_id_ == 0) {
    allocate(now_ns);
    return;
  }
  const rt::TimeNs since = now_ns - t_status_ns_;
  // What becomes worse is told at once. What becomes better keeps the distance, which bounds both.
  const bool worse = condition.health > condition_.health;
  if (since >= kStatusPeriodNs || worse || (condition != condition_ && since >= kMinStatusGapNs)) {
    condition_ = condition;
    t_status_ns_ = since >= kStatusPeriodNs && since < 2 * kStatusPeriodNs ? t_status_ns_ + kStatusPeriodNs : now_ns;
    broadcast(status_, TxClass::kFlight, kStatusPriority, &status_transfer_id_, now_ns);
  }
}

void Node::log(LogMessage::Level level, std::string_view text, rt::TimeNs now_ns) {
  LogMessage message;
  message.level = level;
  assign(&message.source, "godwit");
  assign(&message.text, text);
  broadcast(message, TxClass::kService, kLogPriority, &log_transfer_id_, now_ns);
}

}  // namespace godwit::link::dronecan
