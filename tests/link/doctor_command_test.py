#!/usr/bin/env python3
"""`godwit doctor` against an emulated autopilot: words, values to set, exit codes. Inside a network namespace:

    with_peers.sh --bus dronecan,pymavlink doctor_command_test.py build/release/firmware_app/godwit SCENARIO [words|tilt]
"""
import bisect
import math
import os
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from checks import check, run_cases  # noqa: E402
from emulated_autopilot import AUTOPILOT_NODE, EmulatedAutopilot, RawMulticast, dronecan, mavlink, uavcan  # noqa: E402

GOOD = {"CAN_P1_DRIVER": 1, "CAN_D1_PROTOCOL": 1, "CAN_D1_UC_SER_EN": 1, "CAN_D1_UC_S1_NOD": 42, "CAN_D1_UC_S1_IDX": 0,
        "CAN_D1_UC_S1_PRO": 2, "CAN_D1_UC_S1_BD": 921, "VISO_TYPE": 3, "VISO_DELAY_MS": 20, "VISO_QUAL_MIN": 10,
        "VISO_POS_X": 0, "VISO_POS_Y": 0, "VISO_POS_Z": 0, "AHRS_EKF_TYPE": 3, "EK3_ENABLE": 1,
        "VISO_SCALE": 1, "VISO_ORIENT": 0, "VISO_POS_M_NSE": 0.2, "EK3_SRC_OPTIONS": 0}
for source, value in (("1", 3), ("2", 6), ("3", 0)):
    for what in ("POSXY", "VELXY", "POSZ", "VELZ", "YAW"):
        GOOD["EK3_SRC%s_%s" % (source, what)] = value
for channel in range(1, 17):
    GOOD["RC%d_OPTION" % channel] = 90 if channel == 7 else 0
# A scenario of a second is a camera quickly made.
CONFIG = '[camera]\nsource = "sim"\nscenario = "%s"\n'


