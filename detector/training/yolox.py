"""CBAM-YOLOX-Nano: the backbone and neck of model.py with depthwise convolutions, and heads without anchors (Ge et al., YOLOX,
2021), where boxes, objectness and classes have layers of their own.

The layers have model.py's numbers; only that the pooling comes before the last stage of the backbone. The published network
reads 2x2 blocks of pixels as 12 channels of a 3x3 convolution, which is a 6x6 convolution of stride 2, as layer 0 has it here.
"""
from __future__ import annotations

import math

import torch
from torch import nn

from model import ConvBnAct, CspStage, DepthwiseConv, PathAggregation, Sppf
from names import CLASSES, STRIDES

ATTENTION_AFTER = {4: 64, 6: 128, 9: 256}  # layers that the neck reads, with their channels
HIDDEN = 64  # channels of the heads


class Head(nn.Module):
    """Of one stride. raw() gives batch x (4 + 1 + classes) x rows x columns: centre from the cell's corner in cells, logarithm
    of the size in cells, objectness and classes before the sigmoid."""

    def __init__(self, c_in: int, classes: int):
        super().__init__()
        self.stem = ConvBnAct(c_in, HIDDEN)
        self.classes = nn.Sequential(DepthwiseConv(HIDDEN, HIDDEN), DepthwiseConv(HIDDEN, HIDDEN))
        self.boxes = nn.Sequential(DepthwiseConv(HIDDEN, HIDDEN), DepthwiseConv(HIDDEN, HIDDEN))
        self.class_out, self.box_out, self.object_out = (nn.Conv2d(HIDDEN, c, 1) for c in (classes, 4, 1))
        with torch.no_grad():  # one cell in a hundred holds a thing, before anything is learnt
            self.object_out.bias.fill_(-math.log(99))
            self.class_out.bias.fill_(-math.log(99))

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        x = self.stem(x)
        y = self.boxes(x)
        return self.box_out(y), self.object_out(y), self.class_out(self.classes(x))


class Heads(nn.Module):
    def __init__(self, classes: int, channels: tuple[int, int, int]):
        super().__init__()
        self.values = 5 + classes
        self.m = nn.ModuleList(Head(c, classes) for c in channels)

    def raw(self, maps: list[torch.Tensor]) -> list[torch.Tensor]:
        """Per stride: batch x rows x columns x (x, y, w, h, objectness, classes), before the sigmoid."""
        return [torch.cat(head(x), 1).permute(0, 2, 3, 1) for head, x in zip(self.m, maps)]

    def forward(self, maps: list[torch.Tensor]) -> torch.Tensor:
        """Layout "yolox" of detector/model_info.h: batch x cells x (5 + classes), boxes still relative to their cells."""
        levels = []
        for head, x in zip(self.m, maps):
            box, sure, kind = head(x)
            levels.append(torch.cat((box, sure.sigmoid(), kind.sigmoid()), 1).flatten(2))
        return torch.cat(levels, 2).permute(0, 2, 1)


def cells(shapes: list[tuple[int, int]], device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
    """Of maps of (rows, columns) at the three strides, one after the other: column and row of each cell (n x 2), its stride (n)."""
    at, strides = [], []
    for (ny, nx), stride in zip(shapes, STRIDES):
        gy, gx = torch.meshgrid(torch.arange(ny, device=device), torch.arange(nx, device=device), indexing="ij")
        at.append(torch.stack((gx, gy), -1).reshape(-1, 2).float())
        strides.append(torch.full((ny * nx,), float(stride), device=device))
    return torch.cat(at), torch.cat(strides)


def decode(relative: torch.Tensor, at: torch.Tensor, strides: torch.Tensor) -> torch.Tensor:
    """... x n x 4 relative to the cells, to centre and size in input pixels."""
    s = strides[:, None]
    # Far beyond any input, and finite: what a network says before it has learnt may be anything.
    return torch.cat(((relative[..., :2] + at) * s, relative[..., 2:4].clamp(max=10).exp() * s), -1)


class CbamYolox(PathAggregation):
    layout = "yolox"

    def __init__(self, size: str = "nano", classes: int = len(CLASSES), attention: bool = True):
        if size != "nano":
            raise ValueError(f"{size}: of YOLOX there is only nano")
        stage = lambda c_in, c_out, n=1, shortcut=False: CspStage(c_in, c_out, n, shortcut, depthwise=True)  # noqa: E731
        super().__init__([
            ConvBnAct(3, 16, 6, 2, 2), DepthwiseConv(16, 32, 2), stage(32, 32, 1, True),
            DepthwiseConv(32, 64, 2), stage(64, 64, 3, True),
            DepthwiseConv(64, 128, 2), stage(128, 128, 3, True),
            DepthwiseConv(128, 256, 2), Sppf(256, 256), stage(256, 256),
            ConvBnAct(256, 128), nn.Identity(), nn.Identity(), stage(256, 128),
            ConvBnAct(128, 64), nn.Identity(), nn.Identity(), stage(128, 64),
            DepthwiseConv(64, 64, 2), nn.Identity(), stage(128, 128),
            DepthwiseConv(128, 128, 2), nn.Identity(), stage(256, 256),
            Heads(classes, (64, 128, 256)),
        ], ATTENTION_AFTER if attention else {})

    def boxes(self, x: torch.Tensor) -> torch.Tensor:
        y = self.forward(x)
        shapes = [(x.shape[2] // s, x.shape[3] // s) for s in STRIDES]
        return torch.cat((decode(y[..., :4], *cells(shapes, y.device)), y[..., 4:]), -1)

    def name(self) -> str:
        return ("cbam_" if self.cbam else "") + "yolox_nano"
