#!/usr/bin/env python3
"""Compares godwit's DroneCAN and MAVLink codecs with pydronecan and pymavlink on random values, both ways.

The peer packs random values; godwit_codec_peer unpacks them, prints each field and packs them again. Fields must be equal
(floats to the bit) and so must the frames. Use:

    codec_compare.py build/release/tests/link/godwit_codec_peer --dronecan 1000000 --mavlink 100000 --processes 2
"""
import argparse
import multiprocessing
import os
import random
import struct
import subprocess
import sys

os.environ["MAVLINK20"] = "1"
BATCH = 500

DRONECAN_TYPES = [
    ("uavcan.protocol.NodeStatus", None), ("uavcan.protocol.GetNodeInfo", "request"),
    ("uavcan.protocol.GetNodeInfo", "response"), ("uavcan.protocol.GetTransportStats", "request"),
    ("uavcan.protocol.GetTransportStats", "response"), ("uavcan.protocol.RestartNode", "request"),
    ("uavcan.protocol.RestartNode", "response"), ("uavcan.protocol.param.ExecuteOpcode", "request"),
    ("uavcan.protocol.param.ExecuteOpcode", "response"), ("uavcan.protocol.param.GetSet", "request"),
    ("uavcan.protocol.param.GetSet", "response"), ("uavcan.protocol.file.BeginFirmwareUpdate", "request"),
    ("uavcan.protocol.file.BeginFirmwareUpdate", "response"), ("uavcan.protocol.debug.LogMessage", None),
    ("uavcan.protocol.dynamic_node_id.Allocation", None), ("uavcan.tunnel.Targetted", None),
    ("uavcan.tunnel.Broadcast", None), ("uavcan.equipment.range_sensor.Measurement", None),
    ("com.hex.equipment.flow.Measurement", None), ("uavcan.equipment.ahrs.RawIMU", None),
    ("uavcan.equipment.ahrs.Solution", None), ("uavcan.equipment.air_data.StaticPressure", None),
    ("uavcan.protocol.GlobalTimeSync", None), ("uavcan.equipment.safety.ArmingStatus", None)]

MAVLINK_MESSAGES = [
    "HEARTBEAT", "PARAM_REQUEST_READ", "PARAM_VALUE", "RAW_IMU", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT", "SET_GPS_GLOBAL_ORIGIN", "GPS_GLOBAL_ORIGIN", "COMMAND_LONG", "COMMAND_ACK",
    "VISION_POSITION_ESTIMATE", "VISION_SPEED_ESTIMATE", "HIGHRES_IMU", "TIMESYNC", "SCALED_IMU2", "DISTANCE_SENSOR",
    "STATUSTEXT", "ODOMETRY"]


def float_bits(value):
    return struct.pack(">f", value).hex()


def random_float(rng):
    kind = rng.randrange(8)
    if kind == 0:
        return 0.0
    if kind == 1:
        return rng.choice([float("inf"), float("-inf"), 65504.0, -65504.0, 65519.9, 65520.0, 1e38, 5.9e-8, 2.9e-8, 1e-45])
    if kind < 5:
        return rng.uniform(-100, 100)
    return rng.uniform(-1, 1) * 10.0 ** rng.randint(-10, 10)


