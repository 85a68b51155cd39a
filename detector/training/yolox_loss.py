"""Detection loss of a network without anchors (yolox.py): which cells learn a box follows from what the network says of it
(Ge et al., OTA, 2021, in the form of YOLOX), and distillation as in loss.py."""
from __future__ import annotations

import torch
from torch.nn import functional as F

from data import VEHICLE, VEHICLE_CLASSES
from loss import complete_iou, ignored_cells
from yolox import cells, decode

# As YOLOX weighs them: the start was learnt so, and its scores stay what they are.
BOX_GAIN, OBJECT_GAIN, CLASS_GAIN, DISTIL_GAIN = 5.0, 1.0, 1.0, 1.0
IOU_COST = 3.0  # of the logarithm of the overlap, against the cross-entropy of the class
CENTRE_RADIUS = 1.5  # a cell may learn a box whose centre is nearer than this to its own, in cells of its stride
MOST_CELLS = 10  # that learn one box


def pairwise_iou(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """n x m overlaps of boxes given as centre and size."""
    a0, a1, b0, b1 = a[:, :2] - a[:, 2:] / 2, a[:, :2] + a[:, 2:] / 2, b[:, :2] - b[:, 2:] / 2, b[:, :2] + b[:, 2:] / 2
    both = (torch.minimum(a1[:, None], b1[None]) - torch.maximum(a0[:, None], b0[None])).clamp(min=0).prod(2)
    return both / (a[:, None, 2:].prod(2) + b[None, :, 2:].prod(2) - both + 1e-7)


def kinds_of(labels: torch.Tensor, classes: int) -> tuple[torch.Tensor, torch.Tensor]:
    """What is wanted of the classes (n x classes) and which of them count: of a vehicle of unknown kind, that it is a car, and
    bus and truck are neither right nor wrong."""
    kind = F.one_hot(torch.where(labels == VEHICLE, VEHICLE_CLASSES[0], labels), classes).float()
    counted = torch.ones_like(kind)
    for c in VEHICLE_CLASSES[1:]:
        counted[labels == VEHICLE, c] = 0
    return kind, counted


@torch.no_grad()
def assign(said: torch.Tensor, kinds: torch.Tensor, at: torch.Tensor, strides: torch.Tensor, boxes: torch.Tensor,
           labels: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Which cells of one picture learn which box: (cell, box, overlap of what the cell says with it).

    `said`: n x 4, boxes of all cells (centre and size, input pixels); `kinds`: n x classes, what they say of the
    classes, 0..1; `at`, `strides`: of cells(); `boxes`, `labels`: m x 4 and m. Among the cells about a box's centre, as many
    as their ten best overlaps add up to (one at least) learn it, those of the least cost; a cell that several boxes want learns
    the one of the least cost. A box whose centre no cell is near learns nowhere.
    """
    centres = (at + 0.5) * strides[:, None]
    away = (centres[:, None] - boxes[None, :, :2]).abs().amax(2) / strides[:, None]
    near = torch.nonzero((away < CENTRE_RADIUS).any(1))[:, 0]
    if near.numel() == 0:
        empty = torch.zeros(0, dtype=torch.long, device=said.device)
        return empty, empty, said.new_zeros(0)
    may = away[near] < CENTRE_RADIUS
    iou = pairwise_iou(said[near], boxes) * may
    kind, counted = (v.to(kinds.dtype) for v in kinds_of(labels, kinds.shape[1]))
    p = kinds[near].clamp(1e-6, 1 - 1e-6)
    # The cross-entropy of each cell with each box, as two products.
    cost = -(p.log() @ (kind * counted).T + (1 - p).log() @ ((1 - kind) * counted).T)
    cost = torch.where(may, cost - IOU_COST * (iou + 1e-8).log(), torch.inf)
    best = iou.topk(min(MOST_CELLS, len(near)), 0).values.sum(0)
    count = best.long().clamp(min=1)
    order = cost.sort(dim=0, stable=True).indices
    rank = torch.empty_like(order).scatter_(0, order, torch.arange(len(near), device=said.device)[:, None].expand_as(order))
    wanted = (rank < count) & may
    least, box = torch.where(wanted, cost, torch.inf).min(1)
    row = torch.nonzero(torch.isfinite(least))[:, 0]
    return near[row], box[row], iou[row, box[row]]


def detection_loss(raw: list[torch.Tensor], targets: torch.Tensor, ignore: torch.Tensor,
                   teacher: list[torch.Tensor] | None, taught: int) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """As loss.detection_loss(), of yolox.Heads.raw()'s maps (batch x rows x columns x values, input pixels = cells x stride)."""
    batch, device = raw[0].shape[0], raw[0].device
    shapes = [tuple(y.shape[1:3]) for y in raw]
    y = torch.cat([v.reshape(batch, -1, v.shape[-1]) for v in raw], 1)
    at, strides = cells(shapes, device)
    said = decode(y[..., :4], at, strides)
    weight = torch.cat([(~ignored_cells(ignore, batch, level, ny, nx)).reshape(batch, -1)
                        for level, (ny, nx) in enumerate(shapes)], 1).to(device, y.dtype)
    wanted = torch.zeros_like(y[..., 4])
    t = None
    if teacher is not None and taught:
        t = torch.cat([v.reshape(taught, -1, v.shape[-1]) for v in teacher], 1)
        wanted[:taught] = t[..., 4].sigmoid()
    sure = y.detach()[..., 4:].sigmoid()
    picture, cell, box, iou = [], [], [], []
    for b in torch.unique(targets[:, 0]).long().tolist():
        mine = torch.nonzero(targets[:, 0] == b)[:, 0]
        c, of, overlap = assign(said[b].detach(), (sure[b, :, 1:] * sure[b, :, :1]).sqrt(), at, strides, targets[mine, 2:],
                                targets[mine, 1].long())
        picture.append(torch.full_like(c, b))
        cell.append(c)
        box.append(mine[of])
        iou.append(overlap)
    box_loss = class_loss = distil_loss = torch.zeros((), device=device)
    learnt = 0
    if picture:
        b, c, of, overlap = (torch.cat(v) for v in (picture, cell, box, iou))
        learnt = len(c)
        wanted[b, c] = 1
        weight[b, c] = 1
    if learnt:
        box_loss = (1 - complete_iou(said[b, c], targets[of, 2:])).mean()
        kind, counted = kinds_of(targets[of, 1].long(), y.shape[-1] - 5)
        class_loss = F.binary_cross_entropy_with_logits(y[b, c, 5:], kind * overlap[:, None], weight=counted,
                                                        reduction="sum") / learnt
    # By how much there is to be sure of: of a picture without anything, a cell in a hundred.
    found = (wanted * weight).sum().clamp(min=0.01 * batch)
    object_loss = F.binary_cross_entropy_with_logits(y[..., 4], wanted, weight=weight, reduction="sum") / found
    if t is not None:
        certain = t[..., 4].sigmoid()
        classes = F.binary_cross_entropy_with_logits(y[:taught, :, 5:], t[..., 5:].sigmoid(), reduction="none").sum(-1)
        shift = (y[:taught, :, :4] - t[..., :4]).abs().sum(-1)
        distil_loss = (certain * (classes + shift)).sum() / certain.sum().clamp(min=1)
    total = BOX_GAIN * box_loss + OBJECT_GAIN * object_loss + CLASS_GAIN * class_loss + DISTIL_GAIN * distil_loss
    return total, {k: v.detach() for k, v in {"box": box_loss, "object": object_loss, "class": class_loss,
                                              "distil": distil_loss}.items()}
