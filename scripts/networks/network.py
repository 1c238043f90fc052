"""What export_models.py must know of a network."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch


class Failure(Exception):
    """One line for the user: what was wrong, with which input, what to do."""


@dataclass(frozen=True)
class Network:
    name: str
    about: str
    # (height, width) of the frames, unless --size says otherwise.
    size: tuple[int, int]
    # Where the authors' weights are, under which licence, and their SHA-256 where it is known.
    url: str
    licence: str
    sha256: str | None
    # (options, checkpoint or None) → module with `inputs`: name → shape at options.size and batch 1, and `outputs`: names.
    # Where the checkpoint is None the weights are left as initialised.
    build: Callable
    # (options, module, licence, source) → the registry's entry.
    entry: Callable
    # (file) → checkpoint.
    read: Callable = None
    # (cache folder) → the weights' file, where a Python package carries it.
    packaged: Callable = None

    def checkpoint(self, options):
        return (self.read or read_torch)(options.weights, options.unpickle)


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


def multiple_of(step, length):
    """The next multiple of `step`, upwards."""
    return -(-length // step) * step


def note(text):
    print(text, file=sys.stderr)
