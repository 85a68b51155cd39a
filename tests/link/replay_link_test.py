#!/usr/bin/env python3
"""`godwit replay --pace real --can multicast:0` against an emulated autopilot: what leaves on the bus is the replayed
trajectory, and an autopilot with ArduPilot's rules takes it. Run it inside a network namespace (with_peers.sh --bus):

    with_peers.sh --bus dronecan,pymavlink,numpy replay_link_test.py build/release/firmware_app/godwit SEQUENCE [--seconds 60 --strict]

--strict also holds the rate to 30 +- 0.5 Hz and our own time to 1 ms, which a busy machine need not reach. --realtime runs
godwit's threads under SCHED_FIFO as in flight; it needs root, and `unshare -n` in place of with_peers.sh's `unshare -rn`.
"""
import argparse
import csv
import json
import math
import os
import struct
import subprocess
import sys
import tempfile
import time
import zlib

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import numpy as np  # noqa: E402
from checks import check, run_cases  # noqa: E402
from emulated_autopilot import EmulatedAutopilot, Sniffer, VisionRules, uavcan  # noqa: E402

WINDOW, GAP_S = 6, 0.3  # of the velocity fit
# 0.35 rad down, off the body's centre.
C, D = math.cos(0.35), math.sin(0.35)
R_BODY_CAM = np.array([[0, -D, C], [1, 0, 0], [0, C, D]])
ARM = np.array([0.2, 0.05, -0.1])
FRD = np.diag([1.0, -1, -1])
REALTIME = "".join("[threads.%s]\npriority = %d\n" % x for x in
                   (("camera", 60), ("tracker", 50), ("mapper", 10), ("link", 55)))
CONFIG = "[link]\nT_body_cam = [%s, 0, 0, 0, 1]\n" % ", ".join(
    "%.17g" % x for row, t in zip(R_BODY_CAM, ARM) for x in (*row, t))


def black_png(width, height, shade=0):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    rows = zlib.compress((b"\0" + bytes([shade]) * width) * height)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)) +
            chunk(b"IDAT", rows) + chunk(b"IEND", b""))


def make_sequence(source, folder, seconds, black=(), missing=()):
    """The sequence forth and back for so long, its time running on; pictures of some indices black or missing."""
    lines = [w for w in (line.split() for line in open(os.path.join(source, "rgb.txt"))) if w and w[0][0] != "#"]
    times = [float(w[0]) for w in lines]
    os.makedirs(folder)
    os.symlink(os.path.join(os.path.abspath(source), "rgb"), os.path.join(folder, "rgb"))
    calibration = open(os.path.join(source, "camera.yaml")).read()
    open(os.path.join(folder, "camera.yaml"), "w").write(calibration)
    open(os.path.join(folder, "black.png"), "wb").write(black_png(640, 480))
    t, i, step = 1000.0, 0, 1
    with open(os.path.join(folder, "rgb.txt"), "w") as out:
        k = 0
        while t - 1000.0 < seconds:
            name = "black.png" if k in black else "no_such.jpg" if k in missing else lines[i][1]
            out.write("%.6f %s\n" % (t, name))
            k += 1
            if not 0 <= i + step < len(times):
                step = -step
            t += abs(times[i + step] - times[i])
            i += step


