"""A model file through OpenCV's DNN module, looked at pictures with as it flies: letterbox, squares, boxes. No PyTorch."""
from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from augment import letterbox
from names import CLASSES, COCO_INDEX, STRIDES

# Inputs that a file without metadata is tried with.
USUAL_SIZES = ((416, 416), (320, 320), (640, 640))


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


def cells_of(width: int, height: int) -> int:
    return sum((width // s) * (height // s) for s in STRIDES)


@dataclass
class Network:
    """A model file of either layout, with 6 or 80 classes. Its input is what the metadata beside it says; without any, what
    YOLOv5 and YOLOX are published for, told apart by the rows of the output."""

    path: Path
    tiled: bool = False

    def __post_init__(self) -> None:
        self.net = cv2.dnn.readNetFromONNX(str(self.path))
        beside = self.path.with_suffix(".toml")
        told = None
        if beside.exists():
            told = tomllib.loads(beside.read_text())
            sizes = ((told["input_width"], told["input_height"]),)
        else:
            sizes = USUAL_SIZES
        self.width, self.height = next((s for s in sizes if self._runs(*s)), (0, 0))
        if not self.width:
            raise ValueError(f"{self.path}: runs at none of " + ", ".join(f"{w} x {h}" for w, h in sizes))
        rows, values = self._forward(np.zeros((1, 3, self.height, self.width), np.float32)).shape
        if values not in (11, 85):
            raise ValueError(f"{self.path}: output of {rows} x {values} is neither YOLOv5 nor YOLOX of 6 or 80 classes")
        self.yolox = rows == cells_of(self.width, self.height)
        if told and self.yolox != (told["layout"] == "yolox"):
            raise ValueError(f"{self.path}: output of {rows} rows is not of the layout that {beside.name} says, {told['layout']}")
        self.blue_first, self.centred, self.scale = self.yolox, not self.yolox, 1 if self.yolox else 1 / 255
        if told:
            self.blue_first, self.centred = told["channel_order"] == "bgr", told["letterbox"] == "centre"
            self.scale = told["scale"]
        self.columns = [5 + i for i in (range(len(CLASSES)) if values == 11 else COCO_INDEX)]

    def _forward(self, blob: np.ndarray) -> np.ndarray:
        self.net.setInput(blob)
        return self.net.forward()[0]

    def _runs(self, width: int, height: int) -> bool:
        try:
            rows = self._forward(np.zeros((1, 3, height, width), np.float32)).shape[0]
        except cv2.error:
            return False
        return rows in (cells_of(width, height), 3 * cells_of(width, height))

    def blob(self, image: np.ndarray) -> tuple[np.ndarray, float, int, int]:
        canvas, scale, left, top = letterbox(image, self.width, self.height, centred=self.centred)
        planes = canvas.transpose(2, 0, 1)[None].astype(np.float32) * np.float32(self.scale)
        return np.ascontiguousarray(planes[:, ::-1] if self.blue_first else planes), scale, left, top

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
                nx, ny = self.width // stride, self.height // stride
                gy, gx = np.mgrid[:ny, :nx].reshape(2, -1)
                part = y[at:at + ny * nx]
                part[:, 0], part[:, 1] = (part[:, 0] + gx) * stride, (part[:, 1] + gy) * stride
                part[:, 2:4] = np.exp(part[:, 2:4]) * stride
                at += ny * nx
        scores = y[:, 4:5] * y[:, self.columns]
        sure = scores.max(1) > threshold
        return to_picture(y[sure, :4], scale, left, top, image.shape), scores[sure]


class Remembered:
    """A network that looks at each picture once, whatever thresholds are asked for afterwards."""

    def __init__(self, network: Network, lowest: float = 0.01):
        self.network, self.lowest = network, lowest
        self.held: dict[int, tuple[np.ndarray, np.ndarray, np.ndarray]] = {}

    def detect(self, image: np.ndarray, threshold: float) -> tuple[np.ndarray, np.ndarray]:
        if threshold < self.lowest:
            raise ValueError(f"a threshold of {threshold} is below {self.lowest}")
        if id(image) not in self.held:  # the picture is held, too, so that its id stays its own
            self.held[id(image)] = (image, *self.network.detect(image, self.lowest))
        _, boxes, scores = self.held[id(image)]
        sure = scores.max(1) > threshold
        return boxes[sure], scores[sure]


def to_picture(rows: np.ndarray, scale: float, left: int, top: int, shape: tuple[int, ...]) -> np.ndarray:
    """Centre and size in the input to x0 y0 x1 y1 in the picture, clipped to it."""
    boxes = np.concatenate((rows[:, :2] - rows[:, 2:4] / 2, rows[:, :2] + rows[:, 2:4] / 2), 1)
    h, w = shape[:2]
    return np.clip((boxes - (left, top, left, top)) / scale, 0, (w, h, w, h))
