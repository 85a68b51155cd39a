#!/usr/bin/env python3
"""Writes a trained network as ONNX (opset 12, static shapes, norms folded) with its metadata, for OpenCV's DNN module.

  export.py --checkpoint RUN/weights.pt [RUN2/weights.pt ..] --out DIR [--input 416 320 480x352]
  export.py --weights MODEL.onnx [MODEL2.onnx ..] --out DIR --input 480x352
  export.py --yolox DATA/models/yolox_nano_416.onnx --out DIR [--input 416 320]

From a run: the weights that its choosing pictures liked best, or with --newest the newest average; from several the mean of
theirs (soup.py). --weights: those of a file that this program wrote, for another input; of several files the mean, each as
often as it is named. Of a mean, with --data and --simulated, each channel is given the statistics that it had in its parents.
--yolox: YOLOX-Nano as it was published, with its heads cut to godwit's six classes and made for the input that godwit gives
(red, green, blue of 0 to 1), without CBAM.
"""
from __future__ import annotations

import argparse
import hashlib
import inspect
import struct
import sys
from pathlib import Path

import numpy as np
import onnx
import torch

import checkpoint
import choose
import families
import render
import soup
from model import PathAggregation
from names import CLASSES
from weights import load_exported, load_yolox
from yolox import CbamYolox


def parse_input(text: str) -> tuple[int, int]:
    """"416" is a square, "480x352" width and height."""
    sides = text.split("x")
    if len(sides) not in (1, 2) or not all(s.isdecimal() and int(s) % 32 == 0 and 32 <= int(s) <= 2048 for s in sides):
        raise argparse.ArgumentTypeError(f"{text}: must be SIDE or WIDTHxHEIGHT, multiples of 32 from 32 to 2048")
    return int(sides[0]), int(sides[-1])


def input_name(width: int, height: int) -> str:
    return str(width) if width == height else f"{width}x{height}"


def export_onnx(net: PathAggregation, width: int, height: int, path: Path) -> None:
    """`net` must be fused and in evaluation mode. Input 1x3xHEIGHTxWIDTH RGB 0..1; output 1xNx(5 + classes) in
    the net's layout (detector/model_info.h)."""
    # Newer versions write another graph unless told not to.
    old_way = {"dynamo": False} if "dynamo" in inspect.signature(torch.onnx.export).parameters else {}
    torch.onnx.export(net, torch.zeros(1, 3, height, width), str(path), opset_version=12, input_names=["images"],
                      output_names=["output"], do_constant_folding=True, **old_way)
    _copy_shared(path)


def _copy_shared(path: Path) -> None:
    """The exporter shares equal initialisers through Identity nodes without an input, which OpenCV 4.6 cannot read: each
    gets its own under its own name, which weights.load_exported() looks for."""
    model = onnx.load(str(path))
    weights = {w.name: w for w in model.graph.initializer}
    kept = []
    for node in model.graph.node:
        if node.op_type == "Identity" and node.input[0] in weights:
            own = onnx.TensorProto()
            own.CopyFrom(weights[node.input[0]])
            own.name = node.output[0]
            model.graph.initializer.append(own)
        else:
            kept.append(node)
    del model.graph.node[:]
    model.graph.node.extend(kept)
    onnx.checker.check_model(model)
    onnx.save(model, str(path))


def write_metadata(model: Path, width: int, height: int, layout: str = "yolov5") -> None:
    """The TOML file that detector/model_info.h reads, beside the model."""
    quoted = ", ".join(f'"{c}"' for c in CLASSES)
    model.with_suffix(".toml").write_text(f"""# Written by detector/training/export.py beside the model of the same name.
layout = "{layout}"
input_width = {width}
input_height = {height}
channel_order = "rgb"
scale = 0.00392156862745098
letterbox = "centre"
fill = 114
classes = [{quoted}]
movable = [{quoted}]
sha256 = "{hashlib.sha256(model.read_bytes()).hexdigest()}"
""")


