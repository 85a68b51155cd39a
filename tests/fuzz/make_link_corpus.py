#!/usr/bin/env python3
"""Writes the inputs that fuzz_dronecan, fuzz_mavlink and fuzz_link start from, made by pydronecan and pymavlink:

    .venv/bin/python tests/fuzz/make_link_corpus.py tests/fuzz/corpus
"""
import os
import random
import struct
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "link"))
from codec_compare import DRONECAN_TYPES, MAVLINK_MESSAGES, DronecanPeer, MavlinkPeer  # noqa: E402

LINK_TYPES = ["uavcan.tunnel.Targetted", "uavcan.protocol.param.GetSet", "uavcan.protocol.param.ExecuteOpcode",
              "uavcan.protocol.RestartNode", "uavcan.equipment.safety.ArmingStatus",
              "uavcan.equipment.range_sensor.Measurement", "uavcan.equipment.ahrs.RawIMU",
              "uavcan.equipment.air_data.StaticPressure", "uavcan.protocol.GlobalTimeSync",
              "uavcan.protocol.file.BeginFirmwareUpdate", "uavcan.protocol.NodeStatus"]


def write(folder, name, data):
    os.makedirs(folder, exist_ok=True)
    with open(os.path.join(folder, name), "wb") as f:
        f.write(data)


def main():
    root = sys.argv[1]
    rng = random.Random(5)
    peer, mav = DronecanPeer(), MavlinkPeer()
    everything = list(peer.types)
    for index, (name, mode) in enumerate(DRONECAN_TYPES):
        peer.types = [everything[index]]
        line, _, frames, fd = peer.make(rng)
        data = b""
        for frame in frames:
            can_id, payload = int(frame[:8], 16), bytes.fromhex(frame[9:])
            if can_id & 0x80:  # services go to node 42
                can_id = can_id & ~0x7F00 | 42 << 8
            data += bytes([1 if fd else 0, len(payload)]) + struct.pack("<I", can_id) + payload
        write(os.path.join(root, "fuzz_dronecan"), "%s%s" % (name, "." + mode if mode else ""), data)
    classes = list(mav.classes)
    stream = b""
    for cls, name in zip(classes, MAVLINK_MESSAGES):
        mav.classes = [cls]
        frame = bytes.fromhex(mav.make(rng)[2])
        stream += frame
        write(os.path.join(root, "fuzz_mavlink"), name, b"\x40" + frame)
    write(os.path.join(root, "fuzz_mavlink"), "stream", b"\x06" + stream[:1500])
    import dronecan
    for index, name in enumerate(LINK_TYPES):
        kind = dronecan.TYPENAMES[name]
        value = kind(_mode="request") if kind.kind == kind.KIND_SERVICE else kind()
        peer.fill(value, rng)
        if name.endswith("Targetted"):
            value.target_node, value.serial_id = 42, 0
            value.buffer = stream[:120]
        payload = bytes(peer.transport.Transfer(payload=value, source_node_id=10, dest_node_id=42, service_not_message=False).payload)
        write(os.path.join(root, "fuzz_link"), name, bytes([index, 0, len(payload)]) + payload)
    tunnel = dronecan.TYPENAMES["uavcan.tunnel.Targetted"]
    data = b""
    for i in range(0, min(len(stream), 1200), 120):
        value = tunnel(target_node=42, serial_id=0, buffer=stream[i:i + 120])
        payload = bytes(peer.transport.Transfer(payload=value, source_node_id=10).payload)
        data += bytes([0, 0, len(payload)]) + payload
    write(os.path.join(root, "fuzz_link"), "tunnel_stream", data)
    # The same by several nodes, every second transfer sent together with the next.
    pieces, at = [], 0
    while at < len(data):
        pieces.append(data[at + 2:at + 3 + data[at + 2]])
        at += 3 + data[at + 2]
    mixed = b"".join(bytes([0x20 * (i % 2 == 0), i % 6]) + piece for i, piece in enumerate(pieces))
    write(os.path.join(root, "fuzz_link"), "several_nodes", mixed)
    return 0


if __name__ == "__main__":
    sys.exit(main())
