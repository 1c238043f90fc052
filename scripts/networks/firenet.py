"""FireNet: events to video by a small recurrent network at full resolution.

Scheerlinck, Rebecq, Gehrig, Barnes, Mahony, Scaramuzza: Fast Image Reconstruction with an Event Camera, WACV 2020,
section 3.1; parameter names as published at https://github.com/ercanburak/EVREAL.
"""

import torch
from torch import nn

import model_registry

from .e2vid import Residual, Step
from .layers import multiple_of
from .weights import load_strictly, state_of

BINS, BASE, MULTIPLE = 5, 16, 8


class Gru(nn.Module):
    """Convolutional GRU: h' = h(1−u) + u·tanh(conv[x, r·h]), u = σ(conv[x, h]), r = σ(conv[x, h])."""

    def __init__(self, channels):
        super().__init__()
        self.reset_gate = nn.Conv2d(2 * channels, channels, 3, padding=1)
        self.update_gate = nn.Conv2d(2 * channels, channels, 3, padding=1)
        self.out_gate = nn.Conv2d(2 * channels, channels, 3, padding=1)

    def forward(self, x, hidden):
        both = torch.cat([x, hidden], 1)
        update, reset = torch.sigmoid(self.update_gate(both)), torch.sigmoid(self.reset_gate(both))
        candidate = torch.tanh(self.out_gate(torch.cat([x, hidden * reset], 1)))
        return hidden * (1 - update) + candidate * update


class FireNet(nn.Module):
    """(voxel, state0, state1) → (image, the new states). The image is not clamped to 0…1."""

    def __init__(self):
        super().__init__()
        self.head = Step(BINS, BASE, 3)
        self.G1, self.R1 = Gru(BASE), Residual(BASE)
        self.G2, self.R2 = Gru(BASE), Residual(BASE)
        self.pred = Step(BASE, 1, 1, relu=False)

    def forward(self, voxel, state0, state1):
        state0 = self.G1(self.head(voxel), state0)
        state1 = self.G2(self.R1(state0), state1)
        return self.pred(self.R2(state1)), state0, state1


def build(options, checkpoint):
    module = FireNet()
    if checkpoint is not None:
        load_strictly(module, state_of(checkpoint), options.weights)
    height, width = (multiple_of(MULTIPLE, length) for length in options.size)
    module.inputs = {"voxel": (1, BINS, height, width)}
    module.inputs |= {f"state{i}": (1, BASE, height, width) for i in range(2)}
    module.outputs = ["image", "state0_out", "state1_out"]
    return module


def entry(options, module, licence, source):
    return model_registry.reconstruction(multiple=MULTIPLE, states=["state0", "state1"], licence=licence, source=source)
