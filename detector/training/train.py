#!/usr/bin/env python3
"""Trains CBAM-YOLOv5 from the COCO arrays on the sets of one data folder. Stops and goes on: run the same command again.

Every step draws its pictures from a generator seeded by (seed, step), so a run that was cut off and continued sees what
an unbroken one sees.
"""
from __future__ import annotations

import argparse
import json
import math
import os
import time
from pathlib import Path

import cv2
import numpy as np
import torch

import data
from augment import View, letterbox, mosaic, single
from data import Picture
from loss import detection_loss
from model import CbamYolov5, load_coco

MOSAIC_SHARE = 0.4
PEOPLE_UNLABELLED = ("aerial_cars", "cats_topdown")


def draw_batch(pictures: dict[str, list[Picture]], args: argparse.Namespace, step: int) -> list[View]:
    """COCO comes first: the teacher sees it too."""
    rng = np.random.default_rng((args.seed, step))
    views = []
    for source, count in data.sources_of_step(step, args.batch):
        pool = pictures[source]
        for _ in range(count):
            if rng.random() < MOSAIC_SHARE:
                four = [pool[i] for i in rng.integers(0, len(pool), 4)]
                views.append(mosaic(four, args.window, args.view, rng))
            else:
                views.append(single(pool[rng.integers(0, len(pool))], args.window, args.view, rng))
    return views


def to_tensors(views: list[View]) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    images = torch.from_numpy(np.stack([v.image for v in views])).permute(0, 3, 1, 2).float() / 255
    targets, ignore = [np.zeros((0, 6), np.float32)], [np.zeros((0, 5), np.float32)]
    for i, v in enumerate(views):
        n = len(v.labels)
        centre, extent = (v.boxes[:, :2] + v.boxes[:, 2:]) / 2, v.boxes[:, 2:] - v.boxes[:, :2]
        targets.append(np.concatenate((np.full((n, 1), i), v.labels[:, None], centre, extent), 1))
        ignore.append(np.concatenate((np.full((len(v.ignore), 1), i), v.ignore), 1))
    as_tensor = lambda rows: torch.from_numpy(np.concatenate(rows).astype(np.float32))  # noqa: E731
    return images.contiguous(), as_tensor(targets), as_tensor(ignore)


@torch.no_grad()
def find_unlabelled_people(teacher: CbamYolov5, pictures: list[Picture], size: int, threshold: float = 0.3) -> int:
    """Sets that label vehicles only still show people: where the COCO network sees one, nothing is learnt."""
    found = 0
    for p in pictures:
        view, scale, left, top = letterbox(p.image, size)
        x = torch.from_numpy(view).permute(2, 0, 1)[None].float() / 255
        y = teacher(x)[0]
        y = y[y[:, 4] * y[:, 5] > threshold].numpy()
        half = y[:, 2:4] / 2
        boxes = (np.concatenate((y[:, :2] - half, y[:, :2] + half), 1) - (left, top, left, top)) / scale
        p.ignore = np.concatenate((p.ignore, boxes.astype(np.float32)))
        found += len(boxes)
    return found


def parameter_groups(net: CbamYolov5, frozen: int, lr: float) -> list[dict]:
    """Attention and heads learn at the full rate, the neck at a half, the backbone at a fifth, the first stages not."""
    groups: dict[float, list[torch.nn.Parameter]] = {1.0: [], 0.5: [], 0.2: []}
    for name, parameter in net.named_parameters():
        if name.startswith("cbam."):
            groups[1.0].append(parameter)
            continue
        layer = int(name.split(".")[1])
        if layer < frozen:
            parameter.requires_grad_(False)
        else:
            groups[1.0 if layer == 24 else 0.5 if layer >= 10 else 0.2].append(parameter)
    return [{"params": p, "lr": lr * share, "share": share} for share, p in groups.items()]


class Average:
    """Exponential moving average of every number of the network; the average is what is exported."""

    def __init__(self, net: CbamYolov5, decay: float):
        self.decay, self.state = decay, {k: v.detach().clone() for k, v in net.state_dict().items()}

    @torch.no_grad()
    def update(self, net: CbamYolov5, step: int) -> None:
        decay = min(self.decay, (1 + step) / (10 + step))
        for k, v in net.state_dict().items():
            if v.dtype.is_floating_point:
                self.state[k].lerp_(v, 1 - decay)


