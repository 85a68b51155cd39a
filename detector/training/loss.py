"""Detection loss: anchors are matched by shape, boxes by complete IoU, objectness by the IoU reached, classes by
cross-entropy; and distillation, which holds the network to what the COCO network says about COCO pictures."""
from __future__ import annotations

import math

import torch
from torch.nn import functional as F

from data import VEHICLE, VEHICLE_CLASSES
from model import ANCHORS
from names import STRIDES

SHAPE_RATIO = 4.0  # a box belongs to an anchor when no side differs by more than this factor
BOX_GAIN, OBJECT_GAIN, CLASS_GAIN, DISTIL_GAIN = 0.05, 0.42, 0.1, 4.0
OBJECT_BALANCE = (4.0, 1.0, 0.4)  # small objects are rare among many cells


def complete_iou(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """CIoU (Zheng et al., 2020) of boxes given as centre and size, row by row."""
    a0, a1, b0, b1 = a[:, :2] - a[:, 2:] / 2, a[:, :2] + a[:, 2:] / 2, b[:, :2] - b[:, 2:] / 2, b[:, :2] + b[:, 2:] / 2
    overlap = (torch.minimum(a1, b1) - torch.maximum(a0, b0)).clamp(min=0).prod(1)
    iou = overlap / (a[:, 2:].prod(1) + b[:, 2:].prod(1) - overlap + 1e-7)
    diagonal = (torch.maximum(a1, b1) - torch.minimum(a0, b0)).pow(2).sum(1) + 1e-7
    distance = (a[:, :2] - b[:, :2]).pow(2).sum(1)
    aspect = (4 / math.pi**2) * (torch.atan(b[:, 2] / b[:, 3]) - torch.atan(a[:, 2] / (a[:, 3] + 1e-7))).pow(2)
    with torch.no_grad():
        weight = aspect / (aspect - iou + 1 + 1e-7)
    return iou - distance / diagonal - weight * aspect


def assign(boxes: torch.Tensor, level: int, ny: int, nx: int) -> tuple[torch.Tensor, ...]:
    """Boxes (n x 4, centre and size, input pixels) to (box, anchor, row, column) of one stride.

    Each box is learnt by every anchor of like shape, in its own cell and in the nearest neighbour cell on each axis,
    which can reach it as well because a cell predicts centres half a cell beyond itself.
    """
    n = boxes.shape[0]
    anchors = torch.tensor(ANCHORS[level], dtype=boxes.dtype, device=boxes.device)
    ratio = boxes[:, None, 2:] / anchors[None]
    box, anchor = torch.nonzero(torch.maximum(ratio, 1 / ratio).amax(2) < SHAPE_RATIO, as_tuple=True)
    if n == 0 or box.numel() == 0:
        empty = torch.zeros(0, dtype=torch.long, device=boxes.device)
        return empty, empty, empty, empty
    centre = boxes[box, :2] / STRIDES[level]
    cell = centre.floor()
    towards = torch.where(centre - cell < 0.5, -1.0, 1.0)
    zero = torch.zeros_like(towards[:, 0])
    steps = (torch.stack((zero, zero), 1), torch.stack((towards[:, 0], zero), 1), torch.stack((zero, towards[:, 1]), 1))
    cells = torch.cat([cell + s for s in steps])
    box, anchor = box.repeat(3), anchor.repeat(3)
    column, row = cells[:, 0].long(), cells[:, 1].long()
    inside = (column >= 0) & (column < nx) & (row >= 0) & (row < ny)
    return box[inside], anchor[inside], row[inside], column[inside]


def ignored_cells(ignore: torch.Tensor, batch: int, level: int, ny: int, nx: int) -> torch.Tensor:
    """batch x rows x columns, true where the cell touches an ignored region (picture, x0, y0, x1, y1). On the processor:
    it is filled region by region."""
    mask = torch.zeros(batch, ny, nx, dtype=torch.bool)
    s = STRIDES[level]
    for b, x0, y0, x1, y1 in ignore.tolist():
        mask[int(b), max(0, int(y0 / s)):max(0, math.ceil(y1 / s)), max(0, int(x0 / s)):max(0, math.ceil(x1 / s))] = True
    return mask


def detection_loss(raw: list[torch.Tensor], targets: torch.Tensor, ignore: torch.Tensor,
                   teacher: list[torch.Tensor] | None, taught: int) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """`targets`: n x 6 (picture, label, cx, cy, w, h in input pixels); `ignore`: m x 5 (picture, x0, y0, x1, y1).

    All on one device, but `ignore`, which stays on the processor. The first `taught` pictures of the batch are COCO pictures
    that `teacher` (raw maps) has seen too: there, what the teacher holds for an object counts as one, because those pictures
    show objects of 74 more classes. The parts of the loss come back on the device: reading them waits for it.
    """
    batch, device = raw[0].shape[0], raw[0].device
    box_loss = object_loss = class_loss = distil_loss = torch.zeros((), device=device)
    picture = targets[:, 0].long()
    for level, y in enumerate(raw):
        ny, nx = y.shape[2:4]
        with torch.no_grad():
            wanted = torch.zeros(batch, 3, ny, nx, dtype=y.dtype, device=device)
            ignored = ignored_cells(ignore, batch, level, ny, nx).to(device)
            weight = (~ignored)[:, None].expand_as(wanted).to(y.dtype).clone()
            t = teacher[level].sigmoid() if teacher is not None and taught else None
            if t is not None:
                wanted[:taught] = t[..., 4]
        box, anchor, row, column = assign(targets[:, 2:], level, ny, nx)
        if box.numel():
            b = picture[box]
            chosen = y[b, anchor, row, column]
            p = chosen.sigmoid()
            cell = torch.stack((column, row), 1).to(y.dtype)
            anchors = torch.tensor(ANCHORS[level], dtype=y.dtype, device=device)[anchor]
            predicted = torch.cat(((p[:, :2] * 2 - 0.5 + cell) * STRIDES[level], (p[:, 2:4] * 2) ** 2 * anchors), 1)
            iou = complete_iou(predicted, targets[box, 2:])
            box_loss = box_loss + (1 - iou).mean()
            with torch.no_grad():
                # Where two boxes claim one anchor, the better fit sets its objectness, in whatever order they come.
                place = ((b * 3 + anchor) * ny + row) * nx + column
                wanted.view(-1).scatter_reduce_(0, place, iou.clamp(min=0).to(wanted.dtype), reduce="amax")
                weight[b, anchor, row, column] = 1
                label = targets[box, 1].long()
                kind = F.one_hot(torch.where(label == VEHICLE, VEHICLE_CLASSES[0], label), y.shape[-1] - 5).to(y.dtype)
                counted = torch.ones_like(kind)
                for c in VEHICLE_CLASSES[1:]:
                    counted[label == VEHICLE, c] = 0
            loss = F.binary_cross_entropy_with_logits(chosen[:, 5:], kind, weight=counted, reduction="sum")
            class_loss = class_loss + loss / counted.sum().clamp(min=1)
        loss = F.binary_cross_entropy_with_logits(y[..., 4], wanted, weight=weight)
        object_loss = object_loss + OBJECT_BALANCE[level] * loss
        if t is not None:
            sure = t[..., 4]
            classes = F.binary_cross_entropy_with_logits(y[:taught, ..., 5:], t[..., 5:], reduction="none").mean(-1)
            shift = (y[:taught, ..., :4].sigmoid() - t[..., :4]).abs().sum(-1)
            distil_loss = distil_loss + (sure * (classes + shift)).sum() / sure.sum().clamp(min=1)
    total = BOX_GAIN * box_loss + OBJECT_GAIN * object_loss + CLASS_GAIN * class_loss
    total = total + DISTIL_GAIN * BOX_GAIN * distil_loss
    parts = {"box": box_loss, "object": object_loss, "class": class_loss, "distil": distil_loss}
    return total * batch, {k: v.detach() for k, v in parts.items()}
