"""A data folder as small as can be: every set in every part, things drawn as rectangles, and COCO arrays of chance."""
import cv2
import numpy as np


def _write(folder, stems, label, rng):
    for sub in ('images', 'labels'):
        (folder[0] / sub / folder[1]).mkdir(parents=True, exist_ok=True)
    for stem in stems:
        image = rng.integers(60, 120, (48, 64, 3), dtype=np.uint8)
        x, y, w, h = (int(rng.integers(a, b)) for a, b in ((2, 30), (2, 16), (12, 30), (14, 28)))
        image[y:y + h, x:x + w] = rng.integers(150, 255, 3)
        cv2.imwrite(str(folder[0] / 'images' / folder[1] / f'{stem}.jpg'), image)
        (folder[0] / 'labels' / folder[1] / f'{stem}.txt').write_text(
            f'{label} {(x + w / 2) / 64} {(y + h / 2) / 48} {w / 64} {h / 48}\n')


def make(root, seed=0):
    rng = np.random.default_rng(seed)
    _write((root / 'coco256', 'train2017'), [f'{i:012}' for i in range(1, 17)], 0, rng)
    _write((root / 'coco256', 'val2017'), [f'{i:012}' for i in range(101, 104)], 2, rng)
    _write((root / 'cats_topdown', ''), [f'{f}_{i}' for f in (0, 5) for i in range(1, 13)], 0, rng)
    _write((root / 'aerial_cars', ''), [f'{f}{i}' for f in ('MOS', 'MunichStreet02-MOS') for i in range(1, 13)], 0, rng)
    _write((root / 'visdrone_mini', ''), [f'v{i}' for i in range(12)], 3, rng)
    (root / 'visdrone_mini' / 'train.list').write_text('\n'.join(f'v{i}' for i in range(8)))
    (root / 'visdrone_mini' / 'val.list').write_text('\n'.join(f'v{i}' for i in range(8, 12)))


def make_coco_arrays(root):
    """models/yolov5n_coco_state.npz with weights of chance. Needs PyTorch."""
    import torch
    from model import CbamYolov5

    torch.manual_seed(5)
    state = CbamYolov5('n', classes=80, attention=False).state_dict()
    for key, value in state.items():
        if key.endswith('running_var'):
            value.uniform_(0.5, 1.5)
        elif key.endswith('running_mean'):
            value.normal_(0, 0.1)
    (root / 'models').mkdir(exist_ok=True)
    np.savez(root / 'models' / 'yolov5n_coco_state.npz', **{k: v.numpy() for k, v in state.items()})


def make_yolox(root):
    """models/yolox_nano_416.onnx with weights of chance: the convolutions of the published file in its order, of which the
    first reads 2x2 blocks of pixels as 12 channels, and nothing between them. Needs PyTorch and onnx. Returns its path."""
    import onnx
    import onnx.numpy_helper
    import torch
    import weights
    from yolox import CbamYolox

    torch.manual_seed(6)
    nodes, held = [], []
    for i, module in enumerate(weights._yolox_convolutions(CbamYolox(classes=80, attention=False))):
        conv = getattr(module, 'conv', module)
        shape = (16, 12, 3, 3) if i == 0 else conv.weight.shape
        weight = torch.randn(shape) / float(np.prod(shape[1:])) ** 0.5 / (255 if i == 0 else 1)
        for name, value in ((f'w{i}', weight), (f'b{i}', 0.1 * torch.randn(shape[0]))):
            held.append(onnx.numpy_helper.from_array(value.numpy(), name))
        nodes.append(onnx.helper.make_node('Conv', [f'x{i}', f'w{i}', f'b{i}'], [f'x{i + 1}']))
    (root / 'models').mkdir(exist_ok=True)
    path = root / 'models' / 'yolox_nano_416.onnx'
    onnx.save(onnx.helper.make_model(onnx.helper.make_graph(nodes, 'yolox', [], [], held)), str(path))
    return path
