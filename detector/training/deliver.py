#!/usr/bin/env python3
"""The weights that are delivered, in one command: trains, exports for the three inputs, and scores what was made.

  deliver.py --data DIR --out RUN --simulated SIM --vehicles SIM2 --models ../models --reference ../../tests/detector/data
             [options of train.py, whole]

With --simulated it trains twice, without and with rendered pictures, and with --vehicles twice more, with pictures that show lorries
and cars from near and cut by the edge (render.py's, of all scenarios), and delivers the mean of all (soup.py): without, more of what is
really seen from above is found, with, more of people and of vehicles that an edge cuts. All options but where and how fast
are train.py's defaults, and the methods'. May be cut off and given again. The figures stand in RUN/figures.json and
RUN/figures.txt; what they replace and whether they are better is for the reader: the files in --models are written last, and
only with --take.
"""
from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import methods
import train

HERE = Path(__file__).resolve().parent


def python(*args: object, **more) -> int:
    return subprocess.run([sys.executable, *map(str, args)], check=False, **more).returncode


def parse(words: list[str] | None = None) -> tuple[argparse.Namespace, list[str]]:
    """Our options, and the words for train.py but --out and --simulated."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False)
    parser.add_argument("--data", required=True)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--models", type=Path, default=HERE.parent / "models")
    parser.add_argument("--reference", type=Path, default=HERE.parents[1] / "tests" / "detector" / "data")
    parser.add_argument("--take", action="store_true", help="also writes the files into --models and --reference")
    parser.add_argument("--simulated", help="a folder of render.py's")
    parser.add_argument("--vehicles", help="another folder of render.py's; with --simulated")
    args, rest = parser.parse_known_args(words)
    if args.vehicles and not args.simulated:
        parser.error("--vehicles is for --simulated")
    own = ["--data", args.data, *rest]
    for _, run in runs(args, own):
        train.parse(run)  # unknown and abbreviated options end here
    return args, own


def runs(args: argparse.Namespace, words: list[str]) -> list[tuple[Path, list[str]]]:
    """The folder and the words of each training."""
    folders = [(args.out / "without", []), (args.out / "with", ["--simulated", args.simulated])] if args.simulated \
        else [(args.out, [])]
    if args.vehicles:
        folders += [(args.out / method, ["--simulated", args.vehicles, "--method", method, "--seed", str(seed)])
                    for seed, method in enumerate(methods.VEHICLES, 1)]
    return [(folder, [*words, "--out", str(folder), *more]) for folder, more in folders]


def main() -> int:
    args, words = parse()
    trained = runs(args, words)
    for _, run in trained:
        if code := python(HERE / "train.py", *run):
            return code
    made = args.out / "models"
    export = [HERE / "export.py", "--checkpoint", *(folder / train.WEIGHTS for folder, _ in trained), "--data", args.data,
              *(["--simulated", args.vehicles] if args.vehicles else [])]
    if code := python(*export, "--out", made):
        return code
    models = sorted(made.glob("*.onnx"))
    last = Path(args.data) / "models" / "yolov5n_416.onnx"
    with open(args.out / "figures.txt", "w", encoding="utf-8") as file:
        if code := python(HERE / "evaluate.py", "--data", args.data, "--resamples", 500, "--json", args.out / "figures.json",
                          *models, last, stdout=file):
            return code
        for more in (["--grey"], ["--tiled"], ["--part", "unseen"]):
            file.write(f"\n{' '.join(more)}\n")
            file.flush()
            if code := python(HERE / "evaluate.py", "--data", args.data, "--rounds", 0, *more, *models, last, stdout=file):
                return code
    print(f"{args.out / 'figures.txt'} has the figures")
    return python(*export, "--out", args.models, "--reference", args.reference) if args.take else 0


if __name__ == "__main__":
    sys.exit(main())
