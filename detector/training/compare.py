#!/usr/bin/env python3
"""Trains with and without CBAM, alike, on the same views in the same order, and tells what CBAM changes.

  compare.py --data DIR --out DIR [--seeds N] [--resamples N] [any other option of train.py, whole]

Runs that are finished are not repeated and one that was cut off goes on, so the same command may be given again and again; a
folder with runs or figures of other options is refused. For each set, people and vehicles, of all sizes and small: AP50 at
416 of both, with less without seed by seed, its mean, and the interval in which 95 of 100 draws of the pictures put that
mean. It counts only where the gates of CBAM follow what they see (choose.py) in every run; else "not tested" stands there.
"""
from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np

import bootstrap
import checkpoint
import choose
import data
import train
from export import network_of_run
from network import Network

HERE = Path(__file__).resolve().parent
TITLES = {("coco", "held_out"): "COCO val2017", ("visdrone", "held_out"): "VisDrone val",
          ("cats_topdown", "held_out"): "CATS, last fifths", ("cats_topdown", "unseen"): "CATS, folders 5 and 6",
          ("aerial_cars", "held_out"): "aerial_cars, last fifths", ("aerial_cars", "unseen"): "aerial_cars, MunichStreet"}
# Compared by: not for the one who calls to say.
OURS = ("--seed", "--no-attention", "--data", "--out")


def python(*args: object, may_stop: bool = False) -> None:
    code = subprocess.run([sys.executable, *map(str, args)], check=False).returncode
    if may_stop and code == train.INTERRUPTED:
        raise SystemExit(code)
    if code:
        raise SystemExit(f"compare.py: {Path(str(args[0])).name} ended with {code}")


def train_words(args: argparse.Namespace, rest: list[str], attention: bool, seed: int, folder: Path) -> list[str]:
    return ["--data", args.data, "--out", str(folder), "--seed", str(seed), *([] if attention else ["--no-attention"]), *rest]


def collect_all(model: Path, root: Path) -> dict:
    network, out = Network(model), {}
    for source, part in TITLES:
        pictures = data.load(root, source, part)
        if pictures:
            out[f"{source} {part}"] = {g: t.to_json() for g, t in bootstrap.collect(network, pictures).items()}
    return out


def figures_of(args: argparse.Namespace, rest: list[str], attention: bool, seed: int) -> dict:
    """Trains, exports and scores one run, each only if that is not done yet."""
    folder = Path(args.out) / f"{'cbam' if attention else 'plain'}_{seed}"
    words = train_words(args, rest, attention, seed, folder)
    wanted = train.identity(train.parse(words))
    file = folder / "figures.json"
    if file.exists():
        held = json.loads(file.read_text())
        check_same(file, held["options"], wanted)
        return held
    python(HERE / "train.py", *words, may_stop=True)
    weights = folder / train.WEIGHTS
    python(HERE / "export.py", "--checkpoint", weights, "--out", folder, "--input", 416)
    model = next(folder.glob("*_416.onnx"))
    _, _, gates = network_of_run(weights, newest=False)
    held = {"options": wanted, "pictures_sha256": checkpoint.load(weights)["options"]["pictures_sha256"], "gates": gates,
            "model_sha256": hashlib.sha256(model.read_bytes()).hexdigest(), "tables": collect_all(model, Path(args.data))}
    part = file.with_suffix(".part")
    part.write_text(json.dumps(held))
    part.replace(file)
    return held


def check_same(file: Path, theirs: dict, wanted: dict) -> None:
    differ = [f"{k} {theirs.get(k)!r} there, {wanted.get(k)!r} here" for k in sorted(theirs.keys() | wanted.keys())
              if theirs.get(k) != wanted.get(k)]
    if differ:
        raise SystemExit(f"compare.py: {file} holds figures of other options ({'; '.join(differ)}); give another --out")


def verdict(without: list[dict], with_attention: list[dict], resamples: int) -> list[str]:
    """The lines of the report. `without` and `with_attention`: figures of the runs, seed by seed."""
    digests = {f["pictures_sha256"] for f in (*without, *with_attention)}
    if len(digests) > 1:
        raise SystemExit("compare.py: the runs have not seen the same pictures; give another --out")
    spreads = [choose.spread(f["gates"]) for f in with_attention]
    lines = ["Spread of the gates by seed: " + ", ".join(f"{s:.4f}" for s in spreads)
             + f" (to count: {choose.LEAST_SPREAD} and more)."]
    if min(spreads) < choose.LEAST_SPREAD:
        return [*lines, "CBAM: not tested. Its gates stayed too near to constants for these runs to say anything of it."]
    lines += ["| set | of | without | with | difference by seed | mean | 95 % of draws |", "|---|---|---|---|---|---|---|"]
    for (source, part), title in TITLES.items():
        key = f"{source} {part}"
        if key not in without[0]["tables"]:
            continue
        for group in without[0]["tables"][key]:
            pairs = [tuple(bootstrap.Table.from_json(f["tables"][key][group]) for f in pair) for pair in zip(without, with_attention)]
            d = bootstrap.difference(pairs, resamples)
            means = [np.mean([p[i].average_precision() for p in pairs]) for i in (0, 1)]
            lines.append(f"| {title} ({len(pairs[0][0].truths)}) | {group} | {means[0]:.3f} | {means[1]:.3f} | "
                         + ", ".join(f"{v:+.3f}" for v in d["by_seed"])
                         + f" | {d['mean']:+.3f} | {d['low']:+.3f} to {d['high']:+.3f} |")
    return lines


def parse(words: list[str] | None = None) -> tuple[argparse.Namespace, list[str]]:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False)
    parser.add_argument("--data", required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--resamples", type=int, default=1000)
    args, rest = parser.parse_known_args(words)
    mine = [w for w in rest if w.split("=")[0] in OURS]
    if mine or args.seeds < 1 or args.resamples < 40:
        parser.error(f"{mine[0]} is for compare.py to give" if mine else "--seeds must be at least 1, --resamples at least 40")
    train.parse(train_words(args, rest, True, 0, Path(args.out)))  # unknown and abbreviated options end here
    return args, rest


def main() -> None:
    args, rest = parse()
    cv2.setNumThreads(1)
    # Seed by seed, so that a comparison that stops early has as many runs of both.
    runs: dict[bool, list[dict]] = {False: [], True: []}
    for seed in range(args.seeds):
        for attention in (False, True):
            runs[attention].append(figures_of(args, rest, attention, seed))
    print("\n".join(verdict(runs[False], runs[True], args.resamples)))


if __name__ == "__main__":
    main()
