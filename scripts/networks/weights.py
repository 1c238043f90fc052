"""Weights from files into modules."""

from pathlib import Path

import numpy as np
import torch

from . import Failure


def read_torch(path, unpickle=False):
    """The file's content: a PyTorch checkpoint, or arrays by name in an .npz."""
    if Path(path).suffix == ".npz":
        with np.load(path) as arrays:
            return {name: torch.from_numpy(arrays[name]) for name in arrays.files}
    try:
        return torch.load(path, map_location="cpu", weights_only=not unpickle)
    except Exception as error:
        first = str(error).strip().splitlines()[0].split(". ")[0]
        hint = "is it the file named in --help?" if unpickle else "if you trust its origin, --unpickle reads it as any pickle"
        raise Failure(f"{path}: not read as weights ({first}): {hint}") from error


def state_of(checkpoint):
    """The tensors by name, whatever they are wrapped in."""
    return checkpoint.get("state_dict", checkpoint)


def load_strictly(module, state, path):
    """Every parameter of the module from the file, and nothing else in it."""
    try:
        module.load_state_dict(state, strict=True)
    except RuntimeError as error:
        lines = [line.strip() for line in str(error).splitlines()]
        raise Failure(f"{path}: these are not this network's weights: {' '.join(lines[1:])[:300]}") from error
    return module
