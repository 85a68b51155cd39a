#!/usr/bin/env python3
"""Trains CBAM-YOLOv5 or CBAM-YOLOX on the sets of one data folder. Stops and goes on: run the same command again.

Every step draws its views from a generator seeded by (seed, step), so a run that was cut off and continued sees what an
unbroken one sees, and on the processor ends with the same weights to the bit. What the pictures that choose (split.py) like
best is kept beside the newest and is what export.py takes.
"""
from __future__ import annotations

import argparse
import json
import math
import signal
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import torch

import batches
import checkpoint
import choose
import data
import families
import methods
import render
from data import Picture
from model import PathAggregation
from network import Network

PEOPLE_UNLABELLED = ("aerial_cars", "cats_topdown")
WEIGHTS = "weights.pt"  # of a run that has ended, with what was chosen and no more
INTERRUPTED = 3  # exit code: stopped by a signal, the checkpoint is written
# Not part of what a run is: where, how fast, how often written.
ELSEWHERE = ("data", "out", "simulated", "device", "threads", "workers", "save_every_s")


def find_unlabelled_people(model: Path, pictures: list[Picture], threshold: float = 0.3) -> int:
    """Sets that label vehicles only still show people: where a network of COCO sees one, nothing is learnt."""
    network, found = Network(model), 0
    for p in pictures:
        boxes, scores = network.detect(p.image, threshold)
        boxes = boxes[scores[:, 0] > threshold].astype(np.float32)
        p.ignore = np.concatenate((p.ignore, boxes))
        found += len(boxes)
    return found


def parameter_groups(net: PathAggregation, frozen: int, lr: float, scratch: bool, attention_rate: float) -> list[dict]:
    """Heads learn at the full rate, the neck at a half, the backbone at a fifth, the first stages not; from scratch all of
    them at the full rate. Attention at a share of its own, and its weights are not drawn to zero."""
    groups: dict[tuple[float, float], list[torch.nn.Parameter]] = {}
    for name, parameter in net.named_parameters():
        if name.startswith("cbam."):
            share, decay = attention_rate, 0.0
        else:
            layer, decay = int(name.split(".")[1]), 5e-4
            if layer < frozen:
                parameter.requires_grad_(False)
                continue
            share = 1.0 if scratch or layer == 24 else 0.5 if layer >= 10 else 0.2
        groups.setdefault((share, decay), []).append(parameter)
    return [{"params": p, "lr": lr * share, "share": share, "weight_decay": decay} for (share, decay), p in groups.items()]


class Average:
    """Exponential moving average of every number of the network; the average is what is scored and exported."""

    def __init__(self, net: PathAggregation, decay: float = 0.997):
        self.decay, self.state = decay, {k: v.detach().clone() for k, v in net.state_dict().items()}

    @torch.no_grad()
    def update(self, net: PathAggregation, step: int) -> None:
        decay = min(self.decay, (1 + step) / (10 + step))
        for k, v in net.state_dict().items():
            if v.dtype.is_floating_point:
                self.state[k].lerp_(v, 1 - decay)
            else:
                self.state[k].copy_(v)


def learning_rate(step: int, steps: int, lr: float, warmup: int = 20) -> float:
    if step < warmup:
        return lr * (step + 1) / warmup
    return lr * (0.03 + 0.97 * 0.5 * (1 + math.cos(math.pi * (step - warmup) / max(1, steps - warmup))))


def load_pictures(args: argparse.Namespace) -> dict[str, list[Picture]]:
    root = Path(args.data)
    pictures = {s: data.load(root, s, "train", permissive=args.permissive) for s in data.sets_of(args.permissive)}
    if args.simulated:
        render.check_to_train_on(Path(args.simulated))
        pictures["simulated"] = data.load(Path(args.simulated), "simulated", "train")
    if args.people != "none":
        for source in (s for s in PEOPLE_UNLABELLED if s in pictures):
            found = find_unlabelled_people(root / "models" / args.people, pictures[source])
            print(f"{source}: {found} unlabelled people", flush=True)
    for source, of in pictures.items():
        if not of:
            raise ValueError(f"{source}: no pictures to train on")
    return pictures


