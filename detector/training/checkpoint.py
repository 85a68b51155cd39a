"""A run's state on disc: written whole or not at all, and gone on with only by the run that it is of."""
from __future__ import annotations

import json
import os
from pathlib import Path

import torch

FORMAT = 3


class OtherRun(ValueError):
    """The file is of a run with other options."""


def _pack(value, tensors: list[torch.Tensor]):
    """`value` as JSON has it, its tensors moved into the list: PyTorch 1.13 reads back safely what holds no plain numbers.
    Keys keep their type."""
    if isinstance(value, torch.Tensor):
        tensors.append(value)
        return {"tensor": len(tensors) - 1}
    if isinstance(value, dict):
        return {"pairs": [[k, _pack(v, tensors)] for k, v in value.items()]}
    if isinstance(value, (list, tuple)):
        return [_pack(v, tensors) for v in value]
    return value


def _unpack(value, tensors: list[torch.Tensor]):
    if isinstance(value, dict):
        return tensors[value["tensor"]] if "tensor" in value else {k: _unpack(v, tensors) for k, v in value["pairs"]}
    return [_unpack(v, tensors) for v in value] if isinstance(value, list) else value


def save(path: Path, **content) -> None:
    """A run that is killed while writing, or a machine that loses its power, leaves the previous file or this one."""
    tensors: list[torch.Tensor] = []
    text = json.dumps(_pack(content, tensors))
    part = path.with_suffix(".part")
    with open(part, "wb") as file:
        torch.save({"format": FORMAT, "text": text, "tensors": tensors}, file)
        file.flush()
        os.fsync(file.fileno())
    os.replace(part, path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def load(path: Path) -> dict:
    held = torch.load(path, map_location="cpu", weights_only=True)
    if held.get("format") != FORMAT:
        raise ValueError(f"{path}: not a checkpoint of this train.py")
    return _unpack(json.loads(held["text"]), held["tensors"])


def load_own(path: Path, options: dict, but: tuple[str, ...] = ()) -> dict:
    """OtherRun, which names what differs, unless the file was written with these options, all `but` some."""
    held = load(path)
    theirs = {k: v for k, v in held["options"].items() if k not in but}
    if theirs != options:
        differ = [f"{k} {theirs.get(k)!r} there, {options.get(k)!r} here" for k in sorted(theirs.keys() | options.keys())
                  if theirs.get(k) != options.get(k)]
        raise OtherRun(f"{path} is of a run with other options ({'; '.join(differ)}); give it another folder")
    return held
