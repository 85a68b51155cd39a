"""A network of PyTorch against the file that was made of it, as OpenCV runs it: for the tests of both families."""
import cv2
import numpy as np
import torch


def worst_difference(net, file, images):
    """Scores against 1, boxes (pixels of the input) against their own size. images: (height, width, 3), uint8, of the file's
    input. Raises ValueError where the outputs' shapes differ."""
    read, worst = cv2.dnn.readNetFromONNX(str(file)), 0.0
    for image in images:
        blob = np.ascontiguousarray(image.transpose(2, 0, 1)[None], np.float32) / 255
        read.setInput(blob)
        with torch.no_grad():
            expected = net(torch.from_numpy(blob)).numpy()
        found = read.forward()
        if found.shape != expected.shape:
            raise ValueError(f'{file}: {found.shape} through OpenCV, {expected.shape} of the network')
        worst = max(worst, float((np.abs(found - expected) / np.maximum(1, np.abs(expected))).max()))
    return worst