def save(path: Path, **content) -> None:
    """All or nothing: a run that is killed while writing leaves the previous file."""
    part = path.with_suffix(".part")
    torch.save(content, part)
    os.replace(part, path)


def learning_rate(step: int, steps: int, lr: float, warmup: int = 20) -> float:
    if step < warmup:
        return lr * (step + 1) / warmup
    return lr * (0.03 + 0.97 * 0.5 * (1 + math.cos(math.pi * (step - warmup) / max(1, steps - warmup))))


def train(args: argparse.Namespace) -> None:
    torch.manual_seed(args.seed)
    torch.set_num_threads(args.threads)
    cv2.setNumThreads(1)
    out = Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    weights = Path(args.data) / "models" / f"yolov5{args.size}_coco_state.npz"
    net = CbamYolov5(args.size, attention=not args.no_attention)
    load_coco(net, str(weights))
    teacher = CbamYolov5(args.size, attention=False)
    load_coco(teacher, str(weights))
    teacher.eval().fuse()
    pictures = {s: data.load(Path(args.data), s, held_out=False) for s in data.SETS}
    for source in PEOPLE_UNLABELLED:
        print(f"{source}: {find_unlabelled_people(teacher, pictures[source], args.view)} unlabelled people", flush=True)
    (out / "run.json").write_text(json.dumps(
        {**vars(args), "pictures": {s: [p.name for p in v] for s, v in pictures.items()}}, indent=1, default=str))

    groups = parameter_groups(net, args.frozen, args.lr)
    optimiser = torch.optim.AdamW(groups, weight_decay=5e-4)
    average = Average(net, decay=0.997)
    first = 0
    checkpoint = out / "checkpoint.pt"
    if checkpoint.exists():
        held = torch.load(checkpoint, map_location="cpu")
        net.load_state_dict(held["net"])
        average.state = held["average"]
        optimiser.load_state_dict(held["optimiser"])
        first = held["step"]
        print(f"goes on from step {first}", flush=True)
    # The norms keep COCO's statistics: a small batch of four unlike sets would give worse ones.
    net.eval()
    coco = args.batch // 2
    sums: dict[str, float] = {}
    began = last_saved = time.monotonic()
    for step in range(first, args.steps):
        for group in optimiser.param_groups:
            group["lr"] = learning_rate(step, args.steps, args.lr) * group["share"]
        images, targets, ignore = to_tensors(draw_batch(pictures, args, step))
        with torch.no_grad():
            taught = teacher.raw(images[:coco])
        loss, parts = detection_loss(net.raw(images), targets, ignore, taught, coco)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_([p for g in groups for p in g["params"]], 10.0)
        optimiser.step()
        average.update(net, step)
        for key, value in parts.items():
            sums[key] = sums.get(key, 0.0) + value
        done = step + 1
        if done % 10 == 0:
            rate = (time.monotonic() - began) / (done - first)
            print(f"step {done}/{args.steps} " + " ".join(f"{k} {v / 10:.4f}" for k, v in sums.items())
                  + f" {rate:.2f} s/step", flush=True)
            sums = {}
        if time.monotonic() - last_saved > args.save_every_s or done == args.steps:
            save(checkpoint, step=done, net=net.state_dict(), average=average.state,
                 optimiser=optimiser.state_dict(), size=args.size, attention=not args.no_attention)
            last_saved = time.monotonic()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", required=True, help="folder with coco256, cats_topdown, aerial_cars, visdrone_mini, models")
    parser.add_argument("--out", required=True, help="folder for the checkpoint and run.json")
    parser.add_argument("--size", choices=("n", "s"), default="n")
    parser.add_argument("--no-attention", action="store_true", help="the same network without CBAM")
    parser.add_argument("--view", type=int, default=416, help="input size that objects are scaled for")
    parser.add_argument("--window", type=int, default=416, help="side of the window on that view that one step sees")
    parser.add_argument("--batch", type=int, default=8, help="a multiple of 4")
    parser.add_argument("--steps", type=int, default=2500)
    parser.add_argument("--lr", type=float, default=5e-4)
    parser.add_argument("--frozen", type=int, default=3, help="layers below this number keep their COCO weights")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--save-every-s", type=float, default=120)
    args = parser.parse_args()
    if args.window % 32 or args.batch < 4 or args.batch % 4:
        parser.error("--window must be a multiple of 32 and --batch a multiple of 4")
    train(args)


if __name__ == "__main__":
    main()
