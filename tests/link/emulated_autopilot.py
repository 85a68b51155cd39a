"""An autopilot on the bus, as far as a vision source can tell: pydronecan and pymavlink with ArduPilot's rules for taking
external vision (libraries/AP_VisualOdom and GCS_Common's handle_odometry, read for their behaviour)."""
import binascii
import math
import os
import queue
import socket
import struct
import threading
import time

os.environ["MAVLINK20"] = "1"
import dronecan  # noqa: E402
from dronecan import transport, uavcan  # noqa: E402
from pymavlink.dialects.v20 import ardupilotmega as mavlink  # noqa: E402

GROUP, PORT = "239.65.82.%d", 57732
AUTOPILOT_NODE, OUR_NODE = 10, 42
SO_TIMESTAMPNS = 35  # linux/socket.h; Python has no name for it


class Sniffer(threading.Thread):
    """Every frame on the bus with its arrival time on CLOCK_MONOTONIC, which the node under test uses too."""

    def __init__(self, bus):
        super().__init__(daemon=True)
        self.frames = []  # (t, id, extended, fd, data)
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self.sock.bind((GROUP % bus, PORT))
        self.sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP,
                             struct.pack("4sl", socket.inet_aton(GROUP % bus), socket.INADDR_ANY))
        # The kernel's receive time, so that this thread may be late without the frames looking late.
        self.sock.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self.start()

    def run(self):
        while True:
            data, extra, _, _ = self.sock.recvmsg(100, 64)
            seconds, nanoseconds = struct.unpack("qq", extra[0][2][:16])
            t = seconds + nanoseconds * 1e-9 - (time.time() - time.monotonic())
            if len(data) < 10:
                continue
            magic, crc, flags, can_id = struct.unpack("<HHHI", data[:10])
            if magic == 0x2934 and crc == binascii.crc_hqx(data[4:], 0xFFFF):
                self.frames.append((t, can_id & 0x1FFFFFFF, bool(can_id >> 31), bool(flags & 1), data[10:]))

    def transfers(self, source=OUR_NODE, cut=False):
        """(t of the last frame, transfer) of every transfer of a node so far; where the bus is `cut` on purpose, without
        those that lack frames, which their checksum tells. Elsewhere such a transfer raises."""
        manager, out = transport.TransferManager(), []
        for t, can_id, extended, fd, data in list(self.frames):
            if not extended or can_id & 0x7F != source:
                continue
            frames = manager.receive_frame(transport.Frame(can_id, data, t, t, fd))
            if frames:
                transfer = transport.Transfer()
                try:
                    transfer.from_frames(frames)
                except transport.TransferError:
                    if not cut:
                        raise
                    continue
                out.append((t, transfer))
        return out

    def broadcasts(self, type_id, source=OUR_NODE, cut=False):
        """(t, payload) of every DroneCAN message of a type."""
        return [(t, x.payload) for t, x in self.transfers(source, cut) if x.data_type_id == type_id and not x.service_not_message]

    def statuses(self, source=OUR_NODE):
        return self.broadcasts(341, source)

    def odometry(self, source=OUR_NODE):
        return [(t, m) for t, m in self.messages(source) if m.get_type() == "ODOMETRY"]

    def messages(self, source=OUR_NODE, cut=False):
        """(t, message) of every MAVLink message that came through the tunnel, parsed by pymavlink. A message takes two or
        three transfers; where the bus is `cut` on purpose, one may lack its end: it then is a BAD_DATA, as an autopilot's
        parser passes over it. Elsewhere it raises."""
        parser = mavlink.MAVLink(None)
        parser.robust_parsing = cut
        out = []
        for t, tunnel in self.broadcasts(3001, source, cut):
            for message in parser.parse_buffer(bytes(tunnel.buffer.to_bytes())) or []:
                out.append((t, message))
        return out


class RawMulticast(dronecan.driver.common.AbstractDriver):
    """A driver for pydronecan without its 10 ms polling process, so that round trips measure the node under test."""

    def __init__(self, bus):
        super().__init__()
        self.out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.out.connect((GROUP % bus, PORT))
        self.own_port = self.out.getsockname()[1]
        self.frames = queue.Queue()
        self.inp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.inp.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.inp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self.inp.bind((GROUP % bus, PORT))
        self.inp.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP,
                            struct.pack("4sl", socket.inet_aton(GROUP % bus), socket.INADDR_ANY))

    def receive(self, timeout=None):
        self.inp.settimeout(max(timeout if timeout is not None else 1, 0.0005))
        try:
            data, sender = self.inp.recvfrom(100)
        except (socket.timeout, BlockingIOError):
            return None
        if sender[1] == self.own_port:
            return None
        _, _, flags, can_id = struct.unpack("<HHHI", data[:10])
        return dronecan.driver.common.CANFrame(can_id & 0x1FFFFFFF, data[10:], bool(can_id >> 31), canfd=bool(flags & 1))

    def send_frame(self, frame):
        body = struct.pack("<HI", 1 if frame.canfd else 0, frame.id | (1 << 31 if frame.extended else 0)) + bytes(frame.data)
        crc = dronecan.dsdl.common.crc16_from_bytes(body)
        self.out.send(struct.pack("<HH", 0x2934, crc) + body)

    def close(self):
        self.inp.close()
        self.out.close()


