"""The detection sets in one form: RGB pictures, boxes in pixels, the six classes, and regions that are left out.

Which picture is for what: split.py.
"""
from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

import split
from names import CLASSES, COCO_INDEX

VEHICLE = -1  # a vehicle of unknown kind: learnt as a car, but calling it a bus or a truck costs nothing
IGNORE = -2  # not scored and not learnt
VEHICLE_CLASSES = (2, 4, 5)

# Each set's own class numbers -> ours. Tricycles are vehicles of none of the six kinds.
_CATS = {0: VEHICLE}
_AERIAL = {0: 2, 1: 5, 2: 4, 3: VEHICLE, 4: 1}
_VISDRONE = {0: 0, 1: 0, 2: 1, 3: 2, 4: 2, 5: 5, 6: IGNORE, 7: IGNORE, 8: 4, 9: 3}
_COCO = {coco: ours for ours, coco in enumerate(COCO_INDEX)}

_OURS = {i: i for i in range(len(CLASSES))}

# Class numbers that a set's label files may hold.
KNOWN = {"coco": frozenset(range(80)), "cats_topdown": frozenset(_CATS), "aerial_cars": frozenset(_AERIAL),
         "visdrone": frozenset(_VISDRONE), "simulated": frozenset(_OURS)}
# Vehicles cut by the edge are not all labelled in cats_topdown: along it, so deep as this share of the picture's side,
# nothing is learnt but what is labelled. Half the longer side of a whole vehicle there (median 0.15 of the picture over
# 2,394 boxes; 714 cut ones are labelled), so that where the strip ends the middle of every cut one is behind it.
EDGE_SHARE = 0.075
# COCO writes no label file for a picture without any of its 80 classes; these two of the part here are such.
COCO_WITHOUT_OBJECTS = frozenset({"000000000250", "000000000508"})

# Of the views of a step in eighths: half are of COCO (which the teacher sees too), a quarter of VisDrone and a quarter of
# VEHICLE_TURNS: small vehicles take longest to learn. With rendered pictures these are a quarter, and COCO and the
# vehicles give up an eighth each (real vehicles are then found less: aerial_cars 0.33 instead of 0.39), or an eighth, all COCO's.
SHARES = {0: {"coco": 4, "visdrone": 2, "vehicles": 2},
          1: {"coco": 3, "visdrone": 2, "vehicles": 2, "simulated": 1},
          2: {"coco": 3, "visdrone": 2, "vehicles": 1, "simulated": 2}}
VEHICLE_TURNS = ("aerial_cars", "aerial_cars", "cats_topdown")
SETS = ("coco", "cats_topdown", "aerial_cars", "visdrone")
# What a network may learn from whose licence nothing but names its sources, by how the pictures' names begin: of aerial_cars
# DLR/KIT's (CC BY 3.0), not DJI's (CC BY-SA); of COCO all (annotations CC BY 4.0, pictures of Flickr: YOLOX-Nano, the start,
# has learnt from them already). CATS states no licence, VisDrone is for academic use.
PERMISSIVE = {"coco": ("",), "aerial_cars": ("MOS", "MunichStreet")}
SHARES_PERMISSIVE = {0: {"coco": 6, "aerial_cars": 2},
                     1: {"coco": 5, "aerial_cars": 2, "simulated": 1},
                     2: {"coco": 4, "aerial_cars": 2, "simulated": 2}}


@dataclass
class Picture:
    name: str
    source: str
    image: np.ndarray  # height x width x 3, RGB, 8 bit
    boxes: np.ndarray  # n x 4, x0 y0 x1 y1 in pixels
    labels: np.ndarray  # n, our class or VEHICLE
    ignore: np.ndarray = field(default_factory=lambda: np.zeros((0, 4), np.float32))


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


def sets_of(permissive: bool) -> tuple[str, ...]:
    return tuple(PERMISSIVE) if permissive else SETS


