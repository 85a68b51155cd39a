"""Training views: scale and shift, mosaic, tiles (close crops for small objects), people cut by the edge, flips, colour, grey."""
from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from data import Picture

BORDER = 114  # the value that letterboxing fills with
# Zoom against the view that fits the whole picture, per set: (smallest, largest). Above 1 is a tile of the picture.
# Below 1 it is smaller than it flies: what is near in COCO is far below an aircraft.
ZOOM = {"coco": (0.25, 1.5), "cats_topdown": (0.2, 1.4), "aerial_cars": (0.85, 3.0), "visdrone": (0.9, 4.0),
        "simulated": (0.8, 1.6)}
GREY_SHARE = 0.5  # of the views: two of three cameras here are grey
PERSON = 0
CUT = {"coco": (PERSON,), "simulated": (PERSON, 2, 5)}  # what an edge may cut, by set and class (cut())
# Sets that look straight down, at least mostly, have no up: they may be turned.
TURNED = frozenset({"cats_topdown", "aerial_cars"})
VISIBLE_KEEP, VISIBLE_DROP = 0.35, 0.1  # share of a box still in view: above is learnt, between is left out


@dataclass
class View:
    image: np.ndarray  # size x size x 3, RGB, 8 bit
    boxes: np.ndarray
    labels: np.ndarray
    ignore: np.ndarray
    plain: np.ndarray  # as `image`, but in the picture's own colours


def _turn(p: Picture, rng: np.random.Generator) -> Picture:
    image, boxes, ignore = p.image, p.boxes, p.ignore
    if rng.random() < 0.5:  # left to right
        w = image.shape[1]
        image = cv2.flip(image, 1)
        boxes, ignore = (np.stack((w - b[:, 2], b[:, 1], w - b[:, 0], b[:, 3]), 1) for b in (boxes, ignore))
    if p.source in TURNED:
        for _ in range(rng.integers(0, 4)):  # a quarter turn: (x, y) -> (y, w - x)
            w = image.shape[1]
            image = cv2.rotate(image, cv2.ROTATE_90_COUNTERCLOCKWISE)
            boxes, ignore = (np.stack((b[:, 1], w - b[:, 2], b[:, 3], w - b[:, 0]), 1) for b in (boxes, ignore))
    return Picture(p.name, p.source, image, boxes, p.labels, ignore)