class EmulatedAutopilot:
    """Answers as ArduPilot does; judges each ODOMETRY."""

    def __init__(self, bus=0, node_id=AUTOPILOT_NODE, source=OUR_NODE):
        self.source = source
        info = uavcan.protocol.GetNodeInfo.Response()
        info.name = "org.ardupilot.emulated"
        info.hardware_version.unique_id = [0xA0 + i for i in range(16)]
        self.node = dronecan.node.Node(RawMulticast(bus), node_id=node_id, node_info=info,
                                       mode=uavcan.protocol.NodeStatus().MODE_OPERATIONAL)
        self.node.add_handler(uavcan.tunnel.Targetted, self.on_tunnel)
        self.parser = mavlink.MAVLink(None)
        self.mav = mavlink.MAVLink(None, srcSystem=7, srcComponent=1)
        self.armed = False
        self.boot = time.monotonic() - 100.0
        self.questions_answered = 0
        self.answers_to_us = []
        self.texts = []
        self.intervals = {}
        self.origin = None
        self.next = {}
        self.asked = {}
        self.parameters = {}
        self.send_inputs = True

    def micros(self):
        return int((time.monotonic() - self.boot) * 1e6)

    def send(self, message):
        """Through the tunnel, in pieces of at most 120 bytes, protocol 255 and LOCK_PORT, as ArduPilot sends."""
        data = message.pack(self.mav)
        self.mav.seq = (self.mav.seq + 1) % 256
        for i in range(0, len(data), 120):
            self.node.broadcast(uavcan.tunnel.Targetted(
                protocol=uavcan.tunnel.Protocol(protocol=255), target_node=self.source, serial_id=0, options=1,
                baudrate=115200, buffer=data[i:i + 120]), priority=16)

    def on_tunnel(self, event):
        m = event.message
        if event.transfer.source_node_id != self.source or m.serial_id != 0:
            return
        for message in self.parser.parse_buffer(bytes(m.buffer.to_bytes())) or []:
            self.on_message(message)

    def on_message(self, m):
        kind = m.get_type()
        if kind == "TIMESYNC":
            if m.tc1 == 0:
                self.questions_answered += 1
                self.send(mavlink.MAVLink_timesync_message(self.micros() * 1000, m.ts1))
            elif m.ts1 in self.asked:
                self.answers_to_us.append((time.monotonic() - self.asked.pop(m.ts1), m.tc1))
        elif kind == "STATUSTEXT":
            self.texts.append(m.text)
        elif kind == "SET_GPS_GLOBAL_ORIGIN":
            self.origin = (m.latitude, m.longitude, m.altitude)
        elif kind == "COMMAND_LONG" and m.command == 511:
            self.intervals[int(m.param1)] = m.param2
            self.send(mavlink.MAVLink_command_ack_message(511, 0))
        elif kind == "PARAM_REQUEST_READ" and m.param_id in self.parameters:
            self.send(mavlink.MAVLink_param_value_message(m.param_id.encode(), self.parameters[m.param_id], 9,
                                                          len(self.parameters), 65535))

    def every(self, name, period, action):
        now = time.monotonic()
        if now >= self.next.get(name, 0):
            self.next[name] = now + period
            action()

    def heartbeat(self):
        self.send(mavlink.MAVLink_heartbeat_message(2, 3, 128 if self.armed else 0, 0, 4, 3))

    def ask_time(self):
        stamp = self.micros() * 1000
        self.asked[stamp] = time.monotonic()
        self.send(mavlink.MAVLink_timesync_message(0, stamp))

    def arming_status(self):
        self.node.broadcast(uavcan.equipment.safety.ArmingStatus(status=255 if self.armed else 0))

    def inputs(self):
        ms = self.micros() // 1000
        wanted = self.intervals
        if 31 in wanted:
            self.send(mavlink.MAVLink_attitude_quaternion_message(ms, 1, 0, 0, 0, 0.01, 0.02, 0.03))
        if 132 in wanted:
            self.send(mavlink.MAVLink_distance_sensor_message(ms, 20, 4000, 153, 0, 0, 25, 0))
        if 32 in wanted:
            self.send(mavlink.MAVLink_local_position_ned_message(ms, 1, 2, -3, 0, 0, 0))
        if 33 in wanted:
            self.send(mavlink.MAVLink_global_position_int_message(ms, 473977000, 85456000, 488000, 0, 0, 0, 0, 0))
        self.node.broadcast(uavcan.equipment.range_sensor.Measurement(
            sensor_id=1, sensor_type=2, reading_type=1, field_of_view=0.05, range=1.5))
        self.node.broadcast(uavcan.equipment.air_data.StaticPressure(static_pressure=95000.0, static_pressure_variance=4.0))
        self.node.broadcast(uavcan.equipment.ahrs.RawIMU(rate_gyro_latest=[0.1, 0, 0], accelerometer_latest=[0, 0, -9.8]))
        self.node.broadcast(uavcan.protocol.GlobalTimeSync(previous_transmission_timestamp_usec=self.micros()))

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.every("heartbeat", 1.0, self.heartbeat)
            self.every("timesync", 0.5, self.ask_time)
            self.every("arming", 0.5, self.arming_status)
            if self.send_inputs:
                self.every("inputs", 0.2, self.inputs)
            self.node.spin(0.002)

    def request(self, payload, timeout=1.0):
        """A service call; the response, or None."""
        answer = []
        self.node.request(payload, self.source, answer.append, timeout=timeout)
        end = time.monotonic() + timeout + 0.5
        while not answer and time.monotonic() < end:
            self.spin(0.005)
        return answer[0].response if answer and answer[0] else None


