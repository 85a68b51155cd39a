#!/usr/bin/env python3
"""`godwit doctor` against an emulated autopilot: words, values to set, exit codes. Inside a network namespace:

    with_peers.sh --bus dronecan,pymavlink doctor_command_test.py build/release/firmware_app/godwit SCENARIO SEQUENCE
"""
import math
import os
import re
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from emulated_autopilot import EmulatedAutopilot, RawMulticast, dronecan, mavlink, uavcan  # noqa: E402

FAILURES = []
GOOD = {"CAN_P1_DRIVER": 1, "CAN_D1_PROTOCOL": 1, "CAN_D1_UC_SER_EN": 1, "CAN_D1_UC_S1_NOD": 42, "CAN_D1_UC_S1_IDX": 0,
        "CAN_D1_UC_S1_PRO": 2, "CAN_D1_UC_S1_BD": 921, "VISO_TYPE": 3, "VISO_DELAY_MS": 20, "VISO_QUAL_MIN": 10,
        "VISO_POS_X": 0, "VISO_POS_Y": 0, "VISO_POS_Z": 0, "AHRS_EKF_TYPE": 3, "EK3_ENABLE": 1}
for source, value in (("1", 3), ("2", 6), ("3", 0)):
    for what in ("POSXY", "VELXY", "POSZ", "VELZ", "YAW"):
        GOOD["EK3_SRC%s_%s" % (source, what)] = value
# A scenario of a second is a camera quickly made.
CONFIG = '[camera]\nsource = "sim"\nscenario = "%s"\n'


def check(condition, text):
    print(("ok    " if condition else "FAIL  ") + text, flush=True)
    if not condition:
        FAILURES.append(text)


def doctor(program, ap, *arguments, enters=0):
    """Runs it beside the autopilot; what it said and its exit code. enters: how often Enter is pressed when it asks; then
    its input ends."""
    process = subprocess.Popen([program, "doctor", *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                               stdin=subprocess.PIPE)
    os.set_blocking(process.stdout.fileno(), False)
    text, pressed, end = "", 0, time.monotonic() + 90
    while time.monotonic() < end:
        ap.spin(0.02)
        more = process.stdout.read()
        if more:
            text += more.decode()
        elif process.poll() is not None:
            break
        if not process.stdin.closed and text.count("Then press Enter.") > pressed:
            pressed += 1
            ap.prompts = sum(words in text for words in ("Raise the nose", "lower the right side"))
            ap.spin(0.3)  # the vehicle is moved, then Enter is pressed
            if pressed <= enters:
                process.stdin.write(b"\n")
                process.stdin.flush()
            else:
                process.stdin.close()
    if process.poll() is None:
        process.kill()
        process.wait()
    return text, process.returncode


def autopilot(**changed):
    ap = EmulatedAutopilot()
    ap.parameters = {**GOOD, **changed}
    ap.send_inputs = False
    return ap


def main():
    program, scenario = sys.argv[1:3]
    with tempfile.TemporaryDirectory() as folder:
        config = os.path.join(folder, "c.toml")
        open(config, "w").write(CONFIG % scenario)
        with_bus = ("--config", config, "--can", "multicast:0")

        ap = autopilot()
        text, code = doctor(program, ap, *with_bus, "--delay-ms", "22")
        check(code == 0 and "WRONG" not in text and "all fits" in text, "all fits: exit code %s" % code)
        if code != 0:
            print(text)
        for words in ("the calibration fits its size", "inertial sensor:", "bus multicast:0: open", "its 30 parameters fit",
                      "the camera looks "):
            check(words in text, "tells of: " + words)
        ap.node.close()

        ap = autopilot(VISO_TYPE=0, CAN_D1_UC_S1_NOD=43, VISO_DELAY_MS=90, EK3_SRC2_POSXY=3)
        text, code = doctor(program, ap, *with_bus, "--delay-ms", "22")
        for words in ("Set VISO_TYPE 3.", "Set CAN_D1_UC_S1_NOD 42.", "Set VISO_DELAY_MS 22.", "Set EK3_SRC2_POSXY 6."):
            check(words in text, words)
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

        # Nobody there.
        silent = type("Silent", (), {"spin": staticmethod(time.sleep)})()
        text, code = doctor(program, silent, *with_bus)
        check(code == 1 and "no HEARTBEAT through the tunnel" in text and "CAN_D1_UC_SER_EN 1" in text, "no autopilot")
        text, code = doctor(program, silent)
        check(code == 1 and "camera: none is configured" in text and "no way to it is configured" in text,
              "nothing configured")
        text, code = doctor(program, silent, "--can", "foo")
        check(code == 2 and "expected multicast:N or socketcan:IFACE" in text, "--can foo: exit code %s" % code)

        # The tilt test asks, and says what is missing; its judgement is tested in doctor_test.cpp.
        ap = autopilot()
        text, code = doctor(program, ap, *with_bus, "--tilt", enters=1)
        check("Hold the vehicle level and still. Then press Enter." in text, "the tilt test asks for level")
        check("does not send its attitude" in text, "and says that the autopilot sends no attitude")
        check(code == 1 and "standard input ended" in text, "and ends with its input (%s)" % code)
        ap.node.close()
        # To its end: the autopilot sees the vehicle tilted as asked, the recording shows something else.
        sequence = sys.argv[3]
        if not os.path.exists(os.path.join(sequence, "rgb.txt")):
            check(os.environ.get("CI") != "true", "SKIPPED: the tilt test to its end: %s is not there" % sequence)
        else:
            ap = autopilot()
            ap.prompts = 0
            spin_alone = ap.spin

            def spin(seconds):
                half = math.radians(15)
                q = [(1, 0, 0, 0), (math.cos(half), 0, math.sin(half), 0), (math.cos(half), math.sin(half), 0, 0)][
                    min(ap.prompts, 2)]
                ap.every("attitude", 0.05, lambda: ap.send(mavlink.MAVLink_attitude_quaternion_message(
                    ap.micros() // 1000, *q, 0, 0, 0)))
                spin_alone(seconds)

            ap.spin = spin
            text, code = doctor(program, ap, "--can", "multicast:0", "--sequence", sequence, "--tilt", enters=40)
            check("Raise the nose" in text and "lower the right side" in text, "the tilt test goes through its steps")
            check(code == 1 and re.search("WRONG  tilt test: (The camera hardly saw|No rotation of axes|The axes of)", text),
                  "and says that camera and autopilot do not agree")
            ap.node.close()
    print("%d failed" % len(FAILURES))
    return 1 if FAILURES else 0


if __name__ == "__main__":
    sys.exit(main())