def sources_of_step(step: int, batch: int, rendered_eighths: int = 0, permissive: bool = False) -> list[tuple[str, int]]:
    """The sets that a step draws from, COCO first, with how many views each gives; so many eighths are rendered."""
    shares = (SHARES_PERMISSIVE if permissive else SHARES)[rendered_eighths]
    if batch < 1 or any(batch * share % 8 for share in shares.values()):
        multiple = 8 if any(share % 2 for share in shares.values()) else 4
        raise ValueError(f"a batch of {batch} views cannot be shared out; it must be a multiple of {multiple}")
    turn = VEHICLE_TURNS[step % len(VEHICLE_TURNS)]
    return [(turn if source == "vehicles" else source, batch * share // 8) for source, share in shares.items()]


def edge_strips(width: int, height: int) -> np.ndarray:
    """Regions along the picture's edge in which what is not labelled is not learnt as background either; what is labelled
    there is learnt all the same (loss.py)."""
    dx, dy = EDGE_SHARE * width, EDGE_SHARE * height
    return np.array([[0, 0, width, dy], [0, height - dy, width, height], [0, 0, dx, height],
                     [width - dx, 0, width, height]], np.float32)


def load(root: Path, source: str, part: str, longest_side: int = 1280, permissive: bool = False) -> list[Picture]:
    """Reads one part (split.PARTS) of a set; pictures larger than `longest_side` are reduced, boxes with them. `root` is the
    folder of all sets; of simulated pictures their own. `permissive`: only what PERMISSIVE names."""
    folder, below, mapping = {
        "coco": ("coco256", "val2017" if part == "held_out" else "train2017", _COCO),
        "cats_topdown": ("cats_topdown", "", _CATS),
        "aerial_cars": ("aerial_cars", "", _AERIAL),
        "visdrone": ("visdrone_mini", "", _VISDRONE),
        "simulated": ("", "", _OURS),
    }[source]
    pictures = []
    for stem in split.names(root, source, part):
        if permissive and not stem.startswith(PERMISSIVE[source]):
            continue
        path = root / folder / "images" / below / f"{stem}.jpg"
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None:
            raise ValueError(f"{path}: cannot be read as a picture")
        shrink = longest_side / max(image.shape[:2])
        if shrink < 1:
            image = cv2.resize(image, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
        h, w = image.shape[:2]
        path = root / folder / "labels" / below / f"{stem}.txt"
        rows = _read_rows(path, optional=source == "coco" and stem in COCO_WITHOUT_OBJECTS)
        unknown = sorted({float(c) for c in rows[:, 0]} - KNOWN[source])
        if unknown:
            raise ValueError(f"{path}: class {unknown[0]:g} is none of {source}'s {len(KNOWN[source])}")
        # COCO objects of the other 74 classes are simply absent; there IGNORE means nothing.
        labels = np.array([mapping.get(int(c), IGNORE) for c in rows[:, 0]], np.int64)
        boxes = _to_pixels(rows, w, h)
        ignore = [_to_pixels(_read_rows(root / folder / "ignore" / f"{stem}.txt", optional=True), w, h)]
        if source == "cats_topdown" and part in ("train", "choose"):
            ignore.append(edge_strips(w, h))
        if source != "coco":
            ignore.append(boxes[labels == IGNORE])
        keep = labels != IGNORE
        pictures.append(Picture(stem, source, np.ascontiguousarray(image[:, :, ::-1]), boxes[keep], labels[keep],
                                np.concatenate(ignore)))
    return pictures


def leave_out_smaller(pictures: list[Picture], least_px: float) -> None:
    """Things whose longer side is below `least_px` become regions that count neither way."""
    for p in pictures:
        tiny = np.maximum(p.boxes[:, 2] - p.boxes[:, 0], p.boxes[:, 3] - p.boxes[:, 1]) < least_px
        p.ignore = np.concatenate((p.ignore, p.boxes[tiny]))
        p.boxes, p.labels = p.boxes[~tiny], p.labels[~tiny]


def digest(pictures: dict[str, list[Picture]]) -> str:
    """SHA-256 of all that is learnt from: names, pixels, boxes, labels, ignored regions."""
    out = hashlib.sha256()
    for source, of in sorted(pictures.items()):
        for p in of:
            out.update(f"{source}/{p.name} {p.image.shape} {len(p.boxes)} {len(p.ignore)}\n".encode())
            for values in (p.image, p.boxes, p.labels, p.ignore):
                out.update(np.ascontiguousarray(values).tobytes())
    return out.hexdigest()
