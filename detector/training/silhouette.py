#!/usr/bin/env python3
"""Teaches a trained detector silhouettes, without touching its boxes, and exports it with them.

  silhouette.py --labels LABELS --held-out LABELS --model ../models/cbam_yolov5n_416.onnx --out ../models

The detector's weights are read from the ONNX file and stay as they are; only a head of 18,000 parameters on its three maps
learns (model.Silhouette), from what silhouette_labels.py has made of COCO train2017. The maps of augmented views are
computed once (3 GB of memory). Prints the intersection over union with the labels of the held-out pictures.
"""
from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import onnx
import torch
from onnx import numpy_helper
from torch import nn

import export
from augment import BORDER
from model import CbamYolov5, Silhouette, WithSilhouettes

SIDE = 416


def read_onnx(path: Path) -> CbamYolov5:
    """The network of size n with attention whose weights export.py has written; ValueError when they are not that."""
    net = CbamYolov5("n").eval().fuse()
    # In a file with silhouettes the detector's weights begin with "net.".
    weights = {w.name.removeprefix("net."): torch.from_numpy(numpy_helper.to_array(w).copy())
               for w in onnx.load(str(path)).graph.initializer}
    own = {k: weights[k] for k in net.state_dict() if k in weights}
    if len(own) != len(net.state_dict()):
        raise ValueError(f"{path}: lacks {sorted(set(net.state_dict()) - set(own))[:3]}, not a model of export.py")
    net.load_state_dict(own)
    return net


def place(held: tuple[np.ndarray, ...], rng: np.random.Generator | None) -> list[np.ndarray]:
    """Picture, covered and weight on a square; scaled, moved and mirrored by chance, or as it is without `rng`."""
    image, covered, ignore = held
    h, w = image.shape[:2]
    scale = SIDE / max(h, w) * (rng.uniform(0.5, 1.9) if rng else 1.0)
    size = (max(1, int(w * scale)), max(1, int(h * scale)))
    parts = [cv2.resize(image, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR),
             cv2.resize(covered, size, interpolation=cv2.INTER_LINEAR),
             1 - cv2.resize(ignore, size, interpolation=cv2.INTER_NEAREST)]
    if rng and rng.random() < 0.5:
        parts = [p[:, ::-1] for p in parts]
    at = [int(rng.integers(min(0, SIDE - s), max(0, SIDE - s) + 1)) if rng else (SIDE - s) // 2 for s in size]
    low, high = [max(0, a) for a in at], [min(SIDE, a + s) for a, s in zip(at, size)]
    out = []
    for part, fill in zip(parts, (BORDER, 0, 0)):
        square = np.full((SIDE, SIDE, *part.shape[2:]), fill, np.uint8)
        square[low[1]:high[1], low[0]:high[0]] = part[low[1] - at[1]:high[1] - at[1], low[0] - at[0]:high[0] - at[0]]
        out.append(square)
    return out


def view(pictures: list, people: list, rng: np.random.Generator) -> list[np.ndarray]:
    """One augmented view: sometimes two pictures side by side, grey, brighter or darker, blurred."""
    pick = lambda held: held[int(rng.integers(len(held)))]  # noqa: E731
    image, covered, weight = place(pick(people if rng.random() < 0.75 else pictures), rng)
    if rng.random() < 0.4:
        x = int(rng.integers(100, SIDE - 100))
        for mine, other in zip((image, covered, weight), place(pick(people), rng)):
            mine[:, x:] = other[:, x:]
    if rng.random() < 0.3:
        image = np.repeat(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None], 3, 2)
    image = np.clip(image * rng.uniform(0.6, 1.4) + rng.uniform(-20, 20), 0, 255).astype(np.uint8)
    if rng.random() < 0.25:
        image = cv2.blur(image, (int(rng.choice([1, 3, 5, 7])), int(rng.choice([1, 3, 5]))))
    return [image, covered, weight]


