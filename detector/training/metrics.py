"""Precision, recall and average precision of boxes against annotations."""
from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

IOU_STEPS = np.arange(0.5, 0.96, 0.05)
_RECALL_POINTS = np.linspace(0, 1, 101)


def iou_matrix(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """n x m overlaps of boxes x0 y0 x1 y1."""
    low, high = np.maximum(a[:, None, :2], b[None, :, :2]), np.minimum(a[:, None, 2:], b[None, :, 2:])
    both = np.clip(high - low, 0, None).prod(2)
    areas = (a[:, 2:] - a[:, :2]).prod(1)[:, None] + (b[:, 2:] - b[:, :2]).prod(1)[None]
    return both / np.maximum(areas - both, 1e-9)


def nms(boxes: np.ndarray, scores: np.ndarray, labels: np.ndarray, iou: float = 0.6, most: int = 300) -> np.ndarray:
    """Class-wise greedy suppression; indices that stay, surest first."""
    order = np.argsort(-scores, kind="stable")[:3000]
    shifted = boxes[order] + labels[order, None] * 1e5  # boxes of two classes never overlap
    kept: list[int] = []
    alive = np.ones(len(order), bool)
    for i in range(len(order)):
        if not alive[i]:
            continue
        kept.append(order[i])
        if len(kept) == most:
            break
        later = np.flatnonzero(alive[i + 1:]) + i + 1
        alive[later] = iou_matrix(shifted[i:i + 1], shifted[later])[0] <= iou
    return np.array(kept, np.int64)


def match(boxes: np.ndarray, truth: np.ndarray, least: float = 0.5) -> np.ndarray:
    """For each box, surest first, the number of the annotation that it hits and none before it has taken; -1: none."""
    iou, free = iou_matrix(boxes, truth), np.ones(len(truth), bool)
    out = np.full(len(boxes), -1)
    for i in range(len(boxes)):
        candidates = np.where(free, iou[i], 0)
        if len(truth) and candidates.max() >= least:
            out[i] = candidates.argmax()
            free[out[i]] = False
    return out


@dataclass
class ClassScore:
    """Collects one class over many pictures."""

    scores: list[np.ndarray] = field(default_factory=list)
    hits: list[np.ndarray] = field(default_factory=list)  # per box: right at each IoU step
    truths: int = 0

    def add(self, boxes: np.ndarray, scores: np.ndarray, truth: np.ndarray, ignore: np.ndarray) -> None:
        """One picture. Boxes that hit no annotation but lie at least half in an ignored region count neither way."""
        order = np.argsort(-scores, kind="stable")
        boxes, scores = boxes[order], scores[order]
        hit = np.stack([match(boxes, truth, step) >= 0 for step in IOU_STEPS], 1)
        counted = hit[:, 0] | ~inside(boxes, ignore)
        self.scores.append(scores[counted])
        self.hits.append(hit[counted])
        self.truths += len(truth)

    def curves(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Scores falling, precision and recall at IoU 0.5 for each."""
        scores, hits = np.concatenate(self.scores), np.concatenate(self.hits)[:, 0]
        order = np.argsort(-scores, kind="stable")
        right = np.cumsum(hits[order])
        return scores[order], right / np.arange(1, len(right) + 1), right / max(self.truths, 1)

    def average_precision(self) -> np.ndarray:
        """AP at each IoU step, 101-point interpolation as COCO's."""
        scores, hits = np.concatenate(self.scores), np.concatenate(self.hits)
        hits = hits[np.argsort(-scores, kind="stable")]
        out = np.zeros(len(IOU_STEPS))
        for k in range(len(IOU_STEPS)):
            right = np.cumsum(hits[:, k])
            if not len(right):
                continue
            precision = np.maximum.accumulate((right / np.arange(1, len(right) + 1))[::-1])[::-1]
            at = np.searchsorted(right / max(self.truths, 1), _RECALL_POINTS)
            out[k] = np.where(at < len(precision), precision[np.minimum(at, len(precision) - 1)], 0).mean()
        return out


@dataclass
class FlyingScore:
    """Boxes as they fly, above one threshold and with one suppression, against annotations at an overlap of 0.5."""

    right: int = 0
    wrong: int = 0
    truths: int = 0

    def add(self, boxes: np.ndarray, scores: np.ndarray, truth: np.ndarray, ignore: np.ndarray) -> None:
        one = ClassScore()
        one.add(boxes, scores, truth, ignore)
        hits = np.concatenate(one.hits)[:, 0] if one.hits else np.zeros(0, bool)
        self.right += int(hits.sum())
        self.wrong += int((~hits).sum())
        self.truths += one.truths

    def figures(self) -> dict:
        """None where nothing was said, or nothing was there to be found."""
        said = self.right + self.wrong
        return {"P": self.right / said if said else None, "R": self.right / self.truths if self.truths else None,
                "boxes": said, "objects": self.truths}


def inside(boxes: np.ndarray, regions: np.ndarray) -> np.ndarray:
    """Which boxes lie at least half in one of the regions."""
    if not len(regions) or not len(boxes):
        return np.zeros(len(boxes), bool)
    low, high = np.maximum(boxes[:, None, :2], regions[None, :, :2]), np.minimum(boxes[:, None, 2:], regions[None, :, 2:])
    part = np.clip(high - low, 0, None).prod(2) / np.maximum((boxes[:, 2:] - boxes[:, :2]).prod(1), 1e-9)[:, None]
    return part.max(1) >= 0.5


def best_f1(classes: list[ClassScore]) -> tuple[float, float]:
    """Mean precision and recall over classes, each at the score where its own F1 is best."""
    precisions, recalls = [], []
    for c in classes:
        _, precision, recall = c.curves()
        if not len(precision):
            precisions.append(0.0)
            recalls.append(0.0)
            continue
        i = int(np.argmax(2 * precision * recall / np.maximum(precision + recall, 1e-9)))
        precisions.append(float(precision[i]))
        recalls.append(float(recall[i]))
    return float(np.mean(precisions)), float(np.mean(recalls))