def _place(canvas: np.ndarray, region: tuple[int, int, int, int], p: Picture, fitted: float, rng: np.random.Generator,
           corner: tuple[float, float] | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draws `p` into `region` (x0 y0 x1 y1) of the canvas, its longer side `fitted` pixels and its corner anywhere, or at
    `corner` from that of the region; returns the boxes, labels and ignored boxes in view."""
    x0, y0, x1, y1 = region
    rw, rh = x1 - x0, y1 - y0
    h, w = p.image.shape[:2]
    scale = fitted / max(h, w)
    # Whichever is larger, picture or region, the smaller one slides inside it.
    dx = rng.uniform(min(0.0, rw - w * scale), max(0.0, rw - w * scale))
    dy = rng.uniform(min(0.0, rh - h * scale), max(0.0, rh - h * scale))
    if corner is not None:
        dx, dy = corner
    image = p.image
    if scale < 0.6:  # bilinear sampling alone would alias
        image = cv2.resize(image, (max(1, round(w * scale)), max(1, round(h * scale))), interpolation=cv2.INTER_AREA)
        sx, sy = image.shape[1] / w, image.shape[0] / h
        move = np.float32([[1, 0, dx], [0, 1, dy]])
    else:
        sx = sy = scale
        move = np.float32([[scale, 0, dx + 0.5 * scale - 0.5], [0, scale, dy + 0.5 * scale - 0.5]])
    canvas[y0:y1, x0:x1] = cv2.warpAffine(image, move, (rw, rh), flags=cv2.INTER_LINEAR, borderValue=(BORDER,) * 3)
    factors, offset = np.float32([sx, sy, sx, sy]), np.float32([dx + x0, dy + y0] * 2)

    def clip(boxes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        moved = boxes * factors + offset
        seen = np.stack((moved[:, 0].clip(x0, x1), moved[:, 1].clip(y0, y1), moved[:, 2].clip(x0, x1),
                         moved[:, 3].clip(y0, y1)), 1)
        area = (moved[:, 2] - moved[:, 0]) * (moved[:, 3] - moved[:, 1])
        return seen, (seen[:, 2] - seen[:, 0]) * (seen[:, 3] - seen[:, 1]) / np.maximum(area, 1e-6)

    boxes, visible = clip(p.boxes)
    ignore, ignore_visible = clip(p.ignore)
    # Below two pixels a side there is nothing to learn from, but calling it background would be wrong.
    tiny = np.minimum(boxes[:, 2] - boxes[:, 0], boxes[:, 3] - boxes[:, 1]) < 2
    learn = (visible >= VISIBLE_KEEP) & ~tiny
    unsure = (visible > VISIBLE_DROP) & ~learn
    return boxes[learn], p.labels[learn], np.concatenate((ignore[ignore_visible > 0], boxes[unsure]))


def _colour(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Hue, saturation and brightness, or grey; at times slightly blurred."""
    if rng.random() < GREY_SHARE:
        image = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
        gain, offset = rng.uniform(0.6, 1.4), rng.uniform(-20, 20)
        image = cv2.convertScaleAbs(image, alpha=gain, beta=max(offset, 0.0)) if offset > 0 else \
            np.clip(image.astype(np.float32) * gain + offset, 0, 255).astype(np.uint8)
    else:
        hue, saturation, value = rng.uniform(-1, 1, 3) * (0.015, 0.6, 0.4) + (0, 1, 1)
        table = np.arange(256)
        channels = cv2.split(cv2.cvtColor(image, cv2.COLOR_RGB2HSV))
        tables = ((table + hue * 180) % 180, np.clip(table * saturation, 0, 255), np.clip(table * value, 0, 255))
        image = cv2.cvtColor(cv2.merge([cv2.LUT(c, t.astype(np.uint8)) for c, t in zip(channels, tables)]),
                             cv2.COLOR_HSV2RGB)
    if rng.random() < 0.1:
        image = cv2.blur(image, (3, 3) if rng.random() < 0.5 else (5, 1))
    return image


def _zoom(source: str, rng: np.random.Generator) -> float:
    low, high = ZOOM[source]
    if rng.random() < 0.4:  # the view that it flies with
        return float(rng.uniform(0.9, 1.1))
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def single(p: Picture, size: int, view: int, rng: np.random.Generator) -> View:
    """A size x size window on one picture, which is scaled as an input of view x view pixels would show it."""
    canvas = np.full((size, size, 3), BORDER, np.uint8)
    boxes, labels, ignore = _place(canvas, (0, 0, size, size), _turn(p, rng), view * _zoom(p.source, rng), rng)
    return View(_colour(canvas, rng), boxes, labels, ignore, canvas)


def cut(p: Picture, size: int, view: int, rng: np.random.Generator) -> View:
    """As single(), but an edge cuts a thing of the classes CUT so that two to four fifths of it are left: people as often
    without the head as at a side, rendered things at each of four edges. Half of the edges are those of a picture of 4:3 in its
    letterbox. Without one large enough: single()."""
    p = _turn(p, rng)
    h, w = p.image.shape[:2]
    wide, tall = p.boxes[:, 2] - p.boxes[:, 0], p.boxes[:, 3] - p.boxes[:, 1]
    extent = np.where(p.labels == PERSON, tall, np.maximum(wide, tall))
    large = np.flatnonzero(np.isin(p.labels, CUT.get(p.source, ())) & (extent >= 0.15 * h) & (extent >= 40))
    canvas = np.full((size, size, 3), BORDER, np.uint8)
    if not len(large):
        boxes, labels, ignore = _place(canvas, (0, 0, size, size), p, view * _zoom(p.source, rng), rng)
        return View(_colour(canvas, rng), boxes, labels, ignore, canvas)
    border = size // 8 if rng.random() < 0.5 else 0
    rw, rh = size, size - 2 * border
    chosen = rng.choice(large)
    x0, y0, x1, y1 = (float(v) for v in p.boxes[chosen])
    kept, side = rng.uniform(0.4, 0.8), rng.integers(0, 4)
    if side == 1 and p.source == "coco":
        side = 0
    left = (y1 - y0) * (kept if side < 2 else 1)
    if p.labels[chosen] != PERSON:
        left = max(left, (x1 - x0) * (kept if side >= 2 else 1))
    scale = min(2.0, rng.uniform(0.25, 1.0) * rh / left)
    dx, dy = rng.uniform(0.2, 0.8) * rw - scale * (x0 + x1) / 2, rng.uniform(0.3, 0.7) * rh - scale * (y0 + y1) / 2
    if side == 0:
        dy = -scale * (y1 - kept * (y1 - y0))
    elif side == 1:
        dy = rh - scale * (y0 + kept * (y1 - y0))
    elif side == 2:
        dx = -scale * (x1 - kept * (x1 - x0))
    else:
        dx = rw - scale * (x0 + kept * (x1 - x0))
    region = (0, border, size, size - border)
    boxes, labels, ignore = _place(canvas, region, p, scale * max(h, w), rng, corner=(dx, dy))
    return View(_colour(canvas, rng), boxes, labels, ignore, canvas)


def nothing(p: Picture, size: int, view: int, rng: np.random.Generator) -> View:
    """As single(), but a part of the picture in which no thing is, a tenth to a half of its shorter side wide, magnified to fill
    the view: people whom the edge cuts teach that little is enough to see one. Where none is found in sixteen draws: single()."""
    h, w = p.image.shape[:2]
    things = np.concatenate((p.boxes, p.ignore))
    for _ in range(16):
        side = max(8, round(rng.uniform(0.1, 0.5) * min(h, w)))
        x, y = (int(rng.integers(0, most - side + 1)) for most in (w, h))
        apart = (things[:, 0] >= x + side) | (things[:, 2] <= x) | (things[:, 1] >= y + side) | (things[:, 3] <= y)
        if apart.all():
            canvas = cv2.resize(p.image[y:y + side, x:x + side], (size, size), interpolation=cv2.INTER_LINEAR)
            return View(_colour(canvas, rng), p.boxes[:0], p.labels[:0], p.ignore[:0], canvas)
    return single(p, size, view, rng)


def mosaic(four: list[Picture], size: int, view: int, rng: np.random.Generator) -> View:
    """Four pictures around a random centre."""
    canvas = np.full((size, size, 3), BORDER, np.uint8)
    cx, cy = (int(v) for v in rng.uniform(0.3, 0.7, 2) * size)
    regions = ((0, 0, cx, cy), (cx, 0, size, cy), (0, cy, cx, size), (cx, cy, size, size))
    parts = [_place(canvas, r, _turn(p, rng), view * _zoom(p.source, rng), rng) for r, p in zip(regions, four)]
    boxes, labels, ignore = (np.concatenate(column) for column in zip(*parts))
    return View(_colour(canvas, rng), boxes, labels, ignore, canvas)


def letterbox(image: np.ndarray, width: int, height: int, centred: bool = True) -> tuple[np.ndarray, float, int, int]:
    """The whole picture in an input of width x height, as the detector sees it in flight (fit_letterbox() of
    detector/decode.h). Returns view, scale, left and top border."""
    h, w = image.shape[:2]
    scale = min(width / w, height / h)
    nw, nh = min(width, max(1, round(w * scale))), min(height, max(1, round(h * scale)))
    left, top = ((width - nw) // 2, (height - nh) // 2) if centred else (0, 0)
    canvas = np.full((height, width, 3), BORDER, np.uint8)
    canvas[top:top + nh, left:left + nw] = cv2.resize(image, (nw, nh), interpolation=cv2.INTER_LINEAR)
    return canvas, scale, left, top
