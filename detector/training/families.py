"""The networks that can be trained: what each starts from and how it learns."""
from __future__ import annotations

from pathlib import Path

import loss
import yolox_loss
from model import CbamYolov5, PathAggregation
from weights import load_coco, load_yolox
from yolox import CbamYolox

SIZES = {"yolov5": ("n", "s"), "yolox": ("nano",)}
LOSSES = {"yolov5": loss.detection_loss, "yolox": yolox_loss.detection_loss}


def make(family: str, size: str, attention: bool) -> PathAggregation:
    return (CbamYolov5 if family == "yolov5" else CbamYolox)(size, attention=attention)


def start(net: PathAggregation, family: str, size: str, root: Path) -> None:
    """Fills it with the weights that were published, out of the folder of all sets."""
    if family == "yolov5":
        load_coco(net, str(root / "models" / f"yolov5{size}_coco_state.npz"))
    else:
        load_yolox(net, str(root / "models" / f"yolox_{size}_416.onnx"))
