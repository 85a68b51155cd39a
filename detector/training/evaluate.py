#!/usr/bin/env python3
"""Scores a model file on the held-out pictures through OpenCV's DNN module, and times it.

  evaluate.py --data DIR [--tiled] MODEL.onnx [MODEL.onnx ...]

For every set: precision and recall at the best F1, mAP50 and mAP50-95 over the six classes, AP50 of each class, and of
"vehicle" (car, bus and truck as one). Then the same boxes as they fly, from the threshold on and with the suppression that
DecodeOptions in detector/decode.h has: precision and recall of each class and of vehicles, and the recall of people and
vehicles that the picture's edge cuts. --tiled: with squares of wide pictures beside the whole, as `detector.tiled` in the
configuration (detector/tiles.h). The time is that of the network alone, one picture, one thread; several models are timed
in turn, picture by picture, so that they share whatever else the machine does.
"""
from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

import data
from augment import BORDER
from metrics import ClassScore, FlyingScore, best_f1, nms
from names import CLASSES, COCO_INDEX, STRIDES

VEHICLE_NUMBERS = tuple(data.VEHICLE_CLASSES)
FLYING_SCORE, FLYING_OVERLAP = 0.25, 0.45  # DecodeOptions of detector/decode.h


def square_tiles(width: int, height: int, most: int = 8) -> list[tuple[int, int, int, int]]:
    """Left, top, width and height of the tiles of detector/tiles.h."""
    longer, shorter = max(width, height), min(width, height)
    side = max(shorter, -(-4 * longer // (4 + 3 * (most - 1))))
    if side >= longer or 4 * longer <= 5 * shorter:
        return []
    step = max(1, side - -(-side // 4))
    count = min(most, 1 + -(-(longer - side) // step))
    at = [i * (longer - side) // (count - 1) for i in range(count)]
    return [(a, 0, side, shorter) if width >= height else (0, a, shorter, side) for a in at]


@dataclass
class Network:
    """A model file of either layout, with 6 or 80 classes."""

    path: Path
    tiled: bool = False

    def __post_init__(self) -> None:
        self.net = cv2.dnn.readNetFromONNX(str(self.path))
        self.size = next((s for s in (416, 320, 640) if self._runs(s)), 0)
        if not self.size:
            raise ValueError(f"{self.path}: runs at none of 416, 320 and 640 pixels")
        rows, values = self._forward(np.zeros((1, 3, self.size, self.size), np.float32)).shape
        cells = sum((self.size // s) ** 2 for s in STRIDES)
        if rows not in (cells, 3 * cells) or values not in (11, 85):
            raise ValueError(f"{self.path}: output of {rows} x {values} is neither YOLOv5 nor YOLOX of 6 or 80 classes")
        self.yolox = rows == cells
        self.columns = [5 + i for i in (range(len(CLASSES)) if values == 11 else COCO_INDEX)]

    def _forward(self, blob: np.ndarray) -> np.ndarray:
        self.net.setInput(blob)
        return self.net.forward()[0]

    def _runs(self, size: int) -> bool:
        try:
            rows = self._forward(np.zeros((1, 3, size, size), np.float32)).shape[0]
        except cv2.error:
            return False
        cells = sum((size // s) ** 2 for s in STRIDES)
        return rows in (cells, 3 * cells)

    def blob(self, image: np.ndarray) -> tuple[np.ndarray, float, int, int]:
        h, w = image.shape[:2]
        scale = self.size / max(h, w)
        nw, nh = round(w * scale), round(h * scale)
        left, top = (0, 0) if self.yolox else ((self.size - nw) // 2, (self.size - nh) // 2)
        canvas = np.full((self.size, self.size, 3), BORDER, np.uint8)
        canvas[top:top + nh, left:left + nw] = cv2.resize(image, (nw, nh), interpolation=cv2.INTER_LINEAR)
        planes = canvas.transpose(2, 0, 1)[None].astype(np.float32)
        return (np.ascontiguousarray(planes[:, ::-1]) if self.yolox else planes / 255), scale, left, top

    def detect(self, image: np.ndarray, threshold: float) -> tuple[np.ndarray, np.ndarray]:
        """Boxes x0 y0 x1 y1 in picture pixels and n x 6 scores; nothing suppressed yet."""
        looks = [self._look(image, threshold)]
        h, w = image.shape[:2]
        for left, top, tw, th in square_tiles(w, h) if self.tiled else ():
            boxes, scores = self._look(np.ascontiguousarray(image[top:top + th, left:left + tw]), threshold)
            boxes = boxes + (left, top, left, top)
            near = max(tw, th) / 33
            cut = (((boxes[:, 0] < left + near) & (left > 0)) | ((boxes[:, 2] > left + tw - near) & (left + tw < w)) |
                   ((boxes[:, 1] < top + near) & (top > 0)) | ((boxes[:, 3] > top + th - near) & (top + th < h)))
            looks.append((boxes[~cut], scores[~cut]))
        return np.concatenate([b for b, _ in looks]), np.concatenate([s for _, s in looks])

    def _look(self, image: np.ndarray, threshold: float) -> tuple[np.ndarray, np.ndarray]:
        blob, scale, left, top = self.blob(image)
        y = self._forward(blob).copy()
        if self.yolox:
            at = 0
            for stride in STRIDES:
                n = self.size // stride
                gy, gx = np.mgrid[:n, :n].reshape(2, -1)
                part = y[at:at + n * n]
                part[:, 0], part[:, 1] = (part[:, 0] + gx) * stride, (part[:, 1] + gy) * stride
                part[:, 2:4] = np.exp(part[:, 2:4]) * stride
                at += n * n
        scores = y[:, 4:5] * y[:, self.columns]
        sure = scores.max(1) > threshold
        y, scores = y[sure], scores[sure]
        boxes = np.concatenate((y[:, :2] - y[:, 2:4] / 2, y[:, :2] + y[:, 2:4] / 2), 1)
        boxes = (boxes - (left, top, left, top)) / scale
        h, w = image.shape[:2]
        return np.clip(boxes, 0, (w, h, w, h)), scores


def score_set(network: Network, pictures: list[data.Picture], threshold: float = 0.01) -> dict:
    classes = {i: ClassScore() for i in range(len(CLASSES))}
    vehicle = ClassScore()
    only_vehicles = any((p.labels == data.VEHICLE).any() for p in pictures)
    for p in pictures:
        boxes, scores = network.detect(p.image, threshold)
        row, label = np.nonzero(scores > threshold)
        kept = nms(boxes[row], scores[row, label], label)
        row, label = row[kept], label[kept]
        unknown = p.boxes[p.labels == data.VEHICLE]
        for i, c in classes.items():
            mine = label == i
            # A vehicle of unknown kind is right for none and wrong for none.
            ignore = np.concatenate((p.ignore, unknown)) if i in VEHICLE_NUMBERS else p.ignore
            c.add(boxes[row[mine]], scores[row[mine], i], p.boxes[p.labels == i], ignore)
        best = scores[:, VEHICLE_NUMBERS].max(1) if len(scores) else np.zeros(0)
        sure = np.flatnonzero(best > threshold)
        kept = sure[nms(boxes[sure], best[sure], np.zeros(len(sure)))]
        vehicle.add(boxes[kept], best[kept], p.boxes[np.isin(p.labels, (*VEHICLE_NUMBERS, data.VEHICLE))], p.ignore)
    present = [i for i, c in classes.items() if c.truths]
    out: dict = {"pictures": len(pictures), "vehicle_AP50": float(vehicle.average_precision()[0]) if vehicle.truths else None,
                 "vehicles": vehicle.truths}
    if present:
        ap = {i: classes[i].average_precision() for i in present}
        precision, recall = best_f1([classes[i] for i in present])
        out |= {"P": precision, "R": recall, "mAP50": float(np.mean([a[0] for a in ap.values()])),
                "mAP50_95": float(np.mean([a.mean() for a in ap.values()])),
                "AP50": {CLASSES[i]: float(a[0]) for i, a in ap.items()},
                "objects": {CLASSES[i]: classes[i].truths for i in present}}
    elif only_vehicles:
        precision, recall = best_f1([vehicle])
        ap = vehicle.average_precision()
        out |= {"P": precision, "R": recall, "mAP50": float(ap[0]), "mAP50_95": float(ap.mean())}
    return out


def cut_by_edge(boxes: np.ndarray, width: int, height: int, near: float = 0.01) -> np.ndarray:
    """Which boxes end at the picture's edge, as CarrierLimits::cut_off_share says."""
    dx, dy = near * width, near * height
    return (boxes[:, 0] < dx) | (boxes[:, 1] < dy) | (boxes[:, 2] > width - dx) | (boxes[:, 3] > height - dy)


def score_as_flown(network: Network, pictures: list[data.Picture], score: float = FLYING_SCORE,
                   overlap: float = FLYING_OVERLAP) -> dict:
    """Precision and recall at one threshold. Each row of the network gives a box of its best class only, as Decoder does;
    "NAME at the edge" has what the picture cuts off."""
    found: dict[str, FlyingScore] = {}
    for p in pictures:
        boxes, scores = network.detect(p.image, score)
        label = scores.argmax(1) if len(scores) else np.zeros(0, np.int64)
        best = scores.max(1) if len(scores) else np.zeros(0)
        kept = nms(boxes, best, label, overlap, most=128)
        boxes, best, label = boxes[kept], best[kept], label[kept]
        unknown = p.boxes[p.labels == data.VEHICLE]
        h, w = p.image.shape[:2]
        groups = [(CLASSES[i], (i,), (i,), np.concatenate((p.ignore, unknown)) if i in VEHICLE_NUMBERS else p.ignore)
                  for i in range(len(CLASSES))]
        groups.append(("vehicle", VEHICLE_NUMBERS, (*VEHICLE_NUMBERS, data.VEHICLE), p.ignore))
        for name, mine, theirs, ignore in groups:
            said, truth = np.isin(label, mine), p.boxes[np.isin(p.labels, theirs)]
            found.setdefault(name, FlyingScore()).add(boxes[said], best[said], truth, ignore)
            if name in ("person", "vehicle"):
                cut = cut_by_edge(truth, w, h)
                # What hits a whole one counts neither way here.
                found.setdefault(f"{name} at the edge", FlyingScore()).add(
                    boxes[said], best[said], truth[cut], np.concatenate((ignore, truth[~cut])))
    out = {name: f.figures() for name, f in found.items() if f.truths}
    for name in out:
        if name.endswith("edge"):
            out[name]["P"] = None  # a wrong box is wrong anywhere
    return out


def time_networks(networks: list[Network], rounds: int) -> list[dict]:
    """Milliseconds of one forward pass: elapsed, and of the processor (which other programs do not lengthen as much)."""
    elapsed: list[list[float]] = [[] for _ in networks]
    processor: list[list[float]] = [[] for _ in networks]
    blobs = [np.random.default_rng(0).random((1, 3, n.size, n.size), np.float32) for n in networks]
    for r in range(rounds + 2):
        for i, n in enumerate(networks):
            n.net.setInput(blobs[i])
            wall, cpu = time.perf_counter(), time.thread_time()
            n.net.forward()
            if r >= 2:  # the first two warm up
                elapsed[i].append((time.perf_counter() - wall) * 1e3)
                processor[i].append((time.thread_time() - cpu) * 1e3)
    return [{"elapsed_ms": float(np.median(e)), "cpu_ms": float(np.median(c)), "least_ms": float(np.min(e))}
            for e, c in zip(elapsed, processor)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True)
    parser.add_argument("--sets", nargs="+", choices=data.SETS, default=list(data.SETS))
    parser.add_argument("--tiled", action="store_true", help="look at squares of wide pictures, too")
    parser.add_argument("--score", type=float, default=FLYING_SCORE, help="threshold of the figures as flown")
    parser.add_argument("--rounds", type=int, default=30, help="timed passes of each model; 0 times nothing")
    parser.add_argument("--json", help="also write the figures to this file")
    parser.add_argument("models", nargs="+", type=Path)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    networks = [Network(p, args.tiled) for p in args.models]
    report: dict = {n.path.name: {} for n in networks}
    for source in args.sets:
        pictures = data.load(Path(args.data), source, held_out=True)
        for n in networks:
            s = score_set(n, pictures)
            report[n.path.name][source] = s
            show = lambda v: "  -  " if v is None else f"{v:.3f}"  # noqa: E731
            print(f"{n.path.name:24} {source:13} {s['pictures']:4} pictures  " +
                  "  ".join(f"{k} {show(s.get(k))}" for k in ("P", "R", "mAP50", "mAP50_95", "vehicle_AP50")), flush=True)
            for name, ap in s.get("AP50", {}).items():
                print(f"{'':38} {name:11} AP50 {ap:.3f}  ({s['objects'][name]} objects)")
            s["as_flown"] = {"score": args.score, "overlap": FLYING_OVERLAP,
                             "figures": score_as_flown(n, pictures, args.score)}
            for name, f in s["as_flown"]["figures"].items():
                print(f"{'':30} as flown {name:19} P {show(f['P'])}  R {show(f['R'])}  ({f['objects']} objects)", flush=True)
    if args.rounds:
        for n, t in zip(networks, time_networks(networks, args.rounds)):
            report[n.path.name]["time"] = t
            print(f"{n.path.name:24} {t['elapsed_ms']:.1f} ms a picture (median), {t['cpu_ms']:.1f} ms of the processor, "
                  f"{t['least_ms']:.1f} ms at best; one thread")
    if args.json:
        Path(args.json).write_text(json.dumps(report, indent=1))


if __name__ == "__main__":
    main()