class Run:
    """A network as it learns. State is what a checkpoint holds; all else follows from the options."""

    def __init__(self, args: argparse.Namespace, pictures: dict[str, list[Picture]]):
        self.args, self.device = args, torch.device(args.device)
        self.scratch = args.start == "scratch"
        self.net, self.teacher = self._make(not args.no_attention), None
        if not self.scratch:
            families.start(self.net, args.family, args.size, Path(args.data))
            self.teacher = self._make(False)
            families.start(self.teacher, args.family, args.size, Path(args.data))
            self.teacher.eval().fuse().to(self.device)
        self.net.to(self.device)
        method = methods.METHODS[args.method]
        if not self.scratch and self.net.cbam and method.gates_as_seen:
            self.net.eval().begin_attention(choose.gate_inputs(pictures).to(self.device))
        # From COCO the norms keep its statistics; from scratch there are none yet.
        self.net.train(self.scratch)
        self.groups = parameter_groups(self.net, 0 if self.scratch else args.frozen, args.lr, self.scratch, method.attention_rate)
        self.optimiser = torch.optim.AdamW(self.groups)
        self.average = Average(self.net)
        self.step, self.best, self.sums = 0, None, {}

    def _make(self, attention: bool) -> PathAggregation:
        return families.make(self.args.family, self.args.size, attention)

    def state(self) -> dict:
        return {"step": self.step, "net": self.net.state_dict(), "average": self.average.state, "best": self.best,
                "sums": self.sums, "optimiser": self.optimiser.state_dict(), "family": self.args.family, "size": self.args.size,
                "attention": not self.args.no_attention}

    def chosen(self) -> dict:
        """Of a run that ended, what an export needs: the chosen weights, without all that only learning on needs."""
        return {k: v for k, v in self.state().items() if k in ("step", "best", "family", "size", "attention")}

    def take(self, held: dict) -> None:
        self.net.load_state_dict(held["net"])
        self.average.state = {k: v.to(self.device) for k, v in held["average"].items()}
        self.optimiser.load_state_dict(held["optimiser"])
        self.step, self.best = held["step"], held["best"]
        self.sums = {k: v.to(self.device) for k, v in held["sums"].items()}

    def learn(self, images: torch.Tensor, plain: torch.Tensor, targets: torch.Tensor, ignore: torch.Tensor) -> None:
        """One step on what batches.to_tensors() gives. The teacher sees `plain`: grey and dark ones too are to be found as it
        finds them in their own colours, and it finds less in grey itself."""
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(self.step, self.args.steps, self.args.lr) * group["share"]
        images = images.to(self.device, non_blocking=True).float() / 255
        taught, coco = None, len(plain)
        if self.teacher is not None:
            with torch.no_grad():
                taught = self.teacher.raw(plain.to(self.device, non_blocking=True).float() / 255)
        loss, parts = families.LOSSES[self.args.family](self.net.raw(images), targets.to(self.device), ignore, taught, coco)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_([p for g in self.groups for p in g["params"]], 10.0)
        self.optimiser.step()
        self.average.update(self.net, self.step)
        for key, value in parts.items():
            self.sums[key] = self.sums.get(key, 0.0) + value
        self.step += 1

    def tell(self, seconds_a_step: float) -> None:
        print(f"step {self.step}/{self.args.steps} " + " ".join(f"{k} {float(v) / 10:.4f}" for k, v in self.sums.items())
              + f" {seconds_a_step:.2f} s/step", flush=True)
        self.sums = {}

    def score(self, pictures: dict[str, list[Picture]]) -> None:
        """Keeps the average if the pictures that choose find none better so far."""
        net = self._make(not self.args.no_attention)
        net.load_state_dict(self.average.state)
        net.to(self.device).eval()
        figures = choose.figures(net, pictures, self.args.view, self.device)
        spreads = choose.gate_spreads(net, pictures, self.device)
        mean = float(np.mean(list(figures.values())))
        print(f"step {self.step} chooses {mean:.4f} (" + ", ".join(f"{k} {v:.3f}" for k, v in figures.items())
              + f"); {choose.told(spreads)}", flush=True)
        if self.best is None or mean > self.best["score"]:
            self.best = {"step": self.step, "score": mean, "figures": figures, "gates": spreads,
                         "average": {k: v.detach().cpu().clone() for k, v in self.average.state.items()}}


def identity(args: argparse.Namespace) -> dict:
    """The options that a run is, without the data."""
    return {k: v for k, v in vars(args).items() if k not in ELSEWHERE} | {"with_simulated": bool(args.simulated)}