class DronecanPeer:
    def __init__(self):
        import dronecan
        from dronecan import dsdl, transport
        self.dsdl, self.transport = dsdl, transport
        self.types = [(dronecan.TYPENAMES[name], mode) for name, mode in DRONECAN_TYPES]

    def fill(self, value, rng):
        """Sets every field of a compound value to something random."""
        t, dsdl = self.transport, self.dsdl
        fields = t.get_fields(value)
        names = [n for n in fields if not n.startswith("_void")]
        if t.is_union(value):
            name = rng.choice(names)
            t.switch_union_field(value, name)
            names = [name]
        for name in names:
            field = fields[name]
            kind = field._type
            if isinstance(kind, dsdl.PrimitiveType):
                field.value = self.number(kind, rng)
            elif isinstance(kind, dsdl.ArrayType):
                size = kind.max_size
                if kind.mode == dsdl.ArrayType.MODE_DYNAMIC:
                    size = rng.choice([0, size, rng.randint(0, size)])
                field.clear()
                for _ in range(size):
                    if isinstance(kind.value_type, dsdl.PrimitiveType):
                        field.append(self.number(kind.value_type, rng))
                    else:
                        item = field.new_item()
                        self.fill(item, rng)
                        field.append(item)
            else:
                self.fill(field, rng)

    def number(self, kind, rng):
        if kind.kind == kind.KIND_FLOAT:
            return random_float(rng)
        low, high = int(kind.value_range[0]), int(kind.value_range[1])
        return rng.choice([low, high, rng.randint(low, high), rng.randint(low, high), 0])

    def flat(self, value, out):
        """The fields as godwit_codec_peer prints them."""
        t, dsdl = self.transport, self.dsdl
        if t.is_union(value):
            names = list(t.get_fields(value))
            active = t.get_active_union_field(value) or names[0]
            out.append("tag=%d" % names.index(active))
            items = [(active, t.get_fields(value)[active])]
        else:
            items = [(n, f) for n, f in t.get_fields(value).items() if not n.startswith("_void")]
        for name, field in items:
            kind = field._type
            if isinstance(kind, dsdl.PrimitiveType):
                out.append(self.text(name, kind, field.value))
            elif isinstance(kind, dsdl.ArrayType):
                if kind.mode == dsdl.ArrayType.MODE_DYNAMIC:
                    out.append("%s#=%d" % (name, len(field)))
                for item in field:
                    if isinstance(kind.value_type, dsdl.PrimitiveType):
                        out.append(self.text(name, kind.value_type, item))
                    else:
                        self.flat(item, out)
            else:
                self.flat(field, out)
        return out

    @staticmethod
    def text(name, kind, value):
        if kind.kind == kind.KIND_FLOAT:
            return "%s=%s" % (name, float_bits(value))
        return "%s=%d" % (name, int(value))

    def make(self, rng):
        """A random transfer: (line for godwit_codec_peer, fields, frames, the value)."""
        kind, mode = rng.choice(self.types)
        value = kind(_mode=mode) if mode else kind()
        self.fill(value, rng)
        fd = rng.random() < 0.5
        transfer = self.transport.Transfer(
            payload=value, source_node_id=rng.randint(1, 127), dest_node_id=rng.randint(1, 127) if mode else None,
            transfer_id=rng.randint(0, 31), transfer_priority=rng.randint(0, 31), service_not_message=mode is not None,
            request_not_response=mode == "request", canfd=fd)
        if len(transfer.payload) == 0:
            transfer.payload = bytearray()
        frames = ["%08x:%s" % (f.message_id, bytes(f.bytes).hex()) for f in transfer.to_frames()]
        return ("D %d %s" % (fd, " ".join(frames)), self.flat(value, []), frames, fd)

    def check(self, made, answer):
        _, fields, frames, fd = made
        if answer == "-":
            return "not understood"
        left, _, right = answer.partition("|")
        got = left.split()[1:]
        # Names differ where godwit folds a nested type of one field into its parent (timestamp, protocol, level, path).
        if [g.rpartition("=")[2] for g in got] != [f.rpartition("=")[2] for f in fields]:
            return "fields differ: %s" % [(g, f) for g, f in zip(got, fields) if g.rpartition("=")[2] != f.rpartition("=")[2]][:3]
        ours = right.split()
        if ours == frames:
            return None
        # pydronecan sends CAN FD frames of 63 bytes, a length that CAN FD does not have; godwit pads them to 64, and the
        # transfer's CRC covers the padding. There the peer must read ours.
        if fd and any(len(f) == 9 + 2 * 63 for f in frames):
            parsed = [self.transport.Frame(int(f[:8], 16), bytes.fromhex(f[9:]), canfd=True) for f in ours]
            back = self.transport.Transfer(canfd=True)
            back.from_frames(parsed)
            return None if self.flat(back.payload, []) == fields else "peer reads other fields from ours"
        return "frames differ: theirs %s ours %s" % (frames, ours)