class VisionRules:
    """What ArduPilot does with ODOMETRY, with both versions' reading of the covariance."""

    def __init__(self, quality_min=0, noise_m=0.2, yaw_noise=0.2):
        self.quality_min, self.noise_m, self.yaw_noise = quality_min, noise_m, yaw_noise
        self.last_t = None
        self.last_reset = None
        self.resets = 0
        self.refused = []
        self.fused = 0
        self.failed = 0  # quality below the minimum: taken for health, not fused
        self.sigmas = []
        # VISO_TYPE 3: the position of every message is remembered, whatever its quality; when the reset counter changes
        # the new one is aligned to it. (The heading's alignment: viso_type3.h.)
        self.correction = (0.0, 0.0, 0.0)
        self.position = None  # of the newest message, aligned
        self.fused_positions = []  # (time_usec, aligned position) of what the filter gets

    @staticmethod
    def numbers(m):
        return [m.x, m.y, m.z, *m.q, m.vx, m.vy, m.vz, m.rollspeed, m.pitchspeed, m.yawspeed, *m.pose_covariance,
                *m.velocity_covariance]

    def take(self, t, m):
        if m.frame_id != 20 or m.child_frame_id != 12:
            self.refused.append((t, "frames %d/%d" % (m.frame_id, m.child_frame_id)))
            return
        if any(math.isnan(v) or math.isinf(v) for v in self.numbers(m)):
            self.refused.append((t, "not finite"))
            return
        if abs(sum(v * v for v in m.q) - 1) > 1e-3:
            self.refused.append((t, "quaternion"))
            return
        if self.last_t is not None and t - self.last_t < 0.020:
            self.refused.append((t, "%.1f ms after the one before" % (1e3 * (t - self.last_t))))
            return
        if self.last_t is not None and t - self.last_t > 0.300:
            self.refused.append((t, "unhealthy: %.0f ms of silence" % (1e3 * (t - self.last_t))))
        self.last_t = t
        if self.last_reset is not None and m.reset_counter != self.last_reset:
            self.resets += 1
            self.correction = tuple(last - new for last, new in zip(self.position, (m.x, m.y, m.z)))
        self.last_reset = m.reset_counter
        self.position = tuple(a + b for a, b in zip((m.x, m.y, m.z), self.correction))
        if m.quality >= self.quality_min:
            self.fused_positions.append((m.time_usec, self.position))
        c = m.pose_covariance
        sigma_47 = math.sqrt(c[0] + c[6] + c[11])
        sigma_46 = (c[0] ** 2 + c[6] ** 2 + c[11] ** 2) ** (1.0 / 3)
        angle = math.sqrt(c[15] + c[18] + c[20])
        for sigma in (sigma_47, min(sigma_46, 10), angle):
            if not sigma > 0:
                self.refused.append((t, "no noise"))
        self.sigmas.append((min(max(sigma_47, self.noise_m), 100), min(max(angle, self.yaw_noise), 1.5)))
        if m.quality < self.quality_min:
            self.failed += 1
        else:
            self.fused += 1