def train(args: argparse.Namespace) -> int:
    torch.manual_seed(args.seed)
    torch.set_num_threads(args.threads)
    cv2.setNumThreads(1)
    out = Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    if (out / WEIGHTS).exists():
        # Wherever it ran: another version of OpenCV decodes some pixels and finds some unlabelled people otherwise.
        checkpoint.load_own(out / WEIGHTS, identity(args), but=("pictures_sha256",))
        print(f"{out / WEIGHTS}: the weights of this run, which has ended; its pictures were not looked at again", flush=True)
        return 0
    pictures = load_pictures(args)
    choosing = choose.pictures_that_choose(Path(args.data), args.permissive)
    options = identity(args) | {"pictures_sha256": data.digest(pictures)}
    run, path = Run(args, pictures), out / "checkpoint.pt"
    if path.exists():
        run.take(checkpoint.load_own(path, options))
        print(f"goes on from step {run.step}", flush=True)
    (out / "run.json").write_text(json.dumps(
        {**vars(args), **options, "torch": torch.__version__,
         "pictures": {s: [p.name for p in v] for s, v in pictures.items()}}, indent=1, default=str))
    stop: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda n, _: stop.append(n))
    recipe = batches.Recipe(args.seed, args.batch, args.window, args.view, args.permissive, args.method)
    first, began = run.step, time.monotonic()
    last_saved = began
    for tensors in batches.steps(pictures, recipe, first, args.steps, args.workers):
        run.learn(*tensors)
        if run.step % 10 == 0:
            run.tell((time.monotonic() - began) / (run.step - first))
        if run.step % args.choose_every == 0 or run.step == args.steps:
            run.score(choosing)
        if stop or time.monotonic() - last_saved > args.save_every_s or run.step == args.steps:
            checkpoint.save(path, options=options, **run.state())
            last_saved = time.monotonic()
        if run.step == args.steps:
            checkpoint.save(out / WEIGHTS, options=options, **run.chosen())
        if stop and run.step < args.steps:
            print(f"stopped after step {run.step}; the same command goes on", flush=True)
            return INTERRUPTED
    return 0


def make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("--data", required=True, help="folder with coco256, cats_topdown, aerial_cars, visdrone_mini, models")
    parser.add_argument("--out", required=True, help="folder for the checkpoint and run.json")
    parser.add_argument("--simulated", help="a folder of render.py's, for a part of the views")
    parser.add_argument("--start", choices=("coco", "scratch"), default="coco",
                        help="from the COCO arrays, which also teach on COCO pictures, or from nothing")
    parser.add_argument("--people", default="yolox_nano_416.onnx",
                        help="file in DATA/models that finds the people whom the sets of vehicles do not label; none: nobody is")
    parser.add_argument("--family", choices=tuple(families.SIZES), default="yolov5")
    parser.add_argument("--size", help="n or s of yolov5, nano of yolox; not given: n and nano")
    parser.add_argument("--permissive", action="store_true", help="only pictures whose licences allow any use (data.PERMISSIVE)")
    parser.add_argument("--no-attention", action="store_true", help="the same network without CBAM")
    parser.add_argument("--view", type=int, default=416, help="input size that objects are scaled for")
    parser.add_argument("--window", type=int, default=416, help="side of the window on that view that one step sees")
    parser.add_argument("--batch", type=int, default=32, help="a multiple of 4; with --simulated of 8")
    parser.add_argument("--method", choices=tuple(methods.METHODS), default=methods.DEFAULT, help="methods.py")
    parser.add_argument("--steps", type=int, help="not given: the method's")
    parser.add_argument("--lr", type=float, default=5e-4)
    parser.add_argument("--frozen", type=int, default=3, help="layers below this number keep their COCO weights")
    parser.add_argument("--choose-every", type=int, default=1000, help="steps from one look at the pictures that choose to the next")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu", help="cpu, cuda, cuda:1 ..")
    parser.add_argument("--threads", type=int, default=1, help="of PyTorch, on the processor")
    parser.add_argument("--workers", type=int, default=0, help="processes that draw the views; 0: the training itself")
    parser.add_argument("--save-every-s", type=float, default=120)
    return parser


def parse(words: list[str] | None = None) -> argparse.Namespace:
    parser = make_parser()
    args = parser.parse_args(words)
    method = methods.METHODS[args.method]
    args.steps = method.steps if args.steps is None else args.steps
    if args.window % 32 or args.view % 32 or args.steps < 1 or args.choose_every < 1:
        parser.error("--window and --view must be multiples of 32, --steps and --choose-every at least 1")
    sizes = families.SIZES[args.family]
    args.size = args.size or sizes[0]
    if args.size not in sizes:
        parser.error(f"--size: {args.family} has {' and '.join(sizes)}")
    try:
        data.sources_of_step(0, args.batch, method.rendered_eighths if args.simulated else 0, args.permissive)
    except ValueError as e:
        parser.error(f"--batch: {e}")
    return args


if __name__ == "__main__":
    try:
        sys.exit(train(parse()))
    except (ValueError, OSError) as e:
        sys.exit(f"train.py: {e}")
