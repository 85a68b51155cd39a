"""CBAM-YOLOv5: CSP backbone, SPPF, path aggregation, three heads, and attention where the backbone leaves for the neck.

The layer numbers are those of YOLOv5 v6 (0..24), so that published COCO weights load by name. Attention (Woo et al.,
CBAM, ECCV 2018) sits after layers 4, 6 and 9, the three maps that the neck reads; `attention=False` gives the same
network without it, for the comparison that the paper makes in its Table 1.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import nn

from names import CLASSES, STRIDES

ANCHORS = (  # pixels of the network's input; three for each stride
    ((10, 13), (16, 30), (33, 23)),
    ((30, 61), (62, 45), (59, 119)),
    ((116, 90), (156, 198), (373, 326)),
)
# Layers that the neck reads, with the width of each at width multiple 1.
ATTENTION_AFTER = {4: 256, 6: 512, 9: 1024}
# How far the last layers of the gates are from zero before Cbam.begin() measures them: anything but zero.
_GATE_WEIGHTS = 0.3
# By how much what a gate's sigmoid reads differs from picture to picture, or from place to place, at the start. The gates then
# spread by 0.15. At 0.5 they spread by 0.11 and COCO's network finds less (people that choose: 0.514 of AP50 before any
# training; 0.629 at 0.25, which spreads them by 0.06; 0.618 with gates of chance that hardly move). Learning takes half of the
# spread away again: from 0.5 three seeds ended at 0.045, 0.051 and 0.051; from 0.65 they have 0.061 to 0.068 after 1,000 steps.
GATE_START = 0.65


@dataclass(frozen=True)
class Size:
    """Width and depth multiples: n is the delivered size, s the next larger."""

    width: float
    depth: float

    def channels(self, c: int) -> int:
        return int(math.ceil(c * self.width / 8) * 8)

    def repeats(self, n: int) -> int:
        return max(round(n * self.depth), 1)


SIZES = {"n": Size(0.25, 1 / 3), "s": Size(0.5, 1 / 3)}


class ConvBnAct(nn.Module):
    """Convolution, batch norm, SiLU. `fuse()` folds the norm into the convolution for export."""

    def __init__(self, c_in: int, c_out: int, k: int = 1, s: int = 1, p: int | None = None, groups: int = 1):
        super().__init__()
        self.conv = nn.Conv2d(c_in, c_out, k, s, k // 2 if p is None else p, groups=groups, bias=False)
        self.bn: nn.BatchNorm2d | None = nn.BatchNorm2d(c_out, eps=1e-3, momentum=0.03)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = self.conv(x)
        if self.bn is not None:
            y = self.bn(y)
        return nn.functional.silu(y, inplace=self.training)

    @torch.no_grad()
    def fuse(self) -> None:
        if self.bn is None:
            return
        scale = self.bn.weight / torch.sqrt(self.bn.running_var + self.bn.eps)
        fused = nn.Conv2d(self.conv.in_channels, self.conv.out_channels, self.conv.kernel_size, self.conv.stride,
                          self.conv.padding, groups=self.conv.groups, bias=True)
        fused.weight.copy_(self.conv.weight * scale[:, None, None, None])
        fused.bias.copy_(self.bn.bias - self.bn.running_mean * scale)
        self.conv, self.bn = fused, None


class DepthwiseConv(nn.Sequential):
    """A 3x3 convolution of each channel by itself, then a 1x1 across them (YOLOX-Nano in place of every 3x3)."""

    def __init__(self, c_in: int, c_out: int, s: int = 1):
        super().__init__(ConvBnAct(c_in, c_in, 3, s, groups=c_in), ConvBnAct(c_in, c_out))


class Bottleneck(nn.Module):
    def __init__(self, c: int, shortcut: bool, depthwise: bool = False):
        super().__init__()
        self.cv1, self.shortcut = ConvBnAct(c, c, 1), shortcut
        self.cv2 = DepthwiseConv(c, c) if depthwise else ConvBnAct(c, c, 3)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        y = self.cv2(self.cv1(x))
        return x + y if self.shortcut else y


class CspStage(nn.Module):
    """Cross-stage partial stage with three 1x1 convolutions (YOLOv5's C3)."""

    def __init__(self, c_in: int, c_out: int, n: int, shortcut: bool = True, depthwise: bool = False):
        super().__init__()
        half = c_out // 2
        self.cv1, self.cv2 = ConvBnAct(c_in, half), ConvBnAct(c_in, half)
        self.cv3 = ConvBnAct(2 * half, c_out)
        self.m = nn.Sequential(*(Bottleneck(half, shortcut, depthwise) for _ in range(n)))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.cv3(torch.cat((self.m(self.cv1(x)), self.cv2(x)), 1))


class Sppf(nn.Module):
    """Spatial pyramid pooling as three 5x5 poolings in a row."""

    def __init__(self, c_in: int, c_out: int):
        super().__init__()
        self.cv1, self.cv2 = ConvBnAct(c_in, c_in // 2), ConvBnAct(c_in * 2, c_out)
        self.m = nn.MaxPool2d(5, 1, 2)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = self.cv1(x)
        a = self.m(x)
        b = self.m(a)
        return self.cv2(torch.cat((x, a, b, self.m(b)), 1))


class Cbam(nn.Module):
    """Channel attention, then spatial attention (Woo et al., equations 1 to 3).

    Channel: sigmoid(MLP(avg) + MLP(max)), one MLP with reduction 16 for both poolings. Spatial: sigmoid of a 7x7
    convolution over the mean and the maximum across channels. Both gates start around a half, where a sigmoid is steepest,
    with small weights: the block starts as nearly a multiplication by `start_gain`, which load_coco() takes out of the
    next layers. What maps the network has is not known before it has its weights, so begin() sets the scales by what is seen
    (Mishkin and Matas, All you need is a good init, ICLR 2016): with weights of a size that was guessed, the units between of
    layers 4 and 6 were silent for every picture, died, and their gates stayed constants.
    """

    def __init__(self, c: int, reduction: int = 16):
        super().__init__()
        hidden = max(c // reduction, 4)
        self.mlp = nn.Sequential(nn.Conv2d(c, hidden, 1), nn.ReLU(), nn.Conv2d(hidden, c, 1))
        self.spatial = nn.Conv2d(2, 1, 7, padding=3)
        with torch.no_grad():
            self.mlp[2].weight.normal_(0, _GATE_WEIGHTS / math.sqrt(hidden))
            self.mlp[2].bias.zero_()
            self.spatial.weight.normal_(0, _GATE_WEIGHTS / math.sqrt(2 * 7 * 7))
            self.spatial.bias.zero_()

    @torch.no_grad()
    def begin(self, x: torch.Tensor, start: float = GATE_START) -> None:
        """Scales and centres by maps `x` that the block will see (batch x c x rows x columns, two pictures and more): each unit
        between switches in the middle of its pictures, half of the units by their means and half by their maxima; what the
        sigmoids read is 0 in the mean and differs by `start` between pictures (each channel's) and between places."""
        first, last = self.mlp[0], self.mlp[2]
        pools = nn.functional.adaptive_avg_pool2d(x, 1), nn.functional.adaptive_max_pool2d(x, 1)
        for half, pool in enumerate(pools):
            rows = slice(half, None, 2)
            seen = nn.functional.conv2d(pool, first.weight[rows])
            scale = _differs(seen, (0, 2, 3))
            first.weight[rows] /= scale[:, None, None, None]
            first.bias[rows] = -seen.mean((0, 2, 3)) / scale
        last.bias.zero_()
        last.weight *= (start / _differs(sum(self.mlp(p) for p in pools), (0, 2, 3)))[:, None, None, None]
        last.bias.copy_(-sum(self.mlp(p) for p in pools).mean((0, 2, 3)) / 2)  # of both poolings, each adds it
        maps = self._maps(x * self._channel(x))
        self.spatial.bias.zero_()
        self.spatial.weight *= start / _differs(self.spatial(maps), (0, 1, 2, 3))
        self.spatial.bias.fill_(-float(self.spatial(maps).mean()))

    @staticmethod
    def start_gain() -> float:
        return 0.5 * 0.5

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        x = x * self._channel(x)
        return x * self._spatial(x)

    def gates(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The channel gate (batch x channels x 1 x 1) and, of what it leaves, the spatial one (batch x 1 x rows x columns)."""
        channel = self._channel(x)
        return channel, self._spatial(x * channel)

    def _channel(self, x: torch.Tensor) -> torch.Tensor:
        average = nn.functional.adaptive_avg_pool2d(x, 1)
        largest = nn.functional.adaptive_max_pool2d(x, 1)
        return torch.sigmoid(self.mlp(average) + self.mlp(largest))

    def _spatial(self, x: torch.Tensor) -> torch.Tensor:
        return torch.sigmoid(self.spatial(self._maps(x)))

    @staticmethod
    def _maps(x: torch.Tensor) -> torch.Tensor:
        c = int(x.shape[1])
        # The mean as a convolution: for a mean across channels OpenCV would transpose the whole map.
        mean = nn.functional.conv2d(x, torch.full((1, c, 1, 1), 1 / c, dtype=x.dtype, device=x.device))
        return torch.cat((mean, x.amax(1, keepdim=True)), 1)


def _differs(x: torch.Tensor, over: tuple[int, ...]) -> torch.Tensor:
    """The standard deviation over these dimensions, so much above zero that one may divide by it."""
    return x.std(over, unbiased=False).clamp(min=1e-6)


class Heads(nn.Module):
    """One 1x1 convolution a stride. Training reads the raw maps; inference gets boxes in input pixels."""

    def __init__(self, classes: int, channels: tuple[int, int, int]):
        super().__init__()
        self.values = 5 + classes
        self.m = nn.ModuleList(nn.Conv2d(c, 3 * self.values, 1) for c in channels)

    def raw(self, maps: list[torch.Tensor]) -> list[torch.Tensor]:
        """Per stride: batch x 3 anchors x rows x columns x (x, y, w, h, objectness, classes), before the sigmoid."""
        out = []
        for conv, x in zip(self.m, maps):
            y = conv(x)
            b, _, ny, nx = y.shape
            out.append(y.view(b, 3, self.values, ny, nx).permute(0, 1, 3, 4, 2))
        return out

    def forward(self, maps: list[torch.Tensor]) -> torch.Tensor:
        return torch.cat([decode_level(y, i).reshape(y.shape[0], -1, self.values)
                          for i, y in enumerate(self.raw(maps))], 1)


def decode_level(raw: torch.Tensor, level: int) -> torch.Tensor:
    """Raw values of one stride to centre, size (input pixels), objectness and class probabilities."""
    ny, nx = int(raw.shape[2]), int(raw.shape[3])
    gy, gx = torch.meshgrid(torch.arange(ny, device=raw.device), torch.arange(nx, device=raw.device), indexing="ij")
    # Half a cell is taken off here, once, instead of inside the network for every value.
    offset = (torch.stack((gx, gy), -1).to(raw.dtype) - 0.5).view(1, 1, ny, nx, 2) * STRIDES[level]
    anchors = torch.tensor(ANCHORS[level], dtype=raw.dtype, device=raw.device).view(1, 3, 1, 1, 2)
    p = raw.sigmoid()
    xy = p[..., 0:2] * (2.0 * STRIDES[level]) + offset.expand(1, 3, ny, nx, 2)
    wh = (p[..., 2:4] * 2.0) ** 2 * anchors.expand(1, 3, ny, nx, 2)
    return torch.cat((xy, wh, p[..., 4:]), -1)


class PathAggregation(nn.Module):
    """A network by YOLOv5's numbers: `model` holds layers 0 to 24, the last of them the heads, `cbam` the attention.

    raw() gives what training reads, forward() what is exported and boxes() rows of centre and size in input pixels,
    objectness and classes after the sigmoid.
    """

    def __init__(self, layers: list[nn.Module], attention: dict[int, int]):
        super().__init__()
        self.model = nn.ModuleList(layers)
        # Drawn alike whatever the run's seed: only what begins alike has a mean of weights that means something.
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            self.cbam = nn.ModuleDict({str(i): Cbam(c) for i, c in attention.items()})

    def _attend(self, i: int, x: torch.Tensor) -> torch.Tensor:
        return self.cbam[str(i)](x) if str(i) in self.cbam else x

    def begin_attention(self, x: torch.Tensor) -> None:
        """Sets the start of every block of attention, first to last, by pictures (batch x 3 x rows x columns, 0..1)."""
        hooks = [block.register_forward_pre_hook(lambda b, seen: b.begin(seen[0])) for block in self.cbam.values()]
        with torch.no_grad():
            self.features(x)
        for hook in hooks:
            hook.remove()

    def features(self, x: torch.Tensor) -> list[torch.Tensor]:
        m = self.model
        up = lambda t: nn.functional.interpolate(t, scale_factor=2.0, mode="nearest")  # noqa: E731
        p3 = self._attend(4, m[4](m[3](m[2](m[1](m[0](x))))))
        p4 = self._attend(6, m[6](m[5](p3)))
        p5 = self._attend(9, m[9](m[8](m[7](p4))))
        n5 = m[10](p5)
        n4 = m[14](m[13](torch.cat((up(n5), p4), 1)))
        o3 = m[17](torch.cat((up(n4), p3), 1))
        o4 = m[20](torch.cat((m[18](o3), n4), 1))
        o5 = m[23](torch.cat((m[21](o4), n5), 1))
        return [o3, o4, o5]

    def raw(self, x: torch.Tensor) -> list[torch.Tensor]:
        return self.model[24].raw(self.features(x))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return self.model[24](self.features(x))

    def boxes(self, x: torch.Tensor) -> torch.Tensor:
        return self.forward(x)

    def fuse(self) -> "PathAggregation":
        for module in self.modules():
            if isinstance(module, ConvBnAct):
                module.fuse()
        return self


class CbamYolov5(PathAggregation):
    layout = "yolov5"

    def __init__(self, size: str = "n", classes: int = len(CLASSES), attention: bool = True):
        s = SIZES[size]
        c = s.channels
        c64, c128, c256, c512, c1024 = (c(v) for v in (64, 128, 256, 512, 1024))
        layers: list[nn.Module] = [
            ConvBnAct(3, c64, 6, 2, 2), ConvBnAct(c64, c128, 3, 2), CspStage(c128, c128, s.repeats(3)),
            ConvBnAct(c128, c256, 3, 2), CspStage(c256, c256, s.repeats(6)),
            ConvBnAct(c256, c512, 3, 2), CspStage(c512, c512, s.repeats(9)),
            ConvBnAct(c512, c1024, 3, 2), CspStage(c1024, c1024, s.repeats(3)), Sppf(c1024, c1024),
            ConvBnAct(c1024, c512), nn.Identity(), nn.Identity(), CspStage(c1024, c512, s.repeats(3), False),
            ConvBnAct(c512, c256), nn.Identity(), nn.Identity(), CspStage(c512, c256, s.repeats(3), False),
            ConvBnAct(c256, c256, 3, 2), nn.Identity(), CspStage(c512, c512, s.repeats(3), False),
            ConvBnAct(c512, c512, 3, 2), nn.Identity(), CspStage(c1024, c1024, s.repeats(3), False),
            Heads(classes, (c256, c512, c1024)),
        ]
        super().__init__(layers, {i: c(w) for i, w in ATTENTION_AFTER.items()} if attention else {})
        prior = math.log(8 / (640 / 32) ** 2)  # about eight objects a picture before anything is learnt
        with torch.no_grad():
            for conv in self.model[24].m:
                conv.bias.view(3, -1)[:, 4] += prior

    def name(self) -> str:
        return ("cbam_" if self.cbam else "") + ("yolov5n" if self.model[0].conv.out_channels == 16 else "yolov5s")
