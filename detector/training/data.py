"""The detection sets in one form: RGB pictures, boxes in pixels, the six classes, and regions that are left out.

Every set is split by a fixed rule before anything else sees it, so that no training run can touch the held-out part:
COCO val2017 and VisDrone val are held out as published; of each aerial set the last fifth of every flight (by frame
number) is held out, because neighbouring frames of a flight show the same cars.
"""
from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from names import COCO_INDEX

VEHICLE = -1  # a vehicle of unknown kind: learnt as a car, but calling it a bus or a truck costs nothing
IGNORE = -2  # not scored and not learnt
VEHICLE_CLASSES = (2, 4, 5)

# Each set's own class numbers -> ours. Tricycles are vehicles of none of the six kinds.
_CATS = {0: VEHICLE}
_AERIAL = {0: 2, 1: 5, 2: 4, 3: VEHICLE, 4: 1}
_VISDRONE = {0: 0, 1: 0, 2: 1, 3: 2, 4: 2, 5: 5, 6: IGNORE, 7: IGNORE, 8: 4, 9: 3}
_COCO = {coco: ours for ours, coco in enumerate(COCO_INDEX)}

# Class numbers that a set's label files may hold.
KNOWN = {"coco": frozenset(range(80)), "cats_topdown": frozenset(_CATS), "aerial_cars": frozenset(_AERIAL),
         "visdrone": frozenset(_VISDRONE)}
# Vehicles cut by the edge are not all labelled in cats_topdown: along it, so deep as this share of the picture's side,
# nothing is learnt but what is labelled. Half the longer side of a whole vehicle there (median 0.15 of the picture over
# 2,394 boxes; 714 cut ones are labelled), so that where the strip ends the middle of every cut one is behind it.
EDGE_SHARE = 0.075
# COCO writes no label file for a picture without any of its 80 classes; these two of the part here are such.
COCO_WITHOUT_OBJECTS = frozenset({"000000000250", "000000000508"})

# Pictures that other tests of the project cut their walking figures from: never trained on.
SPRITE_SOURCES = frozenset({"000000000113", "000000000241", "000000009483"})
HELD_OUT_SHARE = 5  # one in five
FLIGHT_GAP = 40  # frame numbers further apart than this belong to two flights
# Each step draws half its views from COCO (which the teacher sees too), a quarter from VisDrone and a quarter from these in
# turns: small vehicles take longest to learn.
VEHICLE_TURNS = ("aerial_cars", "aerial_cars", "cats_topdown")
SETS = ("coco", "cats_topdown", "aerial_cars", "visdrone")


@dataclass
class Picture:
    name: str
    source: str
    image: np.ndarray  # height x width x 3, RGB, 8 bit
    boxes: np.ndarray  # n x 4, x0 y0 x1 y1 in pixels
    labels: np.ndarray  # n, our class or VEHICLE
    ignore: np.ndarray = field(default_factory=lambda: np.zeros((0, 4), np.float32))


def _flight(stem: str) -> tuple[str, int]:
    """Frame name -> flight and number in it ("DJI_0005-0018" -> "DJI_0005", 18; "Drone2_(489)" -> "Drone2", 489)."""
    match = re.fullmatch(r"(.*?)[-_ ]*\(?(\d+)\)?", stem)
    if match is None:
        raise ValueError(f"frame name without a number: {stem}")
    return match.group(1), int(match.group(2))


def _split_flights(stems: list[str]) -> tuple[list[str], list[str]]:
    flights: dict[str, list[tuple[int, str]]] = {}
    for stem in stems:
        flight, number = _flight(stem)
        flights.setdefault(flight, []).append((number, stem))
    for flight in list(flights):
        frames = sorted(flights.pop(flight))
        part = 0
        for i, (number, stem) in enumerate(frames):
            part += int(i > 0 and number - frames[i - 1][0] > FLIGHT_GAP)
            flights.setdefault(f"{flight}/{part}", []).append((number, stem))
    train, held_out = [], []
    for frames in flights.values():
        cut = len(frames) - len(frames) // HELD_OUT_SHARE
        train += [s for _, s in frames[:cut]]
        held_out += [s for _, s in frames[cut:]]
    return sorted(train), sorted(held_out)


