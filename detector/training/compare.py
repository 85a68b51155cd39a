#!/usr/bin/env python3
"""Trains with and without CBAM, alike, three seeds each, and makes the table of the paper's comparison (Table 1).

  compare.py --data DIR --out DIR [--steps N] [any other option of train.py]

Runs that are finished are not repeated and one that was cut off goes on, so the same command may be given again and
again. The table has mean and spread (largest less smallest) over the seeds, on pictures never trained on.
"""
from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
SET_NAMES = {"coco": "COCO val2017 (128)", "visdrone": "VisDrone val (14)", "cats_topdown": "CATS held-out fifth",
             "aerial_cars": "aerial_cars held-out fifth"}


def python(*args: object) -> None:
    subprocess.run([sys.executable, *map(str, args)], check=True)


def one_run(args: argparse.Namespace, rest: list[str], attention: bool, seed: int) -> dict:
    folder = Path(args.out) / f"{'cbam' if attention else 'plain'}_{seed}"
    figures = folder / "figures.json"
    if not figures.exists():
        extra = [] if attention else ["--no-attention"]
        python(HERE / "train.py", "--data", args.data, "--out", folder, "--seed", seed, "--steps", args.steps, *extra, *rest)
        python(HERE / "export.py", "--checkpoint", folder / "checkpoint.pt", "--out", folder, "--sizes", 416)
        model = next(folder.glob("*_416.onnx"))
        python(HERE / "evaluate.py", "--data", args.data, "--json", figures, "--rounds", 0, model)
    return next(iter(json.loads(figures.read_text()).values()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--steps", type=int, default=2500)
    parser.add_argument("--seeds", type=int, default=3)
    args, rest = parser.parse_known_args()
    # Seed by seed, so that a comparison that stops early has as many runs of both.
    runs: dict[bool, list[dict]] = {True: [], False: []}
    for seed in range(args.seeds):
        for attention in (False, True):
            runs[attention].append(one_run(args, rest, attention, seed))
    print("| set | network | P | R | mAP50 | mAP50-95 |\n|---|---|---|---|---|---|")
    for key, name in SET_NAMES.items():
        for attention, label in ((False, "YOLOv5n"), (True, "CBAM-YOLOv5n")):
            values = [[r[key][k] for r in runs[attention]] for k in ("P", "R", "mAP50", "mAP50_95")]
            print(f"| {name} | {label} | " + " | ".join(f"{np.mean(v):.3f} ({np.ptp(v):.3f})" for v in values) + " |")


if __name__ == "__main__":
    main()
