#!/usr/bin/env python3
"""Writes a trained network as ONNX (opset 12, static shapes, norms folded) with its metadata, for OpenCV's DNN module."""
from __future__ import annotations

import argparse
import hashlib
import struct
from pathlib import Path

import numpy as np
import onnx
import torch

from model import CbamYolov5, load_coco
from names import CLASSES


def export_onnx(net: CbamYolov5, size: int, path: Path) -> None:
    """`net` must be fused and in evaluation mode. Input 1x3xSIZExSIZE RGB 0..1; output 1xNx(5 + classes)."""
    torch.onnx.export(net, torch.zeros(1, 3, size, size), str(path), opset_version=12, input_names=["images"],
                      output_names=["output"], do_constant_folding=True)
    _inline_identities(path)


def _inline_identities(path: Path) -> None:
    """The exporter shares equal initialisers through Identity nodes without an input, which OpenCV 4.6 cannot read."""
    model = onnx.load(str(path))
    weights = {w.name for w in model.graph.initializer}
    alias = {n.output[0]: n.input[0] for n in model.graph.node if n.op_type == "Identity" and n.input[0] in weights}
    kept = [n for n in model.graph.node if n.output[0] not in alias]
    for node in kept:
        for i, name in enumerate(node.input):
            node.input[i] = alias.get(name, name)
    del model.graph.node[:]
    model.graph.node.extend(kept)
    onnx.checker.check_model(model)
    onnx.save(model, str(path))


def write_metadata(model: Path, size: int) -> None:
    """The TOML file that detector/model_info.h reads, beside the model."""
    quoted = ", ".join(f'"{c}"' for c in CLASSES)
    model.with_suffix(".toml").write_text(f"""# Written by detector/training/export.py beside the model of the same name.
layout = "yolov5"
input_width = {size}
input_height = {size}
channel_order = "rgb"
scale = 0.00392156862745098
letterbox = "centre"
fill = 114
classes = [{quoted}]
movable = [{quoted}]
sha256 = "{hashlib.sha256(model.read_bytes()).hexdigest()}"
""")


def reference_picture(size: int) -> np.ndarray:
    """1 x 3 x size x size, every pixel from its place, so that the test in C++ makes the same without a file."""
    y, x = np.mgrid[:size, :size]
    planes = [((x * 7 + y * 13 + c * 29 + (x * y) // 16) & 255).astype(np.float32) / np.float32(255) for c in range(3)]
    return np.stack(planes)[None]


@torch.no_grad()
def write_reference(net: CbamYolov5, size: int, path: Path, every: int = 37) -> None:
    """What PyTorch says to reference_picture: rows, values a row, stride (int32), then every `every`th row (float32)."""
    y = net(torch.from_numpy(reference_picture(size)))[0].numpy()
    path.write_bytes(struct.pack("<3i", y.shape[0], y.shape[1], every) + y[::every].astype("<f4").tobytes())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--checkpoint", required=True, type=Path, help="checkpoint.pt of train.py; the average is exported")
    parser.add_argument("--out", required=True, type=Path, help="folder for NAME_SIZE.onnx and NAME_SIZE.toml")
    parser.add_argument("--reference", type=Path, help="folder for NAME_SIZE.reference, PyTorch's output for the tests")
    parser.add_argument("--sizes", type=int, nargs="+", default=[416, 320])
    parser.add_argument("--blend", type=float, default=1.0,
                        help="weight of the trained network against the COCO weights it started from (Wortsman et al., "
                        "Robust fine-tuning of zero-shot models, 2022): below 1 keeps more of what COCO taught")
    parser.add_argument("--coco", type=Path, help="the COCO arrays, for --blend")
    args = parser.parse_args()
    if not 0 < args.blend <= 1 or (args.blend < 1 and args.coco is None):
        parser.error("--blend must be above 0 and at most 1, and below 1 needs --coco")
    held = torch.load(args.checkpoint, map_location="cpu")
    net = CbamYolov5(held["size"], attention=held["attention"])
    if args.blend < 1:
        load_coco(net, str(args.coco))
        start = net.state_dict()
        held["average"] = {k: start[k].lerp(v, args.blend) if v.dtype.is_floating_point else v
                           for k, v in held["average"].items()}
    net.load_state_dict(held["average"])
    net.eval()
    if args.reference:  # from the network as it was trained, before anything is folded
        for size in args.sizes:
            write_reference(net, size, args.reference / f"{name(held)}_{size}.reference")
    net.fuse()
    for size in args.sizes:
        path = args.out / f"{name(held)}_{size}.onnx"
        export_onnx(net, size, path)
        write_metadata(path, size)
        print(f"{path}: {path.stat().st_size} bytes, after {held['step']} steps")


def name(held: dict) -> str:
    return ("cbam_" if held["attention"] else "") + f"yolov5{held['size']}"


if __name__ == "__main__":
    main()
