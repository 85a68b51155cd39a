"""One network from several that began alike: the mean of their weights, and what that does to the channels made good.

The mean of weights (Wortsman et al., Model soups, ICML 2022) of runs that are not quite in one basin has channels that differ less
from picture to picture than either's, which costs it small and rare things. So each channel before its activation is scaled
and shifted, from the first layer to the last, to have the mean of its parents' means and of their standard deviations on
pictures to learn from (Jordan et al., REPAIR: REnormalizing Permuted Activations for Interpolation Repair, ICLR 2023).
"""
from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch

import data
from augment import letterbox
from model import ConvBnAct, PathAggregation

SEEN = {"coco": 24, "visdrone": 12, "aerial_cars": 16, "cats_topdown": 8, "simulated": 10}  # pictures of each set
SIDE = 416
MOST = 2.0  # times that a channel is scaled up or down: one that is silent in the mean is not made loud


def mean_of(nets: list[PathAggregation]) -> dict[str, torch.Tensor]:
    """The mean of the states of networks that are alike."""
    states = [n.state_dict() for n in nets]
    return {k: torch.stack([s[k].double() for s in states]).mean(0).to(v.dtype) if v.dtype.is_floating_point else v
            for k, v in states[0].items()}


def looks(root: Path, simulated: Path) -> torch.Tensor:
    """n x 3 x SIDE x SIDE of 0..1: pictures to learn from, whole, and of wide sets' every second one a part at its own size."""
    rng, views = np.random.default_rng(0), []
    for source, count in SEEN.items():
        pictures = data.load(simulated if source == "simulated" else root, source, "train")
        for i in rng.choice(len(pictures), min(count, len(pictures)), replace=False):
            image = pictures[i].image
            if source in ("visdrone", "aerial_cars") and i % 2:
                y, x = (int(rng.integers(0, max(1, side - SIDE))) for side in image.shape[:2])
                image = image[y:y + SIDE, x:x + SIDE]
            views.append(letterbox(np.ascontiguousarray(image), SIDE, SIDE)[0])
    return torch.from_numpy(np.stack(views).transpose(0, 3, 1, 2).astype(np.float32) / 255)


def _over(values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    return values.mean((0, 2, 3)), values.std((0, 2, 3))


def _hooked(net: PathAggregation, hook) -> list:
    """`hook(name, convolution, what it says)` after every convolution before an activation; those of the gates stay as they are."""
    return [m.conv.register_forward_hook(lambda conv, _, said, name=name: hook(name, conv, said))
            for name, m in net.named_modules() if isinstance(m, ConvBnAct)]


@torch.no_grad()
def repair(net: PathAggregation, parents: list[PathAggregation], seen: torch.Tensor) -> None:
    """Gives each channel of `net`, the mean of `parents`, the mean of their statistics on `seen` (as looks() gives it). All must be
    fused and in evaluation mode; `net` is none of the parents."""
    wanted: dict[str, list[tuple[torch.Tensor, torch.Tensor]]] = {}
    for parent in parents:
        hooks = _hooked(parent, lambda name, _, said: wanted.setdefault(name, []).append(_over(said)) or said)
        parent.features(seen)
        for hook in hooks:
            hook.remove()

    def set_to(name: str, conv: torch.nn.Conv2d, said: torch.Tensor) -> torch.Tensor:
        (mean, spread), theirs = _over(said), wanted[name]
        to, of = (torch.stack([t[i] for t in theirs]).mean(0) for i in (0, 1))
        gain = (of / spread).nan_to_num(1.0).clamp(1 / MOST, MOST)
        conv.weight.mul_(gain[:, None, None, None])
        conv.bias.copy_((conv.bias - mean) * gain + to)
        # What follows sees it mended.
        return (said - mean[:, None, None]) * gain[:, None, None] + to[:, None, None]

    hooks = _hooked(net, set_to)
    net.features(seen)
    for hook in hooks:
        hook.remove()
