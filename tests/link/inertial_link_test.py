#!/usr/bin/env python3
"""Flights with an inertial sensor, by `godwit replay --imu on --pace real --can multicast:0`, against an emulated
autopilot: what it fuses is where the aircraft was. Run it inside a network namespace (with_peers.sh --bus):

    with_peers.sh --bus dronecan,pymavlink,numpy inertial_link_test.py build/release/firmware_app/godwit SEQUENCE|SCENARIO.toml

SEQUENCE: a recording with imu.txt and groundtruth_body.txt, through a second of black pictures; and by godwitd as it is, also with
poses between its pictures. SCENARIO.toml: a simulated minute, through one second of them, through three, after which the map is found again, and through seven, after which there
is another map.
"""
import argparse
import csv
import json
import math
import os
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import numpy as np  # noqa: E402
from checks import check, run_cases  # noqa: E402
from emulated_autopilot import EmulatedAutopilot, Sniffer, VisionRules  # noqa: E402
from inertial_truth import Fused, Truth, by_speed, clock_offset, offset_by_speed, scale_and_ate  # noqa: E402
from replay_link_test import black_png, fly, nanoseconds  # noqa: E402

FPS = 30
RECORDING_BLACK_S = (9.0, 10.0)  # coasted through, while it moves
BLACK_S = (16.0, 17.0)  # coasted through
DARK_S = (24.0, 27.0)   # too long to coast, and the old map is still in view
LOST_S = (36.0, 43.0)   # out of its sight
QUALITY_MIN = 1


def make_flight(program, scenario, folder, seed):
    """The scenario on file, some of its pictures black. Two shades in turn: the same one over and over is a frozen
    camera."""
    subprocess.run([program, "sim", scenario, "--seed", str(seed), "--out", folder], check=True, stdout=subprocess.DEVNULL)
    index = os.path.join(folder, "rgb.txt")
    lines = [line for line in open(index) if line.strip() and line[0] != "#"]
    return blacken(folder, lines, (BLACK_S, DARK_S, LOST_S))


def take_recording(source, folder):
    """The recording, some of its pictures black."""
    os.makedirs(folder)
    for name in ("rgb", "camera.yaml", "imu.txt"):
        os.symlink(os.path.join(os.path.abspath(source), name), os.path.join(folder, name))
    lines = [line for line in open(os.path.join(source, "rgb.txt")) if line.strip() and line[0] != "#"]
    return blacken(folder, lines, (RECORDING_BLACK_S,))


def blacken(folder, lines, spans):
    """Writes rgb.txt of these lines, those in the spans [s after the first] black; the first one's time."""
    index = os.path.join(folder, "rgb.txt")
    first = float(lines[0].split()[0])
    camera = open(os.path.join(folder, "camera.yaml")).read()
    size = [int(line.split(":")[1]) for key in ("width", "height") for line in camera.splitlines() if line.startswith(key + ":")]
    for shade in range(2):
        open(os.path.join(folder, "black%d.png" % shade), "wb").write(black_png(*size, shade=shade))
    with open(index, "w") as out:
        for i, line in enumerate(lines):
            t = float(line.split()[0])
            black = any(a <= t - first < b for a, b in spans)
            out.write("%s %s\n" % (line.split()[0], "black%d.png" % (i % 2)) if black else line)
    return first


def fly_by_imu(program, sequence, out):
    """The flight's ODOMETRY messages as the bus had them, (time of arrival, message); None where it did not end well."""
    sniffer, ap = Sniffer(0), EmulatedAutopilot()
    text, code = fly(program, sequence, out, ap, "--imu", "on", "--detector", "off")
    ap.node.close()
    check(code == 0, "flew to its end (%s)" % code)
    if code != 0:
        print(text)
        return None
    return sniffer.odometry()


