"""Layers that several networks share."""

import torch
from torch import nn
from torch.nn import functional as F


class GeM(nn.Module):
    """Generalised mean over the whole map: (mean of max(x, 1e-6)^p)^(1/p). https://arxiv.org/abs/1711.02512, equation 3."""

    def __init__(self, p=3.0):
        super().__init__()
        self.p = nn.Parameter(torch.full((1,), p))

    def forward(self, x):
        return x.clamp(min=1e-6).pow(self.p).mean(dim=(-2, -1), keepdim=True).pow(1 / self.p)


class L2Norm(nn.Module):
    """Divides by the Euclidean norm over the channels."""

    def forward(self, x):
        return F.normalize(x, dim=1)


class Resize(nn.Module):
    """Antialiased bilinear resize from one fixed size to another, as two matrix products.

    The matrices are torch's own resize of the identity, so they hold torch's weights exactly, whatever a runtime's Resize
    does at the border.
    """

    def __init__(self, source, target):
        super().__init__()
        self.register_buffer("rows", self.weights(source[0], target[0]), persistent=False)
        self.register_buffer("columns", self.weights(source[1], target[1]).T.contiguous(), persistent=False)

    @staticmethod
    def weights(source, target):
        identity = torch.eye(source)[None, None]
        return F.interpolate(identity, size=(target, source), mode="bilinear", antialias=True, align_corners=False)[0, 0]

    def forward(self, x):
        return self.rows @ (x @ self.columns)


def extractor_io(module, size):
    """Names the input and output of an extractor for frames of (height, width)."""
    module.inputs = {"image": (1, 3, *size)}
    module.outputs = ["descriptor"]
    return module


def multiple_of(step, length):
    """The next multiple of `step`, upwards."""
    return -(-length // step) * step
