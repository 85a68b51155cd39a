// A well-behaved DroneCAN node: says how it is, who it is, what can be set; refuses what must not happen in flight.
#pragma once

#include <algorithm>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "firmware_app/link/dronecan/allocation_client.h"
#include "firmware_app/link/dronecan/transfer.h"
#include "firmware_app/link/dronecan/types.h"
#include "firmware_app/link/parameters.h"
#include "firmware_app/link/storage.h"
#include "firmware_app/link/tx_queue.h"

namespace godwit::link::dronecan {

struct NodeIdentity {
  std::string name = "org.godwit.vio";
  UniqueId unique_id{};
  std::uint8_t software_major = 0;
  std::uint8_t software_minor = 1;
  std::uint32_t vcs_commit = 0;  ///< 0: not known
};

/// What NodeStatus says.
struct NodeCondition {
  NodeHealth health = NodeHealth::kOk;
  NodeMode mode = NodeMode::kInitialization;
  std::uint16_t reasons = 0;  ///< vendor code: bit mask of link::Reason
  bool operator==(const NodeCondition&) const = default;
};

/// Who may change us over the bus: set, save, erase, restart.
struct WriteRules {
  bool locked = false;                     ///< nobody
  std::vector<std::uint8_t> only_nodes{};  ///< empty: any node
  bool allow(std::uint8_t node) const {
    return !locked && (only_nodes.empty() || std::find(only_nodes.begin(), only_nodes.end(), node) != only_nodes.end());
  }
};

/// Counts that GetTransportStats tells, besides those of the queue and of reception.
struct NodeCounters {
  std::uint64_t requests = 0;
  std::uint64_t refused_armed = 0;   ///< restart, erase, save or set while the vehicle was armed
  std::uint64_t refused_source = 0;  ///< the same by a node that may not, or locked by the configuration
  std::uint64_t refused_value = 0;   ///< parameter values outside their limits or of a wrong type
  std::uint64_t malformed = 0;       ///< transfers whose payload was too short or too long for the type
};

/// One thread; time is an argument; no allocation after construction.
class Node {
 public:
  Node(NodeIdentity identity, bool fd, ParameterSet* parameters, Storage* storage, TxQueue* queue,
       WriteRules rules = {});

  /// Types to be given to handle().
  static std::vector<TypeInfo> accepted_types();
  /// 0 while the allocator has not answered.
  std::uint8_t node_id() const { return node_id_; }
  /// Takes a transfer of accepted_types(). armed: the vehicle is armed now.
  void handle(const Transfer& transfer, rt::TimeNs now_ns, bool armed);
  /// NodeStatus each second and at once when the condition changes; allocation; answers that waited for storage.
  void step(rt::TimeNs now_ns, const NodeCondition& condition, const ReassemblyCounters& reception,
            const hal::CanCounters& bus);
  /// uavcan.protocol.debug.LogMessage; texts above 90 characters are cut.
  void log(LogMessage::Level level, std::string_view text, rt::TimeNs now_ns);
  /// A message of ours, under our id; nothing while we have none.
  template <typename T>
  void broadcast(const T& value, TxClass tx_class, std::uint8_t priority, std::uint8_t* transfer_id, rt::TimeNs now_ns);

  /// RestartNode was accepted and its answer has had time to leave.
  bool restart_due(rt::TimeNs now_ns) const { return restart_at_ns_ != 0 && now_ns >= restart_at_ns_; }
  const NodeCounters& counters() const { return counters_; }

 private:
  template <typename Request, typename Answer>
  void serve(const Transfer& transfer, rt::TimeNs now_ns, Answer answer);
  template <typename T>
  void respond(const T& response, const Transfer& request, rt::TimeNs now_ns);

  GetNodeInfoResponse node_info() const;
  GetTransportStatsResponse transport_stats() const;
  GetSetResponse get_set(const GetSetRequest& request, bool may_write);
  /// Counts the refusal.
  bool may_write(std::uint8_t node, bool armed);
  void execute_opcode(const ExecuteOpcodeRequest& request, const Transfer& transfer, rt::TimeNs now_ns, bool may_write);
  void finish_opcode(bool ok, rt::TimeNs now_ns);
  bool take_value(Parameter p, const Value& value);
  void allocate(rt::TimeNs now_ns);

  NodeIdentity identity_;
  bool fd_;
  ParameterSet* parameters_;
  Storage* storage_;
  TxQueue* queue_;
  WriteRules rules_;
  AllocationClient allocation_;
  std::uint8_t node_id_;
  NodeStatus status_;
  NodeCondition condition_;
  bool started_ = false;
  rt::TimeNs t_start_ns_ = 0;
  rt::TimeNs t_status_ns_ = 0;
  rt::TimeNs restart_at_ns_ = 0;
  std::uint8_t status_transfer_id_ = 0;
  std::uint8_t log_transfer_id_ = 0;
  std::uint8_t allocation_transfer_id_ = 0;
  // The one opcode that waits for the storage thread.
  bool opcode_waits_ = false;
  std::uint32_t opcode_ticket_ = 0;
  rt::TimeNs opcode_deadline_ns_ = 0;
  Transfer opcode_request_;
  std::uint64_t transfers_rx_ = 0, transfer_errors_ = 0;
  hal::CanCounters bus_counters_;
  NodeCounters counters_;
};

template <typename T>
void Node::broadcast(const T& value, TxClass tx_class, std::uint8_t priority, std::uint8_t* transfer_id,
                     rt::TimeNs now_ns) {
  if (node_id_ == 0) return;
  std::array<std::uint8_t, kMaxPayload> payload;
  Transfer t;
  t.type_id = T::kType.id;
  t.priority = priority;
  t.source = node_id_;
  t.fd = fd_;
  t.payload = {payload.data(), encode(value, payload, fd_)};
  if (!queue_->begin(tx_class, now_ns)) return;
  queue_->add(t, T::kType.signature, transfer_id);
  queue_->commit();
}

}  // namespace godwit::link::dronecan
