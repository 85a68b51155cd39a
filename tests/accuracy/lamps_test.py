#!/usr/bin/env python3
"""Lamps on the mains under a rolling shutter: neighbouring pictures cannot be laid on each other there.

  lamps_test.py GODWIT

Flies ten seconds of the simulated flicker-100hz and fails where a frame after the first pose is not tracked in the one map, or
its error is larger than vision's usual there. Some 8 of its 109 frames were followed to where chance put twelve features.
"""
import json
import pathlib
import subprocess
import sys
import tempfile

from replay_runs import ate_m


def main():
    with tempfile.TemporaryDirectory() as folder:
        out = pathlib.Path(folder)
        subprocess.run([sys.argv[1], "fly", "flicker-100hz", "--seed", "1", "--frames", "300", "--sequential", "--out", str(out)],
                       check=True, stdout=subprocess.DEVNULL)
        s = json.loads((out / "summary.json").read_text())
        share, ate = s["tracked_share_after_first_pose"], ate_m(out, out)
    print(f"{s['maps']} map, first pose after {s['first_pose_after_frames']} frames, from there on {share:.2%} tracked, ATE {ate:.4f} m")
    return 0 if s["maps"] == 1 and share >= 0.99 and ate < 0.05 else 1


if __name__ == "__main__":
    sys.exit(main())
