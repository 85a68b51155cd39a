"""Figures of one network on annotated pictures. A network is whatever has detect(image, threshold) as network.Network has."""
from __future__ import annotations

import numpy as np

import data
from metrics import ClassScore, FlyingScore, best_f1, nms
from names import CLASSES

VEHICLE_NUMBERS = tuple(data.VEHICLE_CLASSES)
FLYING_SCORE, FLYING_OVERLAP = 0.25, 0.45  # DecodeOptions of detector/decode.h


def score_set(network, pictures: list[data.Picture], threshold: float = 0.01) -> dict:
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


def score_as_flown(network, pictures: list[data.Picture], score: float = FLYING_SCORE,
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