class MavlinkPeer:
    def __init__(self):
        from pymavlink.dialects.v20 import ardupilotmega
        self.dialect = ardupilotmega
        by_name = {c.msgname: c for c in ardupilotmega.mavlink_map.values()}
        self.classes = [by_name[name] for name in MAVLINK_MESSAGES]
        self.integers = {"uint8_t": (0, 2**8), "int8_t": (-2**7, 2**7), "uint16_t": (0, 2**16), "int16_t": (-2**15, 2**15),
                         "uint32_t": (0, 2**32), "int32_t": (-2**31, 2**31), "uint64_t": (0, 2**64), "int64_t": (-2**63, 2**63)}

    def value(self, kind, length, rng):
        if kind == "char":
            return bytes(rng.randint(1, 126) for _ in range(rng.randint(0, length)))
        if length:
            return [self.value(kind, 0, rng) for _ in range(length)]
        if rng.random() < 0.3:
            return 0
        if kind == "float":
            return struct.unpack("<f", struct.pack("<f", max(-3e38, min(3e38, random_float(rng)))))[0]
        low, high = self.integers[kind]
        return rng.choice([low, high - 1, rng.randrange(low, high), rng.randrange(low, high)])

    def make(self, rng):
        cls = rng.choice(self.classes)
        # fieldnames stand in definition order, array_lengths in wire order.
        lengths = dict(zip(cls.ordered_fieldnames, cls.array_lengths))
        types = dict(zip(cls.fieldnames, cls.fieldtypes))
        values = {n: self.value(types[n], lengths[n], rng) for n in cls.fieldnames}
        if cls.msgname == "HEARTBEAT":
            values["mavlink_version"] = 3
        message = cls(*[values[n] for n in cls.fieldnames])
        mav = self.dialect.MAVLink(None, srcSystem=rng.randint(1, 255), srcComponent=rng.randint(0, 255))
        mav.seq = rng.randint(0, 255)
        frame = bytes(message.pack(mav)).hex()
        fields = []
        for name in cls.ordered_fieldnames:
            value = values[name]
            if types[name] == "char":
                value = list(value.ljust(lengths[name], b"\0"))
            for item in value if isinstance(value, list) else [value]:
                fields.append("%s=%s" % (name, float_bits(item) if types[name] == "float" else "%d" % item))
        return ("M " + frame, fields, frame, cls.msgname)

    def check(self, made, answer):
        _, fields, frame, name = made
        left, _, right = answer.partition("|")
        got = left.split()[1:]
        if name == "TIMESYNC":  # godwit knows two newer extension fields, zero in the peer's messages
            got = [g for g in got if not g.startswith("target_")]
        if got != fields:
            return "%s: fields differ: %s" % (name, [(g, f) for g, f in zip(got, fields) if g != f][:3] or answer)
        return None if right.strip() == frame else "%s: frames differ: theirs %s ours %s" % (name, frame, right)


def work(job):
    """Compares job's share; returns the differences."""
    program, which, count, seed = job
    rng = random.Random(seed)
    peer = DronecanPeer() if which == "dronecan" else MavlinkPeer()
    process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    differences = []
    done = 0
    while done < count:
        batch = [peer.make(rng) for _ in range(min(BATCH, count - done))]
        for made in batch:  # one line at a time keeps both pipes from filling
            process.stdin.write(made[0] + "\n")
            process.stdin.flush()
            reason = peer.check(made, process.stdout.readline().rstrip("\n"))
            if reason:
                differences.append(reason)
        done += len(batch)
        if len(differences) > 20:
            break
    process.stdin.close()
    process.wait(timeout=10)
    if process.returncode != 0:
        differences.append("godwit_codec_peer ended with %d" % process.returncode)
    return done, differences


def check_types(program):
    """Recomputes id, signature and longest payload of every type from the DSDL text that pydronecan ships."""
    import dronecan
    lines = subprocess.run([program, "--types"], check=True, capture_output=True, text=True).stdout.split("\n")
    wrong = []
    rows = [line.split() for line in lines if line]
    for name, kind, type_id, signature, max_bytes in rows:
        dsdl = dronecan.TYPENAMES[name]
        bits = {"0": lambda: dsdl.get_max_bitlen(), "1": lambda: dsdl.get_max_bitlen_request(),
                "2": lambda: dsdl.get_max_bitlen_response()}[kind]()
        expected = (dsdl.default_dtid, "%016X" % dsdl.get_data_type_signature(), (bits + 7) // 8)
        if expected != (int(type_id), signature, int(max_bytes)):
            wrong.append("%s kind %s: DSDL says %s, godwit %s %s %s" % (name, kind, expected, type_id, signature, max_bytes))
    missing = {n for n, _ in DRONECAN_TYPES} - {row[0] for row in rows}
    wrong += ["%s is not in godwit's table" % name for name in missing]
    print("types: %d compared with their DSDL, %d differences" % (len(rows), len(wrong)))
    for line in wrong:
        print("  " + line)
    return not wrong and len(rows) == len(DRONECAN_TYPES)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--dronecan", type=int, default=0)
    parser.add_argument("--mavlink", type=int, default=0)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    failed = not check_types(args.program)
    for which, count in (("dronecan", args.dronecan), ("mavlink", args.mavlink)):
        if count == 0:
            continue
        share = (count + args.processes - 1) // args.processes
        jobs = [(args.program, which, share, "%s %d %d" % (which, args.seed, i)) for i in range(args.processes)]
        with multiprocessing.Pool(args.processes) as pool:
            results = pool.map(work, jobs)
        differences = [d for _, ds in results for d in ds]
        print("%s: %d compared, %d differences" % (which, sum(n for n, _ in results), len(differences)))
        for difference in differences[:10]:
            print("  " + difference[:1000])
        failed = failed or bool(differences)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
