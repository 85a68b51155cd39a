"""Which of a run's weights are kept: figures on the pictures that choose (split.py), and whether the gates of CBAM move."""
from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch

import data
from augment import letterbox
from data import Picture
from model import PathAggregation
from network import to_picture
from scoring import score_set

# How many pictures of each set the gates are looked at on: sixteen.
GATE_PICTURES = {"coco": 6, "visdrone": 2, "aerial_cars": 4, "cats_topdown": 4}
GATE_INPUT = (416, 320)
# Below this spread a gate is as good as a constant, and what CBAM does is not tested.
LEAST_SPREAD = 0.05


class TorchNetwork:
    """A network in PyTorch where evaluate.py takes a file."""

    def __init__(self, net: PathAggregation, width: int, height: int, device: torch.device):
        self.net, self.width, self.height, self.device = net, width, height, device

    @torch.no_grad()
    def detect(self, image: np.ndarray, threshold: float) -> tuple[np.ndarray, np.ndarray]:
        view, scale, left, top = letterbox(image, self.width, self.height)
        x = torch.from_numpy(view).to(self.device).permute(2, 0, 1)[None].float() / 255
        y = self.net.boxes(x)[0].cpu().numpy()
        scores = y[:, 4:5] * y[:, 5:]
        sure = scores.max(1) > threshold
        return to_picture(y[sure, :4], scale, left, top, image.shape), scores[sure]


def pictures_that_choose(root: Path, permissive: bool = False) -> dict[str, list[Picture]]:
    return {s: data.load(root, s, "choose", permissive=permissive) for s in data.sets_of(permissive)}


def figures(net: PathAggregation, pictures: dict[str, list[Picture]], view: int, device: torch.device) -> dict[str, float]:
    """AP50 of people and of vehicles in each set that has them. `net` must be in evaluation mode."""
    network = TorchNetwork(net, view, view, device)
    out = {}
    for source, of in pictures.items():
        if not of:
            continue
        scored = score_set(network, of)
        if scored["vehicle_AP50"] is not None:
            out[f"{source} vehicle"] = scored["vehicle_AP50"]
        if "person" in scored.get("AP50", {}):
            out[f"{source} person"] = scored["AP50"]["person"]
    return out


def gate_inputs(pictures: dict[str, list[Picture]]) -> torch.Tensor:
    """The first pictures of each set, n x 3 x rows x columns of 0..1. They fill the input, so that no letterbox's border counts."""
    seen = [p.image for s, n in GATE_PICTURES.items() for p in pictures.get(s, [])[:n]]
    planes = [cv2.resize(image, GATE_INPUT, interpolation=cv2.INTER_AREA).transpose(2, 0, 1) for image in seen]
    return torch.from_numpy(np.array(planes, np.float32).reshape(-1, 3, *GATE_INPUT[::-1]) / 255)


@torch.no_grad()
def gate_spreads(net: PathAggregation, pictures: dict[str, list[Picture]], device: torch.device) -> dict[str, float]:
    """How much each gate follows what it sees. Channel gates: the standard deviation of each channel's over the pictures,
    averaged over the channels; spatial ones: of all places of all pictures. Empty without CBAM. `net` must be in evaluation mode."""
    inputs = gate_inputs(pictures)
    if not net.cbam or len(inputs) < 2:
        return {}
    held: dict[str, list[tuple[torch.Tensor, torch.Tensor]]] = {k: [] for k in net.cbam}
    hooks = [block.register_forward_pre_hook(lambda m, x, k=k: held[k].append(tuple(g.cpu() for g in m.gates(x[0]))))
             for k, block in net.cbam.items()]
    for image in inputs:
        net.features(image[None].to(device))
    for hook in hooks:
        hook.remove()
    out = {}
    for layer, gates in held.items():
        channel, spatial = torch.cat([c for c, _ in gates]), torch.cat([s for _, s in gates])
        out[f"{layer} channel"] = float(channel.std(0, unbiased=False).mean())
        out[f"{layer} spatial"] = float(spatial.std(unbiased=False))
    return out


def spread(spreads: dict[str, float]) -> float:
    """One figure: the smaller of the channel gates' mean and the spatial gates' mean. A network whose gates of one kind stand
    still has half of a CBAM."""
    kinds = [[v for k, v in spreads.items() if k.endswith(kind)] for kind in ("channel", "spatial")]
    return min(float(np.mean(k)) if k else 0.0 for k in kinds)


def told(spreads: dict[str, float]) -> str:
    if not spreads:
        return "no gates"
    each = ", ".join(f"{k} {v:.4f}" for k, v in spreads.items())
    return f"spread of the gates {spread(spreads):.4f} ({each}); wanted {LEAST_SPREAD}"
