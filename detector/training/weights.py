"""Where a network's numbers come from: the COCO arrays, or a file that export.py wrote."""
from __future__ import annotations

import numpy as np
import torch

from model import Cbam, CbamYolov5
from names import COCO_INDEX

# Who consumes the output of an attended layer first; their weights take up the constant that the gates start around.
_ATTENTION_CONSUMERS = {4: ("5.conv", "17.cv1.conv", "17.cv2.conv"), 6: ("7.conv", "13.cv1.conv", "13.cv2.conv"),
                        9: ("10.conv",)}


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


@torch.no_grad()
def load_exported(path: str) -> CbamYolov5:
    """The network of a file that export.py wrote: fused, in evaluation mode. Size and attention follow from its weights."""
    import onnx
    from onnx import numpy_helper

    state = {w.name: torch.from_numpy(numpy_helper.to_array(w).copy()) for w in onnx.load(path).graph.initializer
             if w.name.startswith(("model.", "cbam."))}
    for size in ("n", "s"):
        net = CbamYolov5(size, attention=any(k.startswith("cbam.") for k in state)).eval().fuse()
        own = net.state_dict()
        if all(k in own and own[k].shape == v.shape for k, v in state.items()) and len(state) == len(own):
            net.load_state_dict(state)
            return net
    raise ValueError(f"{path}: its weights are not those of a network that export.py wrote")