def reference_picture(width: int, height: int) -> np.ndarray:
    """1 x 3 x height x width, every pixel from its place, so that the test in C++ makes the same without a file."""
    y, x = np.mgrid[:height, :width]
    planes = [((x * 7 + y * 13 + c * 29 + (x * y) // 16) & 255).astype(np.float32) / np.float32(255) for c in range(3)]
    return np.stack(planes)[None]


@torch.no_grad()
def write_reference(net: PathAggregation, width: int, height: int, path: Path, every: int = 37) -> None:
    """What PyTorch says to reference_picture: rows, values a row, stride (int32), then every `every`th row (float32)."""
    y = net(torch.from_numpy(reference_picture(width, height)))[0].numpy()
    path.write_bytes(struct.pack("<3i", y.shape[0], y.shape[1], every) + y[::every].astype("<f4").tobytes())


def network_of_run(path: Path, newest: bool) -> tuple[PathAggregation, str, dict]:
    """The network of a run, in evaluation mode; what to say of it; the spread of its gates as measured in training."""
    held = checkpoint.load(path)
    best = held["best"]
    if newest and "average" not in held:
        raise ValueError(f"{path}: holds what was chosen alone; --newest takes checkpoint.pt")
    if not newest and best is None:
        raise ValueError(f"{path}: nothing was chosen yet; --newest takes the newest")
    net = families.make(held["family"], held["size"], held["attention"])
    net.load_state_dict(held["average"] if newest else best["average"])
    step = held["step"] if newest else best["step"]
    return net.eval(), f"step {step} of {held['options']['steps']}", {} if newest else best["gates"]


def network_of_runs(paths: list[Path], newest: bool) -> tuple[PathAggregation, str, dict]:
    """As network_of_run(), of several the mean. ValueError unless they are alike and began alike: from nothing another seed
    draws another network, and the mean of two that never were one is neither."""
    net, what, gates = network_of_run(paths[0], newest)
    if len(paths) == 1:
        return net, what, gates
    held = [checkpoint.load(p) for p in paths]
    for path, other in zip(paths[1:], held[1:]):
        differ = [k for k in ("family", "size", "attention") if other[k] != held[0][k]]
        begun = ("start", "seed") if held[0]["options"]["start"] == "scratch" else ("start",)
        differ += [k for k in begun if other["options"][k] != held[0]["options"][k]]
        if differ:
            raise ValueError(f"{path}: differs from {paths[0]} in {differ[0]}: no mean of these")
    net.load_state_dict(soup.mean_of([network_of_run(p, newest)[0] for p in paths]))
    return net.eval(), f"mean of {len(paths)} runs", {}


def network_of_files(paths: list[Path]) -> PathAggregation:
    """The network of a file of this program's; of several the mean. ValueError unless they are alike."""
    nets = [load_exported(str(p)) for p in paths]
    for path, other in zip(paths[1:], nets[1:]):
        if (type(other), other.name()) != (type(nets[0]), nets[0].name()):
            raise ValueError(f"{path}: {other.name()}, and {paths[0]} is {nets[0].name()}: no mean of these")
    nets[0].load_state_dict(soup.mean_of(nets))
    return nets[0]


def repaired(net: PathAggregation, parents: list[PathAggregation], root: Path, simulated: Path) -> PathAggregation:
    render.check_to_train_on(simulated)
    soup.repair(net.fuse(), [p.fuse() for p in parents], soup.looks(root, simulated))
    return net


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--checkpoint", type=Path, nargs="+", help="weights.pt, or checkpoint.pt, of train.py; of several the mean")
    source.add_argument("--weights", type=Path, nargs="+", help="a file that this program wrote; of several the mean")
    source.add_argument("--yolox", type=Path, help="the published file of YOLOX-Nano")
    parser.add_argument("--newest", action="store_true", help="of --checkpoint: not what was chosen but the newest average")
    parser.add_argument("--out", required=True, type=Path, help="folder for NAME_INPUT.onnx and NAME_INPUT.toml")
    parser.add_argument("--reference", type=Path, help="folder for NAME_INPUT.reference, PyTorch's output for the tests")
    parser.add_argument("--input", type=parse_input, nargs="+", default=[(416, 416), (320, 320), (480, 352)],
                        metavar="SIDE|WIDTHxHEIGHT")
    parser.add_argument("--data", type=Path, help="folder of the sets: measures the spread of the gates anew")
    parser.add_argument("--simulated", type=Path, help="a folder of render.py's, with --data: sets the statistics of a mean")
    args = parser.parse_args()
    parents = len(args.checkpoint or args.weights or [])
    if args.simulated and (not args.data or parents < 2):
        parser.error("--simulated is for a mean of several, with --data")
    if args.checkpoint:
        net, what, gates = network_of_runs(args.checkpoint, args.newest)
    elif args.yolox:
        net, what, gates = CbamYolox(attention=False), "as published", {}
        load_yolox(net, str(args.yolox))
        net.eval()
    else:
        what = f"weights of {args.weights[0].name}" if parents == 1 else f"mean of {parents} files"
        net, gates = network_of_files(args.weights), {}
    if args.simulated:
        nets = [network_of_run(p, args.newest)[0] for p in args.checkpoint] if args.checkpoint \
            else [load_exported(str(p)) for p in args.weights]
        net = repaired(net, nets, args.data, args.simulated)
    if args.data:
        gates = choose.gate_spreads(net, choose.pictures_that_choose(args.data), torch.device("cpu"))
    args.out.mkdir(parents=True, exist_ok=True)
    if args.reference:  # from the network as it was trained, before anything is folded
        args.reference.mkdir(parents=True, exist_ok=True)
        for width, height in args.input:
            write_reference(net, width, height, args.reference / f"{net.name()}_{input_name(width, height)}.reference")
    net.fuse()
    for width, height in args.input:
        path = args.out / f"{net.name()}_{input_name(width, height)}.onnx"
        export_onnx(net, width, height, path)
        write_metadata(path, width, height, net.layout)
        print(f"{path}: {path.stat().st_size} bytes, {what}")
    if net.cbam:
        print(choose.told(gates) if gates else "spread of the gates: not measured, give --data")


if __name__ == "__main__":
    try:
        main()
    except (ValueError, OSError) as e:
        sys.exit(f"export.py: {e}")
