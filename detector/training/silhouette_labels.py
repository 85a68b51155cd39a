#!/usr/bin/env python3
"""Silhouettes of the people in the COCO pictures, by a network that knows people: what silhouette.py learns from.

  silhouette_labels.py --data DIR --out LABELS [--held-out]

The teacher is MediaPipe Selfie Segmentation (Apache-2.0), which comes with the PyPI package mediapipe; it runs once, on
the picture around each annotated box, and is no part of the program. In a virtual environment of its own:
pip install mediapipe==0.10.14 "numpy<2". Writes LABELS/NAME.npz: image (RGB), covered (0..255: probability that a person
covers the pixel), ignore (1: not known).
"""
from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

import data

PERSON = 0
SMALLEST_PX = 20  # people with a shorter side than this are left out of learning
LEAST_SHARE = 0.15  # of its box that a believable silhouette fills


def around(image: np.ndarray, box: np.ndarray, share: float) -> tuple[np.ndarray, int, int]:
    """The square of `share` times the box's longer side around it, mirrored beyond the edge; and where it begins."""
    h, w = image.shape[:2]
    x, y = (box[:2] + box[2:]) / 2
    half = share * max(box[2] - box[0], box[3] - box[1]) / 2
    x0, y0, x1, y1 = (int(v) for v in (x - half, y - half, x + half, y + half))
    beyond = [max(0, -y0), max(0, y1 - h), max(0, -x0), max(0, x1 - w)]
    wide = cv2.copyMakeBorder(image, *beyond, cv2.BORDER_REFLECT)
    y, x = y0 + beyond[0], x0 + beyond[2]
    return np.ascontiguousarray(wide[y:y + y1 - y0, x:x + x1 - x0]), x0, y0


def label(picture: data.Picture, teacher) -> tuple[np.ndarray, np.ndarray]:
    """Covered and ignore of one picture; `teacher`: square RGB picture -> probabilities of the same size."""
    h, w = picture.image.shape[:2]
    covered, ignore = np.zeros((h, w), np.float32), np.zeros((h, w), np.uint8)
    for box, kind in zip(picture.boxes, picture.labels):
        side = box[2:] - box[:2]
        low = np.maximum(np.floor(box[:2] - 0.03 * side), 0).astype(int)
        high = np.minimum(np.ceil(box[2:] + 0.03 * side), (w, h)).astype(int)
        part = np.s_[low[1]:high[1], low[0]:high[0]]
        if kind != PERSON or side.min() < SMALLEST_PX:
            ignore[part] = np.where(covered[part] > 0.5, ignore[part], 1)
            continue
        crop, x0, y0 = around(picture.image, box, 1.2)
        seen, whole = teacher(crop), np.zeros((h, w), np.float32)
        top, left, bottom, right = max(0, y0), max(0, x0), min(h, y0 + crop.shape[0]), min(w, x0 + crop.shape[1])
        whole[top:bottom, left:right] = seen[top - y0:bottom - y0, left - x0:right - x0]
        if (whole[part] > 0.5).mean() < LEAST_SHARE:
            ignore[part] = 1
        else:
            covered[part] = np.maximum(covered[part], whole[part])
    return (covered * 255).astype(np.uint8), ignore


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, type=Path)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--held-out", action="store_true", help="of val2017, to score with; never learnt")
    args = parser.parse_args()
    import mediapipe  # only here: nothing else needs it

    segmentation = mediapipe.solutions.selfie_segmentation.SelfieSegmentation(model_selection=0)
    args.out.mkdir(parents=True, exist_ok=True)
    people = 0
    for picture in data.load(args.data, "coco", args.held_out, longest_side=640):
        covered, ignore = label(picture, lambda crop: segmentation.process(crop).segmentation_mask)
        people += int((picture.labels == PERSON).sum())
        np.savez_compressed(args.out / f"{picture.name}.npz", image=picture.image, covered=covered, ignore=ignore)
    print(f"{people} people in {len(list(args.out.glob('*.npz')))} pictures")


if __name__ == "__main__":
    main()
