#!/usr/bin/env python3
"""Accuracy on a real sequence, with the share of frames tracked beside it, always together.

  accuracy_test.py GODWIT SEQUENCE_NAME

Runs `godwit replay --sequential` from several start offsets and prints the table; fails where a bar is missed. Also: two
runs are equal to the bit, and a run cut short is a prefix of the whole one. Exit status 77: the sequence is not there
(a failure where CI=true).
"""
import pathlib
import sys
import tempfile

from replay_runs import ate_m, find_sequence, replay

# Share tracked in one map after the first pose, ATE after Sim(3) [m], frames before the first pose, peak memory [MB].
BARS = {"tum_fr1_xyz": (0.99, 0.010, 10, 120), "euroc_mh01": (0.99, 0.006, 20, 120)}
OFFSETS = (0, 37, 111)


def main():
    godwit, name = sys.argv[1], sys.argv[2]
    sequence = find_sequence(name)
    share_bar, ate_bar, init_bar, memory_bar = BARS[name]
    failures = []
    print(f"{name}: bars {share_bar:.0%} tracked, ATE {ate_bar} m, first pose within {init_bar} frames")
    print("start  tracked  maps   ATE [m]  first pose after  peak [MB]")
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        for start in OFFSETS:
            out = folder / str(start)
            s = replay(godwit, sequence, out, "--sequential", "--start", str(start))
            ate = ate_m(sequence, out)
            share = s["tracked_share_after_first_pose"] if s["maps"] == 1 else 0.0
            print(f"{start:5d}  {share:7.2%}  {s['maps']:4d}  {ate:8.4f}  {s['first_pose_after_frames']:16d}  "
                  f"{s['peak_memory_mb']:9.1f}")
            if share < share_bar:
                failures.append(f"start {start}: {share:.2%} tracked in one map")
            if not ate <= ate_bar:
                failures.append(f"start {start}: ATE {ate:.4f} m")
            if s["first_pose_after_frames"] > init_bar:
                failures.append(f"start {start}: first pose after {s['first_pose_after_frames']} frames")
            if s["peak_memory_mb"] > memory_bar:
                failures.append(f"start {start}: {s['peak_memory_mb']} MB")
        whole = (folder / "0" / "trajectory.tum").read_text()
        replay(godwit, sequence, folder / "again", "--sequential")
        if (folder / "again" / "trajectory.tum").read_text() != whole:
            failures.append("two sequential runs differ")
        replay(godwit, sequence, folder / "short", "--sequential", "--frames", "400")
        if not whole.startswith((folder / "short" / "trajectory.tum").read_text()):
            failures.append("a run of 400 frames is no prefix of the whole run")
    for f in failures:
        print("MISSED:", f)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
