"""CosPlace: ResNet-50, generalised-mean pooling, one linear layer.

Berton, Masone, Caputo: Rethinking Visual Geo-localization for Large-Scale Applications, CVPR 2022,
https://arxiv.org/abs/2204.02287; parameter names as published at https://github.com/gmberton/CosPlace.
"""

import torchvision
from torch import nn

import model_registry

from .layers import GeM, L2Norm, extractor_io
from .weights import load_strictly, state_of

DIMENSION = 2048


class CosPlace(nn.Module):
    def __init__(self):
        super().__init__()
        self.backbone = nn.Sequential(*list(torchvision.models.resnet50().children())[:-2])
        self.aggregation = nn.Sequential(L2Norm(), GeM(), nn.Flatten(), nn.Linear(2048, DIMENSION), L2Norm())

    def forward(self, image):
        return self.aggregation(self.backbone(image))


def build(options, checkpoint):
    module = CosPlace()
    if checkpoint is not None:
        load_strictly(module, state_of(checkpoint), options.weights)
    return extractor_io(module, options.size)


def entry(options, module, licence, source):
    return model_registry.extractor(dimension=DIMENSION, licence=licence, source=source)