class Doctor:
    """`godwit doctor` as it runs, what it has said, and the keyboard."""

    def __init__(self, program, *arguments):
        self.process = subprocess.Popen([program, "doctor", *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                        stdin=subprocess.PIPE)
        os.set_blocking(self.process.stdout.fileno(), False)
        self.text, self.over = "", False

    def listen(self):
        more = self.process.stdout.read()
        if more:
            self.text += more.decode()
        elif self.process.poll() is not None:
            self.over = True

    def questions(self):
        return self.text.count("Then press Enter.")

    def press_enter(self):
        self.process.stdin.write(b"\n")
        self.process.stdin.flush()

    def end(self):
        if self.process.poll() is None:
            self.process.kill()
        self.process.stdin.close()
        self.process.stdout.close()
        return self.process.wait()


def doctor(program, ap, *arguments, enters=0):
    """Runs it beside the autopilot; what it said and its exit code. enters: how often Enter is pressed when it asks; then
    its input ends."""
    d, pressed, end = Doctor(program, *arguments), 0, time.monotonic() + 90
    while not d.over and time.monotonic() < end:
        ap.spin(0.02)
        d.listen()
        if d.questions() > pressed and not d.process.stdin.closed:
            pressed += 1
            d.press_enter() if pressed <= enters else d.process.stdin.close()
    return d.text, d.end()


def autopilot(bus=0, node_id=AUTOPILOT_NODE, **changed):
    ap = EmulatedAutopilot(bus, node_id=node_id)
    ap.parameters = {**GOOD, **changed}
    ap.send_inputs = False
    return ap


def words(program, scenario):
    with tempfile.TemporaryDirectory() as folder:
        config = os.path.join(folder, "c.toml")
        open(config, "w").write(CONFIG % scenario)
        with_bus = ("--config", config, "--can", "multicast:0")

        ap = autopilot()
        text, code = doctor(program, ap, *with_bus, "--delay-ms", "22")
        check(code == 0 and "WRONG" not in text and "all fits" in text, "all fits: exit code %s" % code)
        if code != 0:
            print(text)
        for said in ("the calibration fits its size", "inertial sensor:", "bus multicast:0: open", "its 50 parameters fit",
                     "note   autopilot: RC7_OPTION is 90", "nodes: 10 (speaks through a tunnel)",
                     "the camera looks ", "the autopilot may say that our node is unhealthy"):
            check(said in text, "tells of: " + said)
        check(ap.intervals.keys() == {24, 29, 31, 132}, "asks for attitude and aids, and for nothing that it does not read: %s" % sorted(ap.intervals))
        ap.node.close()

        ap = autopilot(VISO_TYPE=0, CAN_D1_UC_S1_NOD=43, VISO_DELAY_MS=90, EK3_SRC2_POSXY=3)
        text, code = doctor(program, ap, *with_bus, "--delay-ms", "22")
        for said in ("Set VISO_TYPE 3.", "Set CAN_D1_UC_S1_NOD 42.", "Set VISO_DELAY_MS 22.", "Set EK3_SRC2_POSXY 6."):
            check(said in text, said)
        check(code == 1 and "4 to mend" in text, "exit code %s" % code)
        ap.node.close()

        # Somebody else has our node id.
        other = dronecan.node.Node(RawMulticast(0), node_id=42,
                                   node_info=uavcan.protocol.GetNodeInfo.Response())
        ap = autopilot()
        spin = ap.spin
        ap.spin = lambda s: (other.spin(0.002), spin(s))
        text, code = doctor(program, ap, *with_bus)
        check(code == 1 and "as node 42 already: stop godwitd first" in text, "a second node 42 is seen")
        other.close()
        ap.node.close()

        # The autopilot is another node than the one that is configured.
        ap = autopilot(node_id=11)
        text, code = doctor(program, ap, *with_bus)
        check(code == 1 and "nodes on the bus: 11 (speaks through a tunnel)" in text and
              "Then set can.autopilot_node 11." in text, "an autopilot on another node is named")
        ap.node.close()

        # Nobody there.
        silent = type("Silent", (), {"spin": staticmethod(time.sleep)})()
        text, code = doctor(program, silent, *with_bus)
        check(code == 1 and "no HEARTBEAT through the tunnel" in text and "CAN_D1_UC_SER_EN 1" in text, "no autopilot")
        check("restart it again: serial ports over CAN are made at its start" in text, "and says that two restarts are needed")
        check("not a frame of anybody came in 1.2 s" in text and "ok     bus" not in text, "a bus without a frame is not well")
        text, code = doctor(program, silent)
        check(code == 1 and "camera: none is configured" in text and "no way to it is configured" in text,
              "nothing configured")
        text, code = doctor(program, silent, "--can", "foo")
        check(code == 2 and "expected multicast:N or socketcan:IFACE" in text, "--can foo: exit code %s" % code)

        ap = autopilot()
        text, code = doctor(program, ap, *with_bus, "--tilt", enters=1)
        check("Hold the vehicle level and still. Then press Enter." in text, "the tilt test asks for level")
        check("does not send its attitude" in text, "and says that the autopilot sends no attitude")
        check(code == 1 and "standard input ended" in text, "and ends with its input (%s)" % code)
        ap.node.close()


# ---- the tilt test to its end -----------------------------------------------------------------------------------------

LEVEL_PASSES = 3  # the level leg is flown to and fro so often, until doctor has come to its question
LEVEL_S = 6.1     # of tilt.toml: 0.5 s of rest and the first leg, to its end


class TiltFlight:
    """tilt.toml as a sequence of pictures at real pace, and the true attitude that goes with each."""

    def __init__(self, program, folder):
        source = os.path.join(folder, "flight")
        subprocess.run([program, "sim", os.path.join(os.path.dirname(os.path.abspath(__file__)), "tilt.toml"), "--out", source],
                       check=True, stdout=subprocess.DEVNULL)
        lines = [w for w in (line.split() for line in open(os.path.join(source, "rgb.txt"))) if w and w[0][0] != "#"]
        truth = [[float(x) for x in line.split()] for line in open(os.path.join(source, "groundtruth_body.txt"))
                 if line[0] != "#"]
        first = float(lines[0][0])
        level = [i for i, w in enumerate(lines) if float(w[0]) - first < LEVEL_S]
        # No picture twice in a row: a camera that does so is frozen.
        order = level + [i for _ in range(LEVEL_PASSES // 2) for i in level[-2::-1] + level[1:]]
        order += range(len(level), len(lines))
        self.step = (float(lines[-1][0]) - first) / (len(lines) - 1)
        self.attitudes = []
        self.folder = os.path.join(folder, "sequence")
        os.makedirs(self.folder)
        os.symlink(os.path.join(source, "mav0"), os.path.join(self.folder, "mav0"))
        open(os.path.join(self.folder, "camera.yaml"), "w").write(open(os.path.join(source, "camera.yaml")).read())
        times = [row[0] for row in truth]
        with open(os.path.join(self.folder, "rgb.txt"), "w") as out:
            for k, i in enumerate(order):
                out.write("%.6f %s\n" % (1000 + k * self.step, lines[i][1]))
                x, y, z, w = truth[max(0, bisect.bisect(times, float(lines[i][0])) - 1)][4:8]  # every 5 ms
                self.attitudes.append((-x, w, -z, y))  # of the body in north-east-down; the world's x is north

    def attitude(self, seconds):
        return self.attitudes[max(0, min(int(seconds / self.step), len(self.attitudes) - 1))]

    def length(self):
        return len(self.attitudes) * self.step


def tilt(q):
    """Roll and pitch in degrees."""
    w, x, y, z = q
    return (math.degrees(math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))),
            math.degrees(math.asin(max(-1.0, min(1.0, 2 * (w * y - x * z))))))


class TiltRun:
    """One doctor with one autopilot that feels what the pictures show, and somebody who holds the vehicle as asked."""

    def __init__(self, program, flight, bus, *arguments):
        self.flight, self.ap, self.t0, self.pressed, self.next_press = flight, autopilot(bus), None, 0, 0
        self.doctor = Doctor(program, "--can", "multicast:%d" % bus, "--sequence", flight.folder, "--tilt", *arguments)

    def step(self):
        self.ap.spin(0.01)
        self.doctor.listen()
        text, now = self.doctor.text, time.monotonic()
        if self.t0 is None and "camera (sequence" in text:
            self.t0 = now - 29 * self.flight.step  # it has taken 30 pictures
        if self.t0 is None:
            return
        q = self.flight.attitude(now - self.t0)
        self.ap.every("attitude", 0.05, lambda: self.ap.send(mavlink.MAVLink_attitude_quaternion_message(
            self.ap.micros() // 1000, *q, 0, 0, 0)))
        roll, pitch = tilt(q)
        held = (abs(roll) < 5 and abs(pitch) < 5, pitch > 20, roll > 23)
        asked = sum(said in text for said in ("Hold the vehicle level", "Raise the nose", "lower the right side")) - 1
        if self.doctor.questions() > self.pressed and held[asked] and now > self.next_press:
            self.pressed += 1
            self.next_press = now + 0.5
            self.doctor.press_enter()
        if now - self.t0 > self.flight.length() + 5:
            self.doctor.process.stdin.close()

    def result(self):
        self.ap.node.close()
        return self.doctor.text, self.doctor.end()


def tilted(program):
    with tempfile.TemporaryDirectory() as folder:
        flight = TiltFlight(program, folder)
        # The camera looks 45 degrees down, and this says up.
        wrong = os.path.join(folder, "wrong.toml")
        d = math.sqrt(0.5)
        rows = ((0, d, d), (1, 0, 0), (0, d, -d))
        open(wrong, "w").write("[link]\nT_body_cam = [%s, 0, 0, 0, 1]\n" % ", ".join("%.17g" % x for row in rows for x in (*row, 0)))
        # And this mirrors the picture.
        mirrored = os.path.join(folder, "mirrored.toml")
        open(mirrored, "w").write("[link]\nT_body_cam = [0, -1, 0, 0,  1, 0, 0, 0,  0, 0, -1, 0,  0, 0, 0, 1]\n")
        runs = (TiltRun(program, flight, 0), TiltRun(program, flight, 1, "--config", wrong))
        end = time.monotonic() + 120
        while not all(run.doctor.over for run in runs) and time.monotonic() < end:
            for run in runs:
                run.doctor.over or run.step()
        (right, code), (other, other_code) = (run.result() for run in runs)
        ok = code == 0 and "tilt test: the mounting agrees with the autopilot's attitude" in right
        check(ok, "the right mounting agrees (%s)" % code)
        named = "front is down, right is right, down is back" in other
        check(other_code == 1 and named, "looking up in place of down: named (%s)" % other_code)
        for good, text in ((ok, right), (named, other)):
            if not good:
                print(text)
        refused = subprocess.run([program, "doctor", "--can", "multicast:0", "--config", mirrored], capture_output=True, text=True)
        check(refused.returncode == 2 and "T_body_cam" in refused.stderr, "a mirrored mounting is refused (%s)" % refused.returncode)


def main():
    program, scenario = sys.argv[1:3]
    run_cases({"words": lambda: words(program, scenario), "tilt": lambda: tilted(program)}, ",".join(sys.argv[3:]))


if __name__ == "__main__":
    main()