@torch.no_grad()
def maps(net: CbamYolov5, views) -> tuple[list[torch.Tensor], torch.Tensor, torch.Tensor]:
    """Half-precision maps of the views, and at their quarter size what is covered (0..1) and what counts."""
    out: list[list[torch.Tensor]] = [[], [], []]
    covered, weight = [], []
    for image, c, w in views:
        x = torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1))[None]).float() / 255
        for held, m in zip(out, net.features(x)):
            held.append(m[0].half())
        quarter = (SIDE // 4, SIDE // 4)
        covered.append(torch.from_numpy(cv2.resize(c, quarter, interpolation=cv2.INTER_AREA))[None])
        weight.append(torch.from_numpy(cv2.resize(w, quarter, interpolation=cv2.INTER_NEAREST))[None])
    return [torch.stack(m) for m in out], torch.stack(covered), torch.stack(weight)


@torch.no_grad()
def overlap(head: Silhouette, held, threshold: float) -> float:
    """Intersection over union with the labels, over all pictures together."""
    both = either = 0
    for i in range(len(held[1])):
        seen = head([m[i:i + 1].float() for m in held[0]]).sigmoid()[0] > threshold
        truth, counts = held[1][i] > 127, held[2][i] > 0
        both += int((seen & truth & counts).sum())
        either += int(((seen | truth) & counts).sum())
    return both / max(either, 1)


def train(head: Silhouette, held, steps: int, rng: np.random.Generator) -> None:
    optimiser = torch.optim.AdamW(head.parameters(), lr=3e-3, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for step in range(steps):
        k = torch.from_numpy(rng.choice(len(held[1]), min(12, len(held[1])), replace=False))
        covered, weight = held[1][k].float() / 255, held[2][k].float()
        loss = nn.functional.binary_cross_entropy_with_logits(head([m[k].float() for m in held[0]]), covered, weight,
                                                              reduction="sum") / weight.sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        schedule.step()
        if step % 100 == 99:
            print(f"step {step + 1}/{steps} loss {loss.item():.4f}", flush=True)


def read_labels(folder: Path) -> list[tuple[np.ndarray, ...]]:
    files = sorted(folder.glob("*.npz"))
    if not files:
        raise ValueError(f"{folder}: holds no labels; make them with silhouette_labels.py")
    return [tuple(np.load(f)[k] for k in ("image", "covered", "ignore")) for f in files]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--labels", required=True, type=Path)
    parser.add_argument("--held-out", required=True, type=Path)
    parser.add_argument("--model", required=True, type=Path)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--reference", type=Path, help="as of export.py")
    parser.add_argument("--views", type=int, default=2120)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--save", type=Path, help="file for the head that was learnt")
    parser.add_argument("--head", type=Path, help="a head that was learnt before: only export")
    args = parser.parse_args()
    torch.manual_seed(args.seed)
    torch.set_num_threads(1)
    rng = np.random.default_rng(args.seed)
    net = read_onnx(args.model)
    c = [net.model[i].cv3.conv.out_channels for i in (17, 20, 23)]
    head = Silhouette((c[0], c[1], c[2]))
    seen = [held for held in read_labels(args.held_out) if (held[1] > 127).any()]
    if args.head:
        head.load_state_dict(torch.load(args.head))
    else:
        pictures = read_labels(args.labels)
        people = [held for held in pictures if (held[1] > 127).any()]
        train(head, maps(net, (view(pictures, people, rng) for _ in range(args.views))), args.steps, rng)
        if args.save:
            torch.save(head.state_dict(), args.save)
    scored = maps(net, (place(held, None) for held in seen))
    for threshold in (0.3, 0.5):
        print(f"held out: intersection over union {overlap(head, scored, threshold):.3f} at {threshold}")
    both = WithSilhouettes(net, head).eval()
    if args.reference:
        for size in export.SIZES:
            export.write_reference(both, size, args.reference / f"cbam_yolov5n_{size}.reference")
    export.write_models(both, "cbam_yolov5n", export.SIZES, args.out)


if __name__ == "__main__":
    main()
