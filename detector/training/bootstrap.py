"""How far a figure would swing had other pictures been taken: average precision over pictures drawn again and again.

People and vehicles (car, bus, truck or of unknown kind as one), of all sizes and the small ones apart. Two networks are
compared on the same draws, so that what is common to both falls away.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import data
from metrics import match, inside, nms
from scoring import VEHICLE_NUMBERS

# Longer side of a small thing, as a share of the picture's: 32 pixels of 640, as COCO calls small what has 32 x 32.
SMALL_SHARE = 0.05
THRESHOLD = 0.01
KINDS = {"person": ((0,), (0,)), "vehicle": (VEHICLE_NUMBERS, (*VEHICLE_NUMBERS, data.VEHICLE))}
GROUPS = tuple(f"{kind} {size}" for kind in KINDS for size in ("all", "small"))
_RECALL_POINTS = np.linspace(0, 1, 101)


@dataclass
class Table:
    """What a network said of one group: boxes with their picture's number, surest first, and the truths of each picture."""

    picture: np.ndarray
    hit: np.ndarray
    truths: np.ndarray

    def average_precision(self, times: np.ndarray | None = None) -> float:
        """AP at an overlap of 0.5, 101 points; `times`: how often each picture was drawn. Not a number without truths."""
        times = np.ones(len(self.truths)) if times is None else times
        truths = float((self.truths * times).sum())
        if truths == 0:
            return float("nan")
        weight = times[self.picture]
        said, right = np.cumsum(weight), np.cumsum(weight * self.hit)
        keep = said > 0
        if not keep.any():
            return 0.0
        precision = np.maximum.accumulate((right[keep] / said[keep])[::-1])[::-1]
        at = np.searchsorted(right[keep] / truths, _RECALL_POINTS - 1e-12)
        return float(np.where(at < len(precision), precision[np.minimum(at, len(precision) - 1)], 0).mean())

    def to_json(self) -> dict:
        return {"picture": self.picture.tolist(), "hit": self.hit.astype(int).tolist(), "truths": self.truths.tolist()}

    @staticmethod
    def from_json(held: dict) -> "Table":
        return Table(np.array(held["picture"], np.int64), np.array(held["hit"], bool), np.array(held["truths"], float))


def small(boxes: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    return np.maximum(boxes[:, 2] - boxes[:, 0], boxes[:, 3] - boxes[:, 1]) < SMALL_SHARE * max(shape[:2])


def collect(network, pictures: list[data.Picture]) -> dict[str, Table]:
    """One table a group that has truths."""
    rows: dict[str, list[tuple[float, int, bool]]] = {g: [] for g in GROUPS}
    truths = {g: np.zeros(len(pictures)) for g in GROUPS}
    for number, p in enumerate(pictures):
        all_boxes, all_scores = network.detect(p.image, THRESHOLD)
        for kind, (mine, theirs) in KINDS.items():
            best = all_scores[:, mine].max(1) if len(all_scores) else np.zeros(0)
            sure = np.flatnonzero(best > THRESHOLD)
            kept = sure[nms(all_boxes[sure], best[sure], np.zeros(len(sure)))]
            boxes, scores, truth = all_boxes[kept], best[kept], p.boxes[np.isin(p.labels, theirs)]
            of = match(boxes, truth)  # surest first, as nms leaves them
            counted = (of >= 0) | ~inside(boxes, p.ignore)
            little, truth_little = small(boxes, p.image.shape), small(truth, p.image.shape)
            # A box on a thing that is not small, or itself not small and on nothing, says nothing of small things.
            of_small = np.where(of >= 0, truth_little[np.maximum(of, 0)] if len(truth) else False, little)
            for group, here, count in ((f"{kind} all", counted, len(truth)),
                                       (f"{kind} small", counted & of_small, truth_little.sum())):
                rows[group] += [(float(s), number, bool(o >= 0)) for s, o in zip(scores[here], of[here])]
                truths[group][number] = count
    out = {}
    for group in GROUPS:
        if truths[group].sum():
            ordered = sorted(rows[group], key=lambda r: (-r[0], r[1]))
            out[group] = Table(np.array([r[1] for r in ordered], np.int64), np.array([r[2] for r in ordered], bool), truths[group])
    return out


def draws(pictures: int, count: int, seed: int = 0) -> np.ndarray:
    """count x pictures: how often each picture is drawn."""
    rng = np.random.default_rng(seed)
    return rng.multinomial(pictures, np.full(pictures, 1 / pictures), size=count)


def interval(values: np.ndarray) -> tuple[float, float]:
    """95 %; draws without any truth are left out."""
    low, high = np.nanpercentile(values, (2.5, 97.5))
    return float(low), float(high)


def spread_of(table: Table, count: int = 500) -> tuple[float, float]:
    return interval(np.array([table.average_precision(t) for t in draws(len(table.truths), count)]))


def difference(pairs: list[tuple[Table, Table]], count: int) -> dict:
    """With less without, seed by seed: `pairs` has (without, with) of each seed, all on the same pictures. The interval is that
    of the seeds' mean over draws of the pictures."""
    each = [b.average_precision() - a.average_precision() for a, b in pairs]
    drawn = np.array([[b.average_precision(t) - a.average_precision(t) for a, b in pairs]
                      for t in draws(len(pairs[0][0].truths), count)])
    low, high = interval(drawn.mean(1))
    return {"by_seed": each, "mean": float(np.mean(each)), "low": low, "high": high}
