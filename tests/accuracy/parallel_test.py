#!/usr/bin/env python3
"""The same sequence with all stages in threads, and in one: the accuracy must be the same within a fifth.

  parallel_test.py GODWIT SEQUENCE_NAME

Threads run differently each time, so the median of three runs counts. Exit status 77: the sequence is not there (a failure
where CI=true).
"""
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile


def main():
    godwit, name = sys.argv[1], sys.argv[2]
    root = pathlib.Path(__file__).resolve().parents[2]
    shared = pathlib.Path(os.environ.get("GODWIT_SHARED_DIR", root.parent / "shared"))
    sequence = shared / "data" / name
    if not (sequence / "rgb.txt").exists():
        print(f"skipped: there is no {sequence}")
        return 1 if os.environ.get("CI") == "true" else 77

    def ate(out, *options):
        subprocess.run([godwit, "replay", str(sequence), "--out", str(out), *options], check=True,
                       stdout=subprocess.DEVNULL)
        summary = json.loads((out / "summary.json").read_text())
        assert summary["tracked_share_after_first_pose"] > 0.99 and summary["maps"] == 1, summary
        said = subprocess.run([sys.executable, str(root / "scripts" / "evaluate"), str(sequence / "groundtruth.txt"),
                               str(out), "--json"], check=True, capture_output=True, text=True).stdout
        return json.loads(said)["ate_m"]

    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        one = ate(folder / "one", "--sequential")
        threads = [ate(folder / f"threads{i}") for i in range(3)]
    print(f"{name}: ATE {one:.4f} m sequential, {', '.join(f'{a:.4f}' for a in threads)} m in threads")
    return 0 if statistics.median(threads) <= 1.2 * one else 1


if __name__ == "__main__":
    sys.exit(main())
