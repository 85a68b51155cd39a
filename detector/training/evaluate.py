#!/usr/bin/env python3
"""Scores model files on pictures never trained on through OpenCV's DNN module, and times them.

  evaluate.py --data DIR [--tiled] MODEL.onnx [MODEL.onnx ...]

For every set: precision and recall at the best F1, mAP50 and mAP50-95 over the six classes, AP50 of each class, and of
"vehicle" (car, bus and truck as one). Then the same boxes as they fly, from the threshold on and with the suppression that
DecodeOptions in detector/decode.h has: precision and recall of each class and of vehicles, and the recall of people and
vehicles that the picture's edge cuts. With --resamples: AP50 of people and vehicles, small ones apart (longer side below a
twentieth of the picture's), each with the interval in which 95 of 100 draws of the pictures lie, and as a share of that of
the last model on the same draws. --tiled: with squares of wide pictures beside the whole, as `detector.tiled` in the
configuration (detector/tiles.h). The time is that of the network alone, one picture, one thread; several models are timed in
turn, picture by picture, so that they share whatever else the machine does.
"""
from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import cv2
import numpy as np

import bootstrap
import data
import split
from network import Network, Remembered
from scoring import FLYING_OVERLAP, FLYING_SCORE, score_as_flown, score_set

LEAST_ASPECT = 1.25  # of --wide: a camera's pictures are 4:3 and wider


def time_networks(networks: list[Network], rounds: int) -> list[dict]:
    """Milliseconds of one forward pass: elapsed, and of the processor (which other programs do not lengthen as much). `ratio`:
    the processor's time over that of the last network, the median over the rounds, each of which times all in turn."""
    elapsed: list[list[float]] = [[] for _ in networks]
    processor: list[list[float]] = [[] for _ in networks]
    blobs = [np.random.default_rng(0).random((1, 3, n.height, n.width), np.float32) for n in networks]
    for r in range(rounds + 2):
        for i, n in enumerate(networks):
            n.net.setInput(blobs[i])
            wall, cpu = time.perf_counter(), time.thread_time()
            n.net.forward()
            if r >= 2:  # the first two warm up
                elapsed[i].append((time.perf_counter() - wall) * 1e3)
                processor[i].append((time.thread_time() - cpu) * 1e3)
    return [{"elapsed_ms": float(np.median(e)), "cpu_ms": float(np.median(c)), "least_ms": float(np.min(e)),
             "ratio": float(np.median(np.array(c) / np.array(processor[-1])))}
            for e, c in zip(elapsed, processor)]


def as_asked(pictures: list[data.Picture], wide: bool, grey: bool) -> list[data.Picture]:
    if wide:
        pictures = [p for p in pictures if p.image.shape[1] >= LEAST_ASPECT * p.image.shape[0]]
    if grey:
        for p in pictures:
            p.image = cv2.cvtColor(cv2.cvtColor(p.image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    return pictures


def show(v: float | None) -> str:
    return "  -  " if v is None else f"{v:.3f}"


def tell(name: str, source: str, s: dict) -> None:
    print(f"{name:28} {source:13} {s['pictures']:4} pictures  " +
          "  ".join(f"{k} {show(s.get(k))}" for k in ("P", "R", "mAP50", "mAP50_95", "vehicle_AP50")), flush=True)
    for of, ap in s.get("AP50", {}).items():
        print(f"{'':42} {of:11} AP50 {ap:.3f}  ({s['objects'][of]} objects)")
    for of, f in s["as_flown"]["figures"].items():
        print(f"{'':34} as flown {of:19} P {show(f['P'])}  R {show(f['R'])}  ({f['objects']} objects)", flush=True)


def tell_spreads(source: str, tables: dict[str, dict[str, bootstrap.Table]], resamples: int, report: dict) -> None:
    """AP50 of each group with its interval, and as a share of the last model's."""
    last = list(tables.values())[-1]
    for name, groups in tables.items():
        for group, table in groups.items():
            times = bootstrap.draws(len(table.truths), resamples)
            mine = np.array([table.average_precision(t) for t in times])
            low, high = bootstrap.interval(mine)
            figures = {"AP50": table.average_precision(), "low": low, "high": high}
            line = f"AP50 {figures['AP50']:.3f} ({low:.3f} to {high:.3f})"
            if groups is not last and last[group].average_precision() > 0:
                theirs = np.array([last[group].average_precision(t) for t in times])
                low, high = bootstrap.interval(mine / np.where(theirs > 0, theirs, np.nan))
                figures |= {"share": figures["AP50"] / last[group].average_precision(), "share_low": low, "share_high": high}
                line += f", {figures['share']:.3f} ({low:.3f} to {high:.3f}) of the last model's"
            report[name][source].setdefault("spread", {})[group] = figures
            print(f"{name:28} {source:13} {group:14} {line}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", help="folder of the real sets")
    parser.add_argument("--sets", nargs="+", choices=data.SETS, default=list(data.SETS))
    parser.add_argument("--part", choices=split.PARTS, default="held_out", help="of the sets (split.py)")
    parser.add_argument("--simulated", type=Path, nargs="+", default=[], help="folders of render.py's, each as a set")
    parser.add_argument("--least-px", type=float, default=0, help="things whose longer side is less count neither way")
    parser.add_argument("--wide", action="store_true", help="only pictures as wide as a camera's, from 5:4 on")
    parser.add_argument("--grey", action="store_true", help="all pictures made grey")
    parser.add_argument("--tiled", action="store_true", help="look at squares of wide pictures, too")
    parser.add_argument("--score", type=float, default=FLYING_SCORE, help="threshold of the figures as flown")
    parser.add_argument("--resamples", type=int, default=0, help="draws of the pictures for the intervals; 0: none")
    parser.add_argument("--rounds", type=int, default=30, help="timed passes of each model; 0 times nothing")
    parser.add_argument("--json", help="also write the figures to this file")
    parser.add_argument("models", nargs="+", type=Path)
    args = parser.parse_args()
    if args.data is None and not args.simulated:
        parser.error("nothing to score on: --data or --simulated")
    cv2.setNumThreads(1)
    networks = [Network(p, args.tiled) for p in args.models]
    report: dict = {n.path.name: {} for n in networks}
    sets = [(s, Path(args.data), s, args.part) for s in (args.sets if args.data else ())]
    sets += [(f.name, f, "simulated", "held_out") for f in args.simulated]
    for title, root, source, part in sets:
        pictures = as_asked(data.load(root, source, part), args.wide, args.grey)
        if not pictures:
            print(f"{title}: no pictures")
            continue
        data.leave_out_smaller(pictures, args.least_px)
        tables: dict[str, dict[str, bootstrap.Table]] = {}
        for n in networks:
            look = Remembered(n)
            s = score_set(look, pictures)
            s["as_flown"] = {"score": args.score, "overlap": FLYING_OVERLAP,
                             "figures": score_as_flown(look, pictures, args.score)}
            report[n.path.name][title] = s
            tell(n.path.name, title, s)
            if args.resamples:
                tables[n.path.name] = bootstrap.collect(look, pictures)
        if args.resamples:
            tell_spreads(title, tables, args.resamples, report)
    if args.rounds:
        for n, t in zip(networks, time_networks(networks, args.rounds)):
            report[n.path.name]["time"] = t
            print(f"{n.path.name:28} {t['elapsed_ms']:.1f} ms a picture (median), {t['cpu_ms']:.1f} ms of the processor, "
                  f"{t['least_ms']:.1f} ms at best, {t['ratio']:.3f} of the last model's processor time; one thread")
    if args.json:
        Path(args.json).write_text(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