def names(root: Path, source: str, held_out: bool) -> list[str]:
    """Stems of the pictures of one set, of the part that is trained on or of the part that is held out."""
    if source == "coco":
        folder = root / "coco256" / "images" / ("val2017" if held_out else "train2017")
        return sorted(p.stem for p in folder.glob("*.jpg") if held_out or p.stem not in SPRITE_SOURCES)
    if source == "visdrone":
        return sorted((root / "visdrone_mini" / ("val.list" if held_out else "train.list")).read_text().split())
    stems = [p.stem for p in (root / source / "images").glob("*.jpg")]
    return _split_flights(stems)[1 if held_out else 0]


def _read_rows(path: Path, optional: bool = False) -> np.ndarray:
    """Rows of a label file. A picture without anything in it has an empty one; a file that is not there was lost."""
    if not path.exists():
        if optional:
            return np.zeros((0, 5), np.float32)
        raise ValueError(f"{path}: no label file; for a picture that shows nothing, an empty one")
    text = path.read_text().split("\n")
    rows = np.array([line.split() for line in text if line.strip()], np.float32)
    if rows.size == 0:
        return np.zeros((0, 5), np.float32)
    if rows.ndim != 2 or rows.shape[1] != 5:
        raise ValueError(f"{path}: every line must hold 5 numbers: class cx cy w h")
    return rows


def _to_pixels(rows: np.ndarray, width: int, height: int) -> np.ndarray:
    centre, half = rows[:, 1:3], rows[:, 3:5] / 2
    return np.concatenate((centre - half, centre + half), 1) * np.array([width, height] * 2, np.float32)


def sources_of_step(step: int, batch: int) -> list[tuple[str, int]]:
    """The sets that a step draws from, COCO first, with how many views each gives. `batch`: a multiple of 4."""
    return [("coco", batch // 2), ("visdrone", batch // 4), (VEHICLE_TURNS[step % len(VEHICLE_TURNS)], batch // 4)]


def edge_strips(width: int, height: int) -> np.ndarray:
    """Regions along the picture's edge in which what is not labelled is not learnt as background either; what is labelled
    there is learnt all the same (loss.py)."""
    dx, dy = EDGE_SHARE * width, EDGE_SHARE * height
    return np.array([[0, 0, width, dy], [0, height - dy, width, height], [0, 0, dx, height],
                     [width - dx, 0, width, height]], np.float32)


def load(root: Path, source: str, held_out: bool, longest_side: int = 1280) -> list[Picture]:
    """Reads one set; pictures larger than `longest_side` are reduced, boxes with them."""
    folder, part, mapping = {
        "coco": ("coco256", "val2017" if held_out else "train2017", _COCO),
        "cats_topdown": ("cats_topdown", "", _CATS),
        "aerial_cars": ("aerial_cars", "", _AERIAL),
        "visdrone": ("visdrone_mini", "", _VISDRONE),
    }[source]
    pictures = []
    for stem in names(root, source, held_out):
        path = root / folder / "images" / part / f"{stem}.jpg"
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None:
            raise ValueError(f"{path}: cannot be read as a picture")
        shrink = longest_side / max(image.shape[:2])
        if shrink < 1:
            image = cv2.resize(image, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
        h, w = image.shape[:2]
        path = root / folder / "labels" / part / f"{stem}.txt"
        rows = _read_rows(path, optional=source == "coco" and stem in COCO_WITHOUT_OBJECTS)
        unknown = sorted({float(c) for c in rows[:, 0]} - KNOWN[source])
        if unknown:
            raise ValueError(f"{path}: class {unknown[0]:g} is none of {source}'s {len(KNOWN[source])}")
        # COCO objects of the other 74 classes are simply absent; there IGNORE means nothing.
        labels = np.array([mapping.get(int(c), IGNORE) for c in rows[:, 0]], np.int64)
        boxes = _to_pixels(rows, w, h)
        ignore = [_to_pixels(_read_rows(root / folder / "ignore" / f"{stem}.txt", optional=True), w, h)]
        if source == "cats_topdown" and not held_out:
            ignore.append(edge_strips(w, h))
        if source != "coco":
            ignore.append(boxes[labels == IGNORE])
        keep = labels != IGNORE
        pictures.append(Picture(stem, source, np.ascontiguousarray(image[:, :, ::-1]), boxes[keep], labels[keep],
                                np.concatenate(ignore)))
    return pictures
