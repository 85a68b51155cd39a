"""Names and numbers that every part of the training side shares. Needs no PyTorch, so that evaluating does not either."""
CLASSES = ("person", "bicycle", "car", "motorcycle", "bus", "truck")
COCO_INDEX = (0, 1, 2, 3, 5, 7)  # the same six in COCO's list of 80
STRIDES = (8, 16, 32)
