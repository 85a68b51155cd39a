#!/usr/bin/env python3
"""godwitd over a simulated flight whose scale its inertial sensor alone shows late, and an emulated autopilot that tells what its
rangefinder, barometer and receiver measure there: with them poses are metric sooner, and without that sensor at all. Run it inside a network namespace:

    with_peers.sh --bus dronecan,pymavlink,numpy aids_link_test.py build/release/firmware_app/godwit SCENARIO.toml
"""
import argparse
import csv
import math
import os
import re
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import numpy as np  # noqa: E402
from checks import check, run_cases  # noqa: E402
from emulated_autopilot import EmulatedAutopilot, Sniffer, mavlink  # noqa: E402
from inertial_link_test import QUALITY_MIN  # noqa: E402
from inertial_truth import Truth, by_speed, scale_and_ate  # noqa: E402
from replay_link_test import rotation  # noqa: E402

PICTURES, FPS = 450, 30
START_S = 1000.0  # a simulated flight's first picture
MESSAGES = {"range": 132, "baro": 29, "gnss": 24, "attitude": 31}


def rows(folder, name):
    return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(open(os.path.join(folder, name)))]


class Aiding(EmulatedAutopilot):
    """Tells what was measured in the flight that is being flown, when it was, as soon as it is asked for it; what may be wrong
    with it is up to `lie`, which takes time since the start, name and value, and gives (value or None, by how much the stamp is
    wrong [s])."""

    def __init__(self, folder, lie=lambda t, name, value: (value, 0.0)):
        super().__init__()
        self.lie = lie
        self.begun = None
        self.heading = 0.0
        self.waiting = {name: rows(folder, name + ".csv") for name in ("range", "baro", "gnss", "attitude")}
        self.sent = {name: 0 for name in self.waiting}

    def on_message(self, m):
        super().on_message(m)
        if m.get_type() == "ODOMETRY" and self.begun is None:
            self.begun = m.time_usec * 1e-6  # the first picture, on the clock that both share

    def inputs(self):
        if self.begun is None:
            return
        for name, waiting in self.waiting.items():
            while waiting and waiting[0]["t"] - START_S + self.begun <= time.monotonic():
                row = waiting.pop(0)
                if time.monotonic() - (row["t"] - START_S + self.begun) < 0.3:
                    self.tell(name, row)

    def tell(self, name, row):
        t = row["t"] - START_S
        key = {"range": "range_m", "baro": "pressure_pa", "gnss": "fix", "attitude": "qw"}[name]
        value, off = self.lie(t, name, row[key])
        if value is None or MESSAGES[name] not in self.intervals:
            return
        us = int((self.begun + t + off - self.boot) * 1e6)
        self.sent[name] += 1
        if name == "range":
            self.send(mavlink.MAVLink_distance_sensor_message(us // 1000, 20, 60000, min(65535, int(value * 100)), 0, 0, 25, 0))
        elif name == "baro":
            self.send(mavlink.MAVLink_scaled_pressure_message(us // 1000, value / 100, 0, 2000))
        elif name == "attitude":
            # Its heading is another one every time: nobody may use it.
            self.heading += 0.3
            w, z = math.cos(self.heading / 2), math.sin(self.heading / 2)
            q = [value, row["qx"], row["qy"], row["qz"]]
            q = [w * q[0] - z * q[3], w * q[1] - z * q[2], w * q[2] + z * q[1], w * q[3] + z * q[0]]
            self.send(mavlink.MAVLink_attitude_quaternion_message(us // 1000, *q, 0, 0, 0))
        else:
            metre = 1 / 111194.9
            sigma = int(row["sigma_m"] * 1000)
            self.send(mavlink.MAVLink_gps_raw_int_message(
                us, round(value * 3), int(row["y"] * metre * 1e7), int(row["x"] * metre * 1e7), int(row["z"] * 1000), 100, 100,
                round(100 * math.hypot(row["vx"], row["vy"])), round(100 * math.degrees(math.atan2(row["vx"], row["vy"]))) % 36000,
                12, h_acc=sigma, v_acc=sigma, vel_acc=int(row["speed_sigma_m_s"] * 1000)))

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.every("heartbeat", 1.0, self.heartbeat)
            self.every("timesync", 0.5, self.ask_time)
            self.inputs()
            self.node.spin(0.002)


def fly(program, folder, lie=None, imu="replay", north=False):
    """north: the frame may turn to it, which nobody who compares a whole flight wants. Flies what was drawn into the folder: what godwitd said, its exit code, the fused samples, the autopilot."""
    config, said = os.path.join(folder, "c.toml"), os.path.join(folder, "said")
    open(config, "w").write('[camera]\nsource = "replay"\nsequence = "%s"\n[imu]\nsource = "%s"\n'
                            '[detector]\nenabled = false\n[can]\nbus = "multicast:0"\n[link]\nstate_folder = "%s"\nnorth_by_satellites = %s\n' %
                            (folder, imu, folder, str(north).lower()))
    sniffer, ap = Sniffer(0), Aiding(folder, lie) if lie else Aiding(folder)
    with open(said, "w") as log:
        process = subprocess.Popen([os.path.join(os.path.dirname(program), "godwitd"), "--config", config], stderr=log)
        end = time.monotonic() + 240
        while process.poll() is None and time.monotonic() < end:
            ap.spin(0.02)
            # Without a sensor, which cannot be flown backwards, the pictures would go on, forth and back.
            if imu == "none" and ap.begun is not None and time.monotonic() > ap.begun + PICTURES / FPS - 0.2:
                break
        process.terminate()
        code = process.wait(timeout=20)
    ap.node.close()
    return open(said).read(), code, sniffer.odometry(), ap


def examine(truth, samples, ap, text):
    fused = [m for _, m in samples if m.quality >= QUALITY_MIN]
    check(len(fused) > 60, "%d of %d samples have a quality" % (len(fused), len(samples)))
    if len(fused) <= 60:
        print(text)
        return
    flight = by_speed(fused, int((ap.begun - START_S) * 1e6), 1000000 // FPS, truth)
    error = np.linalg.norm(flight.error, axis=1)
    scale, ate = scale_and_ate(flight.place, flight.true_place)
    print("      metric after %.2f s; scale %+.2f %%, ATE %.3f m, %.3f m at most" %
          (flight.t[0] - START_S, 100 * (scale - 1), ate, error.max()))
    check(abs(scale - 1) <= 0.08, "the scale is off by %+.2f %% (8 allowed)" % (100 * (scale - 1)))
    beyond = (error > 3 * flight.sigma).mean()
    check(beyond <= 0.01, "off by more than three of the sigmas told in %.1f %% of the samples" % (100 * beyond))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("scenario")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--only", default="")
    a = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        # Drawn once, since that takes ten times what flying it does.
        subprocess.run([a.program, "sim", a.scenario, "--seed", str(a.seed), "--frames", str(PICTURES), "--out", folder],
                       check=True, stdout=subprocess.DEVNULL)
        truth = Truth(os.path.join(folder, "groundtruth_body.txt"))

        def heard():
            print("rangefinder, barometer and satellites of the autopilot")
            text, code, samples, ap = fly(a.program, folder)
            check(code == 0, "flies once and ends with 0 (%s)" % code)
            check({24, 29, 132} <= ap.intervals.keys() and not {32, 33} & ap.intervals.keys(),
                  "asks for what the sensors say, not for the autopilot's own place: %s" % sorted(ap.intervals))
            for kind in ("rangefinder", "barometer", "satellites"):
                check("aids: %s of the autopilot is heard and used" % kind in text, "says that the %s is heard" % kind)
            examine(truth, samples, ap, text)

        def faults():
            print("a rangefinder that is 4 m short for 1.5 s and then tells what is 2 s old, satellites that fall silent")

            def lie(t, name, value):
                if name == "range":
                    return (value - 4 if 6 <= t < 7.5 else value), (-2.0 if t >= 9 else 0.0)
                if name == "gnss" and t >= 8:
                    return None, 0.0
                return value, 0.0
            text, code, samples, ap = fly(a.program, folder, lie)
            check(code == 0, "flies once and ends with 0 (%s)" % code)
            check("rangefinder is heard and not used: old on arrival" in text, "says that the rangefinder's stamps are old")
            check("satellites of the autopilot fell silent" in text, "and that the satellites fell silent")
            good = [m for _, m in samples if m.quality >= QUALITY_MIN]
            resets = [b.reset_counter - x.reset_counter for x, b in zip(good, good[1:])]
            check(not any(resets), "nothing of it is a reset: %s" % [r for r in resets if r])
            examine(truth, samples, ap, text)

        def north():
            print("satellites with their velocities: the frame turns to north, once")
            text, code, samples, ap = fly(a.program, folder, north=True)
            check(code == 0, "flies once and ends with 0 (%s)" % code)
            good = [m for _, m in samples if m.quality >= QUALITY_MIN]
            at = [i + 1 for i, (x, b) in enumerate(zip(good, good[1:])) if b.reset_counter != x.reset_counter]
            check(0 < len(at) <= 3, "one reset, and few for what is learned of it later: %s of %d" % (at, len(good)))
            pointed = good[at[-1]:] if at else []
            check(len(pointed) > 60, "%d samples after it" % len(pointed))
            if len(pointed) <= 60:
                print(text)
                return
            t = by_speed(pointed, int((ap.begun - START_S) * 1e6), 1000000 // FPS, truth).t
            # The receiver's east and north are the scenario's x and y.
            noses = [truth.at(x)[1][:, 0] for x in t]
            told = [rotation(m.q[1], m.q[2], m.q[3], m.q[0])[:, 0] for m in pointed]
            off = np.array([math.remainder(math.atan2(b[1], b[0]) - math.atan2(n[0], n[1]), 2 * math.pi) for b, n in zip(told, noses)])
            sigma = np.array([math.sqrt(m.pose_covariance[20]) for m in pointed])
            print("      north known at %.1f s; off by %.2f degrees at the end, sigma told %.2f" %
                  (t[0] - START_S, math.degrees(off[-1]), math.degrees(sigma[-1])))
            check((np.abs(off) > 3 * sigma).mean() <= 0.01, "within three of its sigmas (%.1f at most)" % (np.abs(off) / sigma).max())
            check(sigma.max() < math.radians(4), "which are worth something: %.2f degrees" % math.degrees(sigma.max()))

        def nonsense():
            print("a rangefinder whose stamps are 2 s old, a pressure in hPa, fixes of two dimensions, from the start")

            def lie(t, name, value):
                return ({"range": value, "baro": value / 100, "gnss": 2 / 3, "attitude": value}[name],
                        -2.0 if name == "range" else 0.0)
            text, code, samples, ap = fly(a.program, folder, lie)
            check(code == 0, "flies once and ends with 0 (%s)" % code)
            check("rangefinder is heard and not used: old on arrival" in text, "says that the rangefinder's stamps are old")
            check("barometer is heard and not used: no air that flies has that pressure" in text, "that the pressure is none")
            check("satellites is heard and not used: no fix in three dimensions" in text, "and that there is no fix")
            told = re.findall(r"aids: (\w+): (\d+) measurements taken[^,]*, (\d+) not", text)
            check(len(told) == 3 and all(10 * int(taken) < int(left_out) for _, taken, left_out in told),
                  "and uses none of it but what came before both clocks were compared: %s" % told)
            check(len(samples) > PICTURES / 2, "%d samples of %d pictures, some of which a loaded machine leaves out" % (len(samples), PICTURES))
            # What the inertial sensor comes to by itself is as true as it says.
            if sum(m.quality >= QUALITY_MIN for _, m in samples) > 60:
                examine(truth, samples, ap, text)

        def attitude():
            print("no inertial sensor: the autopilot's attitude and its rangefinder")

            def lie(t, name, value):
                return (value if name in ("range", "attitude") else None), 0.0
            text, code, samples, ap = fly(a.program, folder, lie, "none")
            check(code == 0, "flies once and ends with 0 (%s)" % code)
            check({31, 132} <= ap.intervals.keys(), "asks for the attitude: %s" % sorted(ap.intervals))
            for kind in ("rangefinder", "attitude"):
                check("aids: %s of the autopilot is heard and used" % kind in text, "says that the %s is heard" % kind)
            examine(truth, samples, ap, text)

        def no_attitude():
            print("no inertial sensor and no attitude: rangefinder, barometer and satellites alone")
            text, code, samples, ap = fly(a.program, folder,
                                          lambda t, name, value: (None if name == "attitude" else value, 0.0), "none")
            check(code == 0, "flies once and ends with 0 (%s)" % code)
            check(len(samples) > PICTURES / 2 and all(m.quality == -1 for _, m in samples),
                  "and without a vertical there are no metres: quality -1")
        run_cases({"heard": heard, "faults": faults, "north": north, "nonsense": nonsense, "attitude": attitude, "no_attitude": no_attitude},
                  a.only)


if __name__ == "__main__":
    sys.exit(main())
