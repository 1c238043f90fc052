"""MixVPR: ResNet-50 to its third stage, four feature mixers, two projections.

Ali-bey, Chaib-draa, Giguère: MixVPR, WACV 2023, https://arxiv.org/abs/2303.02190, section 3; parameter names as published at
https://github.com/amaralibey/MixVPR. Frames are resized to 320×320 in the network, as in
https://github.com/gmberton/VPR-methods-evaluation.
"""

import torchvision
from torch import nn
from torch.nn import functional as F

import model_registry

from .layers import Resize, extractor_io
from .weights import load_strictly, state_of

SIDE, CELLS, CHANNELS, ROWS, DEPTH = 320, 400, 1024, 4, 4


class Mixer(nn.Module):
    def __init__(self):
        super().__init__()
        self.mix = nn.Sequential(nn.LayerNorm(CELLS), nn.Linear(CELLS, CELLS), nn.ReLU(), nn.Linear(CELLS, CELLS))

    def forward(self, x):
        return x + self.mix(x)


class Aggregator(nn.Module):
    def __init__(self):
        super().__init__()
        self.mix = nn.Sequential(*(Mixer() for _ in range(DEPTH)))
        self.channel_proj = nn.Linear(CHANNELS, CHANNELS)
        self.row_proj = nn.Linear(CELLS, ROWS)

    def forward(self, x):
        x = self.mix(x.flatten(2)).transpose(1, 2)
        x = self.row_proj(self.channel_proj(x).transpose(1, 2))
        return F.normalize(x.flatten(1), dim=1)


class Backbone(nn.Module):
    def __init__(self):
        super().__init__()
        self.model = torchvision.models.resnet50()
        self.model.layer4 = self.model.avgpool = self.model.fc = None

    def forward(self, x):
        net = self.model
        x = net.maxpool(net.relu(net.bn1(net.conv1(x))))
        return net.layer3(net.layer2(net.layer1(x)))


class MixVpr(nn.Module):
    def __init__(self, size):
        super().__init__()
        self.resize = nn.Identity() if size == (SIDE, SIDE) else Resize(size, (SIDE, SIDE))
        self.backbone = Backbone()
        self.aggregator = Aggregator()

    def forward(self, image):
        return self.aggregator(self.backbone(self.resize(image)))


def build(options, checkpoint):
    size = (SIDE, SIDE) if options.resize_outside else options.size
    module = MixVpr(size)
    if checkpoint is not None:
        load_strictly(module, state_of(checkpoint), options.weights)
    return extractor_io(module, size)


def entry(options, module, licence, source):
    outside = {"input": f"{SIDE}x{SIDE}", "resize": "antialiased_bilinear"} if options.resize_outside else {}
    return model_registry.extractor(dimension=CHANNELS * ROWS, licence=licence, source=source, **outside)