def start(program, sequence, out, *arguments):
    return subprocess.Popen([program, "replay", sequence, "--out", out, "--pace", "real", "--can", "multicast:0", *arguments],
                            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def fly(program, sequence, out, ap, *arguments):
    """Runs to the end while the autopilot answers; what it printed, and its exit code."""
    process = start(program, sequence, out, *arguments)
    end = time.monotonic() + 200
    while process.poll() is None and time.monotonic() < end:
        ap.spin(0.05)
    return process.communicate(timeout=5)[0], process.returncode


def rotation(x, y, z, w):
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def rotation_vector(R):
    angle = math.acos(max(-1.0, min(1.0, (np.trace(R) - 1) / 2)))
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return axis * (0.5 if angle < 1e-9 else angle / (2 * math.sin(angle)))


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def expectations(out):
    """From pose.csv, by our own arithmetic: capture time in the sequence's own nanoseconds -> what the message must say.
    Also the frames that went through the tracker, and those of them without a pose."""
    frames = list(csv.DictReader(open(os.path.join(out, "frames.csv"))))
    moved = {f["t"] for f in frames if f["map_moved"] == "1"}
    rows = {r["t"]: r for r in csv.DictReader(open(os.path.join(out, "pose.csv")))}
    # A picture that is the one before costs neither state nor pose: nothing is sent for it.
    repeated = {f["t"] for f in frames if f["t"] not in rows and f["state"] in ("TRACKING", "COASTING")}
    processed = [f["t"] for f in frames if f["fate"] == "processed" and f["t"] not in repeated]
    expected, history, order = {}, [], {t: i for i, t in enumerate(processed)}
    previous_t = None
    for text in processed:
        if text not in rows:
            history, previous_t = [], None
            continue
        r = rows[text]
        t = float(text)
        R_map = rotation(*(float(r[k]) for k in ("qx", "qy", "qz", "qw")))
        R_world_map = FRD @ R_BODY_CAM
        R = R_world_map @ R_map
        p = R_world_map @ np.array([float(r[k]) for k in ("tx", "ty", "tz")])
        if history and (history[-1][3] != r["map_id"] or t - history[-1][0] > GAP_S):
            history = []
        history = history[-(WINDOW - 1):] + [(t, p, R, r["map_id"], text in moved)]
        cov = np.zeros((6, 6))
        for i in range(6):
            for j in range(i, 6):
                cov[i, j] = cov[j, i] = float(r["c%d%d" % (i, j)])
        A = np.kron(np.eye(2), R)
        cov = A @ cov @ A.T
        R_body = R @ R_BODY_CAM.T
        # The body's origin from the camera, in metres, while the map that passes for metric is in units of its own: left out.
        arm = np.zeros(3)
        J = np.block([[FRD, -FRD @ skew(arm)], [np.zeros((3, 3)), FRD]])
        e = {"q": FRD @ R_body, "p": FRD @ (p + arm), "cov": J @ cov @ J.T, "v": None, "first": len(history) < 2}
        still = not any(h[4] for h in history[1:])
        if len(history) >= 2 and still:
            ts = np.array([h[0] - t for h in history])
            X = np.array([h[1] for h in history])
            degree = 2 if len(history) >= 4 else 1
            velocity = np.array([np.polyfit(ts, X[:, k], degree)[-2] for k in range(3)])
            rate = rotation_vector(history[-2][2].T @ R) / (t - history[-2][0])
            e["v"] = R_body.T @ (velocity + np.cross(R @ rate, arm))
            e["w"] = R_BODY_CAM @ rate
        expected[text] = e
    return expected, processed


def nanoseconds(text):
    whole, part = text.split(".")
    return int(whole) * 1_000_000_000 + int(part)


def compare(samples, out):
    """Matches messages with frames by capture time, which differ by one constant, and compares every field."""
    expected, processed = expectations(out)
    by_time = {}
    stamps = np.array([nanoseconds(t) // 1000 for t in processed], dtype=np.int64)
    # The constant: the one that most messages agree on with some frame (to the microsecond that the message keeps).
    votes = {}
    for _, m in samples[:40]:
        for s in stamps[:200]:
            votes[(m.time_usec - s) // 4] = votes.get((m.time_usec - s) // 4, 0) + 1
    offset = max(votes, key=votes.get) * 4 + 2
    for text, s in zip(processed, stamps):
        by_time[int(s)] = text
    worst = {"position": 0.0, "attitude": 0.0, "covariance": 0.0, "velocity": 0.0, "rates": 0.0}
    good = unmatched = wrong_quality = compared_velocity = matched = 0
    for _, m in samples:
        near = stamps[np.argmin(np.abs(stamps + offset - m.time_usec))]
        if abs(near + offset - m.time_usec) > 5:
            unmatched += m.quality > 0
            continue
        matched += 1
        e = expected.get(by_time[int(near)])
        has_pose = e is not None and not e["first"]
        if has_pose != (m.quality > 0):
            wrong_quality += 1
        if not has_pose or m.quality <= 0:
            continue
        good += 1
        w, x, y, z = m.q
        worst["position"] = max(worst["position"], np.abs(e["p"] - [m.x, m.y, m.z]).max())
        worst["attitude"] = max(worst["attitude"], np.abs(e["q"] - rotation(x, y, z, w)).max())
        told = np.zeros((6, 6))
        told[np.triu_indices(6)] = m.pose_covariance
        scale = np.sqrt(np.outer(np.diag(e["cov"]), np.diag(e["cov"]))) + 1e-8
        tame = np.triu(np.ones((6, 6))) * (np.diag(e["cov"]) > 1e-8).all()
        worst["covariance"] = max(worst["covariance"], (np.abs(told - e["cov"]) / scale * tame).max())
        if e["v"] is not None:
            compared_velocity += 1
            worst["velocity"] = max(worst["velocity"], np.abs(e["v"] - [m.vx, m.vy, m.vz]).max())
            worst["rates"] = max(worst["rates"], np.abs(e["w"] - [m.rollspeed, m.pitchspeed, m.yawspeed]).max())
    return good, unmatched, wrong_quality, compared_velocity, worst, offset, matched


def odometry(program, source, seconds, strict, realtime):
    print("replay for %d s" % seconds)
    with tempfile.TemporaryDirectory() as folder:
        sequence, out, config = (os.path.join(folder, n) for n in ("sequence", "out", "c.toml"))
        make_sequence(source, sequence, seconds)
        open(config, "w").write(CONFIG + (REALTIME if realtime else ""))
        sniffer, ap = Sniffer(0), EmulatedAutopilot()
        text, code = fly(program, sequence, out, ap, "--bench-metric", "--config", config)
        ap.node.close()
        check(code == 0, "flew to its end (%s)" % code)
        if code != 0:
            print(text)
            return
        samples = sniffer.odometry()
        good, unmatched, wrong_quality, velocities, worst, _, matched = compare(samples, out)
        summary = json.load(open(os.path.join(out, "summary.json")))
    link = summary["link"]
    span = (samples[-1][1].time_usec - samples[0][1].time_usec) * 1e-6
    rate = (len(samples) - 1) / span
    # On a busy machine frames are dropped before the tracker, and while none comes quality -1 is sent in their place: what
    # must be there is a message for each frame that went through.
    check(matched + link["poses_paced"] + link["pictures_repeated"] >= summary["processed"] - 3,
          "%d frames through the tracker, %d messages with theirs, %d gave way to newer ones; ODOMETRY at %.3f Hz for %.1f s" %
          (summary["processed"], matched, link["poses_paced"], rate, span))
    if strict:
        check(abs(rate - 30) <= 0.5, "that is 30 +- 0.5 Hz")
    print("      %d good poses of %d tracked frames, %d with a velocity to compare" % (good, summary["tracked"], velocities))
    check(good > 0 and velocities > 0, "there is something to compare")
    check(unmatched == 0 and wrong_quality == 0, "every pose is that of its frame, quality > 0 where there is one and only there")
    check(worst["position"] < 1e-5 and worst["attitude"] < 1e-6 and worst["covariance"] < 1e-4,
          "position, attitude and covariance equal the trajectory: %.1e m, %.1e, %.1e of sigma^2" %
          (worst["position"], worst["attitude"], worst["covariance"]))
    check(worst["velocity"] < 1e-4 and worst["rates"] < 1e-4,
          "and velocity and turn rates: %.1e m/s, %.1e rad/s" % (worst["velocity"], worst["rates"]))
    rules = VisionRules()
    for t, m in samples:
        rules.take(t, m)
    late = [r for r in rules.refused if "ms" in r[1]]
    other = [r for r in rules.refused if "ms" not in r[1]]
    check(not other and (not late or not strict),
          "both ArduPilot versions' rules take all %d samples: otherwise refused %s, by interval %d %s" %
          (len(samples), other[:3], len(late), late[:2]))
    check(ap.questions_answered > seconds / 4 and len(ap.answers_to_us) > seconds / 4,
          "TIMESYNC: %d questions of ours, %d answers to the autopilot" % (ap.questions_answered, len(ap.answers_to_us)))
    if good >= 70:
        check(link["timesync"] and link["latency_p50_ms"] > 0 and "VISO_DELAY_MS %d" % link["viso_delay_ms"] in text,
              "latency p50 %s p99 %s ms, VISO_DELAY_MS %s, in summary.json and on the screen" %
              (link["latency_p50_ms"], link["latency_p99_ms"], link["viso_delay_ms"]))
        check(any("VISO_DELAY_MS" in t for t in ap.texts), "and as STATUSTEXT")
    else:
        check(link["viso_delay_ms"] is None and "too few poses" in text, "too few good poses for a latency, and it says so")
    check(0 < link["bus_load_percent"] <= 25, "bus load %.1f %% of 1 Mbit/s" % link["bus_load_percent"])
    print("      pose to last frame, on the clock: p50 %s p99 %s most %s ms; load average %s" %
          (link["own_p50_ms"], link["own_p99_ms"], link["own_max_ms"], os.getloadavg()))
    if strict:
        check(link["own_p99_ms"] <= 1, "p99 at most 1 ms")
    check(link["poses_replaced"] == 0 and link["messages_refused"] == 0 and link["messages_abandoned"] == 0, "nothing was dropped")


def without_scale(program, source):
    print("without --bench-metric")
    with tempfile.TemporaryDirectory() as folder:
        sniffer, ap = Sniffer(0), EmulatedAutopilot()
        _, code = fly(program, source, os.path.join(folder, "out"), ap, "--frames", "90")
        ap.node.close()
    samples = [m for _, m in sniffer.odometry()]
    check(code == 0 and len(samples) > 40 and all(m.quality == -1 and (m.x, m.y, m.z, m.vx) == (0, 0, 0, 0) for m in samples),
          "%d samples, all of quality -1, none with a position" % len(samples))


def lost_and_silent(program, source):
    black, missing = range(100, 130), range(200, 230)
    print("black pictures %d to %d, missing ones %d to %d" % (black[0], black[-1], missing[0], missing[-1]))
    with tempfile.TemporaryDirectory() as folder:
        sequence, out = os.path.join(folder, "sequence"), os.path.join(folder, "out")
        make_sequence(source, sequence, 10, black, missing)
        sniffer, ap = Sniffer(0), EmulatedAutopilot()
        config = os.path.join(folder, "c.toml")
        open(config, "w").write(CONFIG)
        _, code = fly(program, sequence, out, ap, "--bench-metric", "--config", config)
        ap.node.close()
        check(code == 0, "flew to its end")
        frames = list(csv.DictReader(open(os.path.join(out, "frames.csv"))))
        samples = sniffer.odometry()
        _, unmatched, wrong_quality, _, _, offset, _ = compare(samples, out)
    check(unmatched == 0 and wrong_quality == 0, "quality -1 with every frame that has no pose, and with no other")
    lost = [f for i, f in enumerate(frames) if i in black and f["fate"] == "processed"]
    stamps = [nanoseconds(f["t"]) // 1000 + offset for f in lost]
    sent = {s: [m for _, m in samples if abs(m.time_usec - s) <= 5] for s in stamps}
    first = next((i for i, s in enumerate(stamps) if sent[s]), None)
    check(first is not None and first <= 1 and sent[stamps[first]][0].quality == -1, "the first black frame is told (%s)" % first)
    seen = [(m.x, m.y, m.z, m.time_usec) for _, m in samples if m.quality > 0]
    check(len({s[:3] for s in seen}) == len(seen), "no pose is frozen: none of %d was sent twice" % len(seen))
    last = max(nanoseconds(f["t"]) for i, f in enumerate(frames) if i < missing[0] and f["fate"] == "processed") / 1000 + offset
    statuses = sniffer.statuses()
    errors = [t for t, s in statuses if s.health == 2 and t > last * 1e-6]
    arrival = next((t for t, m in samples if abs(m.time_usec - last) <= 5), last * 1e-6)
    check(errors and errors[0] - arrival < 0.3,
          "camera silent: health ERROR %.1f ms after the last pose" % (1e3 * (errors[0] - arrival) if errors else -1))
    reasons = [s.vendor_specific_status_code for t, s in statuses if s.health == 2 and t > last * 1e-6]
    check(reasons and reasons[0] & 8 and not reasons[0] & 1 and any(r & 1 for r in reasons) and not any(r & 4 for r in reasons),
          "first the missing poses are the reason, then the camera is named, never the process: %s" % [hex(r) for r in reasons])
    during = [m for t, m in samples if last + 150e3 < m.time_usec < last + 900e3]
    check(len(during) > 8 and all(m.quality == -1 for m in during), "meanwhile the stream goes on with quality -1 (%d)" % len(during))
    gaps = [b[0] - a[0] for a, b in zip(samples, samples[1:])]
    check(max(gaps) < 0.3, "and never pauses for 300 ms (longest %.0f)" % (1e3 * max(gaps)))


def restarted(program, source):
    print("RestartNode")
    with tempfile.TemporaryDirectory() as folder:
        ap = EmulatedAutopilot()
        process = start(program, source, os.path.join(folder, "out"))
        ap.spin(2.0)
        answer = ap.request(uavcan.protocol.RestartNode.Request(magic_number=0xACCE551B1E))
        end = time.monotonic() + 5
        while process.poll() is None and time.monotonic() < end:
            ap.spin(0.05)
        ap.node.close()
        check(answer is not None and answer.ok and process.poll() == 75, "granted, and the tool ends with 75 (%s)" % process.poll())
        if process.poll() is None:
            process.kill()
        check(not os.path.exists(os.path.join(folder, "out", "summary.json")), "without passing for a whole run")


def daemon(program, scenario):
    print("godwitd")
    godwitd = os.path.join(os.path.dirname(program), "godwitd")
    with tempfile.TemporaryDirectory() as folder:
        config = os.path.join(folder, "c.toml")
        text = '[camera]\nsource = "sim"\nscenario = "%s"\npictures = 20\n[can]\nbus = "multicast:0"\n[link]\n' % scenario
        open(config, "w").write(text + 'bench_metric = true\n')
        refused = subprocess.run([godwitd, "--config", config], capture_output=True, text=True)
        check(refused.returncode == 2 and "c.toml:8: link.bench_metric" in refused.stderr, "refuses bench_metric")
        # The autopilot here tells an attitude and a distance, too: with them there would be metres.
        open(config, "w").write(text + 'state_folder = "%s"\n[aids]\nattitude = false\n' % folder)
        sniffer, ap = Sniffer(0), EmulatedAutopilot()
        process = subprocess.Popen([godwitd, "--config", config], stderr=subprocess.PIPE, text=True)
        end = time.monotonic() + 60
        while process.poll() is None and len(sniffer.odometry()) < 5 and time.monotonic() < end:
            ap.spin(0.5)  # its node is there at once; its pictures are rendered and its networks run first
        ap.spin(4)
        info = ap.request(uavcan.protocol.GetNodeInfo.Request())
        process.terminate()
        said = process.communicate(timeout=20)[1]
        ap.node.close()
        if process.returncode != 0:
            print(said)
        check(process.returncode == 0 and "link: " in said and "ODOMETRY sent" in said and "thread gw-link:" in said, "flies, tells its figures, ends with 0")
        check(info is not None and str(info.name) == "org.godwit.vio" and info.status.health == 0, "its node is there and well")
        samples = [m for _, m in sniffer.odometry()]
        check(len(samples) > 20 and all(m.quality == -1 and m.x == 0 for m in samples),
              "%d ODOMETRY, all of quality -1: it knows no scale" % len(samples))
        check(os.path.exists(os.path.join(folder, "link_reset_counter.txt")), "keeps its reset counter")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("sequence", help="folder in TUM layout, 640 x 480")
    parser.add_argument("--scenario", help="a simulated scenario's file, for godwitd")
    parser.add_argument("--seconds", type=int, default=10)
    parser.add_argument("--strict", action="store_true")
    parser.add_argument("--realtime", action="store_true")
    parser.add_argument("--only", default="")
    args = parser.parse_args()
    if not os.path.exists(os.path.join(args.sequence, "rgb.txt")):
        print("SKIPPED: %s is not there" % args.sequence)
        return 1 if os.environ.get("CI") == "true" else 77
    cases = {"odometry": lambda: odometry(args.program, args.sequence, args.seconds, args.strict, args.realtime),
             "unscaled": lambda: without_scale(args.program, args.sequence),
             "lost": lambda: lost_and_silent(args.program, args.sequence),
             "restart": lambda: restarted(args.program, args.sequence)}
    if args.scenario:
        cases["daemon"] = lambda: daemon(args.program, args.scenario)
    run_cases(cases, args.only)


if __name__ == "__main__":
    sys.exit(main())