def recording(program, source):
    a, b = RECORDING_BLACK_S
    print("a recording through %.0f s of black" % (b - a))
    with tempfile.TemporaryDirectory() as folder:
        sequence, out = os.path.join(folder, "sequence"), os.path.join(folder, "out")
        take_recording(source, sequence)
        truth = Truth(os.path.join(source, "groundtruth_body.txt"))
        samples = fly_by_imu(program, sequence, out)
        if samples is None:
            return
        frames = list(csv.DictReader(open(os.path.join(out, "frames.csv"))))
    processed = [f for f in frames if f["fate"] == "processed"]
    offset = clock_offset(samples, [nanoseconds(f["t"]) // 1000 for f in processed])
    begin = nanoseconds(frames[0]["t"]) * 1e-9
    rules = VisionRules(quality_min=QUALITY_MIN)
    for t, m in samples:
        rules.take(t, m)
    other = [r for r in rules.refused if "ms" not in r[1]]
    check(not other, "both ArduPilot versions' rules refuse none of %d samples for what is in it: %s" % (len(samples), other[:3]))
    check(all(m.estimator_type == 3 for _, m in samples), "all of them say that an inertial sensor takes part")
    fused = [m for _, m in samples if m.quality >= QUALITY_MIN]
    refused = [m for _, m in samples if m.quality < QUALITY_MIN]
    check(any(m.quality == -1 for _, m in samples[:5]), "before scale and vertical are known the quality is -1")
    check(all(m.quality == -1 and m.pose_covariance[0] >= 1e4 and m.vx == m.vy == m.vz == 0 for m in refused),
          "and what has quality -1 is at rest and has a sigma of 100 m: %d samples" % len(refused))
    check(len(fused) > 0.5 * len(processed), "%d samples of %d pictures were fused" % (len(fused), len(processed)))
    if len(fused) < 100:
        return
    f = Fused(fused, offset, truth)
    print("      metric after %.2f s; quality %d to %d" % (f.t[0] - begin, f.quality.min(), f.quality.max()))
    error = np.linalg.norm(f.error, axis=1)
    check((error <= 3 * f.sigma).all(),
          "the position is never off by more than three of the sigmas told: %.3f m at most, sigma %.3f to %.3f m" %
          (error.max(), f.sigma.min(), f.sigma.max()))
    seen = ~f.during(begin + a, begin + b + 0.2)
    scale, ate = scale_and_ate(f.place[seen], f.true_place[seen])
    check(abs(scale - 1) <= 0.025, "the scale is off by %+.2f %% (2.5 allowed)" % (100 * (scale - 1)))
    check(ate <= 0.03, "the place by %.3f m (0.03 allowed)" % ate)
    check(f.tilt.mean() <= 0.6, "level to %.2f degrees in the mean, %.2f at most" % (f.tilt.mean(), f.tilt.max()))
    speed = math.sqrt((f.speed_error[seen] ** 2).sum(axis=1).mean())
    check(speed <= 0.05, "the velocity is the body's, along the body's axes: off by %.3f m/s RMS" % speed)
    dark = f.during(begin + a + 0.1, begin + b - 0.025)  # half a picture before the first that sees again
    check(dark.sum() > 10, "in the second without pictures poses go on: %d" % dark.sum())
    if dark.any():
        grown = np.linalg.norm(f.error[dark] - f.error[f.t < begin + a][-1], axis=1).max()
        check(grown <= 0.10, "and stray by %.3f m (0.10 allowed)" % grown)
        check(f.quality[dark].max() <= 50, "their quality is halved: %d at most" % f.quality[dark].max())
        check(f.sigma[dark][-1] > f.sigma[dark][0], "their sigma grows: %.4f to %.4f m" % (f.sigma[dark][0], f.sigma[dark][-1]))
    check(f.during(begin + b + 0.5, 1e18).any(), "after it pictures are flown by again")
    check(len({m.reset_counter for m in fused}) == 1, "no reset was told: the frame is one")


def stamps_of(source, name):
    """The recording's own times of its pictures, whole microseconds."""
    return [nanoseconds(line.split()[0]) // 1000 for line in open(os.path.join(source, name)) if line[0] != "#"]


def fly_daemon(program, source, link=""):
    """godwitd flies the recording by its sensor: the messages as the bus had them, its exit code, what it said."""
    godwitd = os.path.join(os.path.dirname(program), "godwitd")
    with tempfile.TemporaryDirectory() as folder:
        config, said = os.path.join(folder, "c.toml"), os.path.join(folder, "said")
        open(config, "w").write('[camera]\nsource = "replay"\nsequence = "%s"\n[imu]\nsource = "replay"\n'
                                '[detector]\nenabled = false\n[can]\nbus = "multicast:0"\n[link]\nstate_folder = "%s"\n%s' %
                                (os.path.abspath(source), folder, link))
        sniffer, ap = Sniffer(0), EmulatedAutopilot()
        with open(said, "w") as log:
            process = subprocess.Popen([godwitd, "--config", config], stderr=log)
            end = time.monotonic() + 120
            while process.poll() is None and time.monotonic() < end:
                ap.spin(0.05)
            process.terminate()
            code = process.wait(timeout=20)
        ap.node.close()
        text = open(said).read()
    check(code == 0 and "IMU: flown by" in text, "flies the recording once, by its sensor, and ends with 0 (%s)" % code)
    if code != 0:
        print(text)
    return sniffer.odometry(), code, text


def daemon(program, source):
    print("godwitd with [imu]")
    truth = Truth(os.path.join(source, "groundtruth_body.txt"))
    stamps = stamps_of(source, "rgb.txt")
    samples, code, text = fly_daemon(program, source)
    fused = [m for _, m in samples if m.quality >= QUALITY_MIN]
    check(len(fused) > 0.5 * len(stamps), "%d samples of %d pictures were fused" % (len(fused), len(stamps)))
    if code != 0 or len(fused) < 100:
        print(text)
        return
    check(all(m.estimator_type == 3 for m in fused), "all of them say that an inertial sensor takes part")
    f = by_speed(fused, clock_offset(samples, stamps), stamps[1] - stamps[0], truth)
    error = np.linalg.norm(f.error, axis=1)
    check((error <= 3 * f.sigma).all(),
          "the position is never off by more than three of the sigmas told: %.3f m at most" % error.max())
    scale, ate = scale_and_ate(f.place, f.true_place)
    check(abs(scale - 1) <= 0.025 and ate <= 0.03, "the scale is off by %+.2f %%, the place by %.3f m" % (100 * (scale - 1), ate))
    told = np.degrees([math.sqrt(m.pose_covariance[15] + m.pose_covariance[18]) for m in fused])
    check(f.tilt.mean() <= 1.2, "level to %.2f degrees in the mean (1.2 allowed), %.2f at most; sigma told %.2f to %.2f" %
          (f.tilt.mean(), f.tilt.max(), told.min(), told.max()))
    speed = math.sqrt((f.speed_error ** 2).sum(axis=1).mean())
    check(speed <= 0.05, "the velocity is the body's, along the body's axes: off by %.3f m/s RMS" % speed)


def between(program, source):
    print("poses between pictures, 40 a second from 20 pictures a second")
    truth = Truth(os.path.join(source, "groundtruth_body.txt"))
    pictures = stamps_of(source, "rgb.txt")
    samples, code, text = fly_daemon(program, source, "rate = 40\nbetween_pictures = true\n")
    fused = [m for _, m in samples if m.quality >= QUALITY_MIN]
    if code != 0 or len(fused) < 100:
        return check(False, "poses were fused: %d\n%s" % (len(fused), text))
    stamps = np.array([m.time_usec for m in fused])
    check((np.diff(stamps) > 0).all(), "stamps only grow")
    span = (stamps[-1] - stamps[0]) * 1e-6
    check(len(fused) > 0.8 * 40 * span, "%d samples in %.1f s: %.1f a second, from %d pictures" %
          (len(fused), span, len(fused) / span, len(pictures)))
    f = Fused(fused, offset_by_speed(fused, pictures[0], truth), truth)
    error = np.linalg.norm(f.error, axis=1)
    check((error <= 3 * f.sigma).all(),
          "the position is never off by more than three of the sigmas told: %.3f m at most, sigma %.3f to %.3f m" %
          (error.max(), f.sigma.min(), f.sigma.max()))
    scale, ate = scale_and_ate(f.place, f.true_place)
    check(abs(scale - 1) <= 0.025 and ate <= 0.03, "the scale is off by %+.2f %%, the place by %.3f m" % (100 * (scale - 1), ate))
    speed = math.sqrt((f.speed_error ** 2).sum(axis=1).mean())
    check(speed <= 0.05, "the velocity is the body's, along the body's axes: off by %.3f m/s RMS" % speed)
    # A carried pose that the next picture corrects is a tooth: how far one message is off beside the one before.
    teeth = np.linalg.norm(np.diff(f.error, axis=0), axis=1)
    share = (teeth <= 3 * f.sigma[1:]).mean()
    check(share == 1, "no tooth is longer than three of the sigmas told: %.1f mm RMS, %.1f at most" %
          (1e3 * math.sqrt((teeth ** 2).mean()), 1e3 * teeth.max()))
    check(len({m.reset_counter for m in fused}) == 1, "no reset was told")


def autopilot(program, scenario, seed):
    print("a minute through %.0f, %.0f and %.0f s of black" % tuple(b - a for a, b in (BLACK_S, DARK_S, LOST_S)))
    with tempfile.TemporaryDirectory() as folder:
        sequence, out = os.path.join(folder, "sequence"), os.path.join(folder, "out")
        first = make_flight(program, scenario, sequence, seed)
        truth = Truth(os.path.join(sequence, "groundtruth_body.txt"))
        samples = fly_by_imu(program, sequence, out)
        if samples is None:
            return
        frames = list(csv.DictReader(open(os.path.join(out, "frames.csv"))))
        summary = json.load(open(os.path.join(out, "summary.json")))
    processed = [f for f in frames if f["fate"] == "processed"]
    stamps = [nanoseconds(f["t"]) // 1000 for f in processed]
    offset = clock_offset(samples, stamps)
    begin = nanoseconds(frames[0]["t"]) * 1e-9
    black, night, lost = [tuple(begin + s for s in span) for span in (BLACK_S, DARK_S, LOST_S)]

    rules = VisionRules(quality_min=QUALITY_MIN)
    for t, m in samples:
        rules.take(t, m)
    other = [r for r in rules.refused if "ms" not in r[1]]
    late = [r for r in rules.refused if "ms" in r[1]]
    check(not other, "both ArduPilot versions' rules refuse none of %d samples for what is in it: %s" % (len(samples), other[:3]))
    print("      %d came too close or too late on this machine: %s; of %d pictures %d were flown" %
          (len(late), late[:2], summary["frames"] if "frames" in summary else len(frames), len(processed)))
    check(all(m.estimator_type == 3 for _, m in samples), "all of them say that an inertial sensor takes part")
    check(any(m.quality == -1 for _, m in samples[:30]), "before scale and vertical are known the quality is -1")

    good = [m for _, m in samples if m.quality >= QUALITY_MIN]
    check(len(good) > 0.4 * len(processed), "%d samples were fused" % len(good))
    if len(good) < 100:
        return
    f = by_speed(good, offset, stamps[1] - stamps[0], truth)
    print("      metric after %.2f s; quality %d to %d" % (f.t[0] - begin, f.quality.min(), f.quality.max()))
    error = np.linalg.norm(f.error, axis=1)
    outside = (error > 3 * f.sigma).mean()
    check(outside <= 0.003, "the position is off by more than three of the sigmas told in %.2f %% of them (0.3 allowed)" % (100 * outside))

    flown = f.during(f.t[0], black[0])
    scale, ate = scale_and_ate(f.place[flown], f.true_place[flown])
    path = truth.path(f.t[0], black[0])
    check(abs(scale - 1) <= 0.01, "until the first black picture the scale is off by %+.2f %% (1 allowed)" % (100 * (scale - 1)))
    check(ate <= 0.003 * path, "and the position by %.3f m of %.1f m flown (0.3 %%: %.3f)" % (ate, path, 0.003 * path))
    # Straight on, nobody can tell the simulated accelerometer's bias of 0.05 m/s^2 an axis from a tilt of 0.3 degrees.
    told = np.degrees([math.sqrt(m.pose_covariance[15] + m.pose_covariance[18]) for m in good])
    check((f.tilt <= 3 * told).all() and f.tilt.mean() <= 0.8,
          "level to %.2f degrees in the mean (0.8 allowed), %.2f at most; sigma told %.2f to %.2f" %
          (f.tilt.mean(), f.tilt.max(), told.min(), told.max()))
    turned_told = np.degrees([math.sqrt(m.pose_covariance[20]) for m in good])
    check((np.abs(f.turn) <= 3 * turned_told).all() and np.abs(f.turn).max() <= 0.5,
          "and heads right to %.2f degrees at most (0.5 allowed), through all of it; sigma told %.2f to %.2f" %
          (np.abs(f.turn).max(), turned_told.min(), turned_told.max()))
    speed = math.sqrt((f.speed_error ** 2).sum(axis=1).mean())
    check(speed <= 0.1, "the velocity is the body's, along the body's axes: off by %.3f m/s RMS, %.3f at most" %
          (speed, np.linalg.norm(f.speed_error, axis=1).max()))

    dark = f.during(black[0] + 0.1, black[1])
    check(dark.sum() > 10, "in the second without pictures poses go on: %d" % dark.sum())
    if dark.any():
        before = f.error[f.t < black[0]][-1]
        grown = np.linalg.norm(f.error[dark] - before, axis=1).max()
        check(grown <= 0.10, "and stray by %.3f m (0.10 allowed)" % grown)
    again = f.t[f.during(night[1], night[1] + 3)]
    check(len(again) > 0 and again[0] - night[1] <= 1.0,
          "after three seconds without they come again within a second: %s" % (again[:1] - night[1]))
    tracked_in = {r["map_id"] for r in processed if r["tracked"] == "1" and begin <= nanoseconds(r["t"]) * 1e-9 < lost[0]}
    check(len(tracked_in) == 1, "in the same map: %s" % sorted(tracked_in))
    if len(again):
        # One pose of few points, tens of metres away, was 0.05 to 0.104 m off, more on a loaded machine; the place is the
        # median's. The scale alone may be off by 1 % of the way flown in the dark.
        beside = np.linalg.norm(f.error[f.during(night[1], again[0] + 0.5)] - f.error[f.t < night[0]][-1], axis=1)
        way = truth.path(night[0], again[0])
        check(np.median(beside) <= 0.10, "and where it was: in half a second %.3f m beside the last one before (median of %d poses; "
              "0.10 allowed)" % (np.median(beside), len(beside)))
        check(beside.max() <= 0.02 * way, "none of them further than %.3f m, after %.1f m in the dark (2 %%: %.3f)" %
              (beside.max(), way, 0.02 * way))
    check(not f.during(lost[0] + 3, lost[1]).any(), "but not for ever: after three seconds of the seven there is none")
    after = f.during(lost[1], 1e18)
    check(after.any(), "and they come again after the seven: %s" %
          ("%.2f s later" % (f.t[after][0] - lost[1]) if after.any() else "never"))
    maps = {r["map_id"] for r in processed if r["tracked"] == "1"}
    check(len(maps) >= 2, "in another map: %s" % sorted(maps))
    resets = [b.reset_counter - a.reset_counter for a, b in zip(good, good[1:])]
    check(not any(resets), "no reset is told: %s" % [r for r in resets if r])
    if after.any():
        blind = truth.path(lost[0], f.t[after][0])
        jump = np.linalg.norm(f.error[after][0] - f.error[f.t < lost[0]][-1])
        print("      %.1f m were flown between the last pose and the next; the place is off by %.2f m more, sigma told %.2f m" %
              (blind, jump, f.sigma[after][0]))
        check(jump <= 0.04 * blind, "what was flown in the dark is in the position")
        scale, ate = scale_and_ate(f.place[after], f.true_place[after])
        print("      in the new map: scale %+.2f %%, off by %.3f m of %.1f m" %
              (100 * (scale - 1), ate, truth.path(f.t[after][0], f.t[-1])))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("source")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--only", default="")
    args = parser.parse_args()
    if os.path.isdir(args.source):
        cases = {"recording": lambda: recording(args.program, args.source), "daemon": lambda: daemon(args.program, args.source),
                 "between": lambda: between(args.program, args.source)}
    else:
        cases = {"autopilot": lambda: autopilot(args.program, args.source, args.seed)}
    run_cases(cases, args.only)


if __name__ == "__main__":
    sys.exit(main())
