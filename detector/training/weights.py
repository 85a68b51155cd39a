"""Where a network's numbers come from: YOLOv5's COCO arrays, YOLOX-Nano's published file, or one that export.py wrote."""
from __future__ import annotations

import numpy as np
import torch

from model import Cbam, CbamYolov5, ConvBnAct, CspStage, PathAggregation
from names import COCO_INDEX
from yolox import CbamYolox, Head, Heads

# Who consumes the output of an attended layer first; their weights take up the constant that the gates start around.
_ATTENTION_CONSUMERS = {4: ("5.conv", "17.cv1.conv", "17.cv2.conv"), 6: ("7.conv", "13.cv1.conv", "13.cv2.conv"),
                        9: ("10.conv",)}
_YOLOX_CONSUMERS = {4: ("5.0.conv", "17.cv1.conv", "17.cv2.conv"), 6: ("7.0.conv", "13.cv1.conv", "13.cv2.conv"), 9: ("10.conv",)}


@torch.no_grad()
def load_coco(net: CbamYolov5, npz_path: str) -> None:
    """Fills `net` from COCO arrays named as in YOLOv5 (80 classes). A net of six classes takes the six rows of the heads.

    Every array must find its place and every parameter but the attention's must be filled, or ValueError says which.
    """
    arrays = np.load(npz_path)
    state = {k: torch.from_numpy(arrays[k].astype(np.float32)) for k in arrays.files
             if not k.endswith(("num_batches_tracked", ".anchors"))}
    values = net.model[24].values
    if values != 85:
        if values != 5 + len(COCO_INDEX):
            raise ValueError(f"{npz_path}: a net of {values - 5} classes cannot start from COCO's heads")
        rows = torch.tensor([0, 1, 2, 3, 4] + [5 + i for i in COCO_INDEX])
        for key in [k for k in state if k.startswith("model.24.m.")]:
            state[key] = state[key].view(3, 85, *state[key].shape[1:])[:, rows].flatten(0, 1)
    for layer, consumers in _ATTENTION_CONSUMERS.items():
        if str(layer) not in net.cbam:
            continue
        for consumer in consumers:
            key = f"model.{consumer}.weight"
            weight = state[key].clone()
            # Layers 13 and 17 read the upsampled map first and the attended one second; the others only the attended one.
            start = weight.shape[1] // 2 if consumer.startswith(("13", "17")) else 0
            weight[:, start:] /= Cbam.start_gain()
            state[key] = weight
    missing, unexpected = net.load_state_dict(state, strict=False)
    missing = [k for k in missing if not k.startswith("cbam.") and not k.endswith("num_batches_tracked")]
    if missing or unexpected:
        raise ValueError(f"{npz_path}: missing {missing}, unexpected {unexpected}")


def _yolox_convolutions(net: CbamYolox) -> list[ConvBnAct | torch.nn.Conv2d]:
    """In the order in which the published graph computes them."""
    out: list[ConvBnAct | torch.nn.Conv2d] = []

    def add(module: torch.nn.Module) -> None:
        if isinstance(module, CspStage):
            parts: list[torch.nn.Module] = [module.cv1, module.cv2, module.m, module.cv3]
        elif isinstance(module, Head):
            parts = [module.stem, module.classes, module.class_out, module.boxes, module.box_out, module.object_out]
        elif isinstance(module, Heads):
            parts = list(module.m)
        elif isinstance(module, (ConvBnAct, torch.nn.Conv2d)):
            out.append(module)
            return
        else:
            parts = list(module.children())
        for part in parts:
            add(part)

    for layer in net.model:
        add(layer)
    return out


def _whole_pixels(blocks: torch.Tensor) -> torch.Tensor:
    """The first layer of YOLOX reads 2x2 blocks, as channels (top left, bottom left, top right, bottom right) x (blue, green,
    red) of 0 to 255: out x 12 x 3 x 3. The same as a layer that reads red, green, blue of 0 to 1: out x 3 x 6 x 6."""
    out = blocks.new_zeros(blocks.shape[0], 3, 6, 6)
    for block, (dy, dx) in enumerate(((0, 0), (1, 0), (0, 1), (1, 1))):
        out[:, :, dy::2, dx::2] = blocks[:, 3 * block:3 * block + 3].flip(1) * 255
    return out


@torch.no_grad()
def load_yolox(net: CbamYolox, path: str) -> None:
    """Fills `net` from the published ONNX file of YOLOX-Nano (80 classes, norms folded). A net of six classes takes the six rows
    of the heads. ValueError unless every convolution of the file finds its place."""
    import onnx
    from onnx import numpy_helper

    graph = onnx.load(path).graph
    arrays = {w.name: torch.from_numpy(numpy_helper.to_array(w).astype(np.float32)) for w in graph.initializer}
    theirs = [tuple(arrays[i] for i in n.input[1:]) for n in graph.node if n.op_type == "Conv"]
    ours = _yolox_convolutions(net)
    if len(theirs) != len(ours):
        raise ValueError(f"{path}: {len(theirs)} convolutions, YOLOX-Nano has {len(ours)}")
    kinds = {head.class_out for head in net.model[24].m}
    for number, (module, (weight, bias)) in enumerate(zip(ours, theirs)):
        if number == 0 and weight.shape[1:] == (12, 3, 3):
            weight = _whole_pixels(weight)
        if module in kinds and weight.shape[0] == 80:
            if module.out_channels == len(COCO_INDEX):
                weight, bias = weight[list(COCO_INDEX)], bias[list(COCO_INDEX)]
        conv = module.conv if isinstance(module, ConvBnAct) else module
        if weight.shape != conv.weight.shape:
            raise ValueError(f"{path}: convolution {number} is {tuple(weight.shape)}, must be {tuple(conv.weight.shape)}")
        conv.weight.copy_(weight)
        if isinstance(module, ConvBnAct):  # its norm was folded: one that changes nothing, and the bias
            module.bn.weight.fill_(1)
            module.bn.bias.copy_(bias)
            module.bn.running_mean.zero_()
            module.bn.running_var.fill_(1 - module.bn.eps)
        else:
            conv.bias.copy_(bias)
    for layer, consumers in _YOLOX_CONSUMERS.items():
        if str(layer) in net.cbam:
            for consumer in consumers:
                weight = net.get_submodule(f"model.{consumer}").weight
                start = weight.shape[1] // 2 if consumer.startswith(("13", "17")) else 0
                weight[:, start:] /= Cbam.start_gain()


@torch.no_grad()
def load_exported(path: str) -> PathAggregation:
    """The network of a file that export.py wrote: fused, in evaluation mode. Which one, its size and attention follow from its
    weights."""
    import onnx
    from onnx import numpy_helper

    state = {w.name: torch.from_numpy(numpy_helper.to_array(w).copy()) for w in onnx.load(path).graph.initializer
             if w.name.startswith(("model.", "cbam."))}
    for kind, size in ((CbamYolov5, "n"), (CbamYolov5, "s"), (CbamYolox, "nano")):
        net = kind(size, attention=any(k.startswith("cbam.") for k in state)).eval().fuse()
        own = net.state_dict()
        if all(k in own and own[k].shape == v.shape for k, v in state.items()) and len(state) == len(own):
            net.load_state_dict(state)
            return net
    raise ValueError(f"{path}: its weights are not those of a network that export.py wrote")
