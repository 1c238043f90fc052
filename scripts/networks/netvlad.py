"""NetVLAD: VGG16 and soft-assigned residuals to 64 cluster centres.

Arandjelović, Gronat, Torii, Pajdla, Sivic: NetVLAD, CVPR 2016, https://arxiv.org/abs/1511.07247, section 3.1 and equation 4;
the weights' layout in their MATLAB structure as read by https://github.com/uzh-rpg/netvlad_tf_open.
"""

import torch
import torchvision
from torch import nn
from torch.nn import functional as F

import model_registry

from . import Failure
from .layers import extractor_io
from .weights import load_strictly, read_torch, state_of

CHANNELS, CLUSTERS, WHITENED = 512, 64, 4096
# Of the published network (the mean of its training images), red first.
AVERAGE = (123.68, 116.779, 103.939)


class Vlad(nn.Module):
    def __init__(self):
        super().__init__()
        self.score_proj = nn.Conv1d(CHANNELS, CLUSTERS, 1, bias=False)
        self.centers = nn.Parameter(nn.init.xavier_uniform_(torch.empty(CHANNELS, CLUSTERS)))

    def forward(self, x):
        """x: (N, channels, cells) → (N, channels · clusters). Σ_n a_kn (x_n − c_k) = x aᵀ − c_k Σ_n a_kn."""
        assigned = F.softmax(self.score_proj(x), dim=1)
        residuals = torch.bmm(x, assigned.transpose(1, 2)) - self.centers * assigned.sum(dim=2).unsqueeze(1)
        return F.normalize(F.normalize(residuals, dim=1).flatten(1), dim=1)


class NetVlad(nn.Module):
    """Takes ImageNet-normalised RGB, which it turns back into levels 0…255 less the average image."""

    def __init__(self, whiten):
        super().__init__()
        self.backbone = nn.Sequential(*list(torchvision.models.vgg16().features)[:-2])
        self.netvlad = Vlad()
        if whiten:
            self.whiten = nn.Linear(CHANNELS * CLUSTERS, WHITENED)
        column = lambda values: torch.tensor(values).reshape(1, 3, 1, 1)
        self.register_buffer("mean", column(model_registry.IMAGENET_MEAN), persistent=False)
        self.register_buffer("std", column(model_registry.IMAGENET_STD), persistent=False)
        self.register_buffer("average", column(AVERAGE), persistent=False)

    def forward(self, image):
        levels = ((image * self.std + self.mean) * 255).clamp(0, 255)
        features = self.backbone(levels - self.average).flatten(2)
        descriptor = self.netvlad(F.normalize(features, dim=1))
        return F.normalize(self.whiten(descriptor), dim=1) if hasattr(self, "whiten") else descriptor


def read(path, unpickle):
    """The authors' MATLAB structure, or a PyTorch state dict with the names of this module."""
    if not str(path).endswith(".mat"):
        return read_torch(path, unpickle)
    import scipy.io

    try:
        net = scipy.io.loadmat(path, struct_as_record=False, squeeze_me=True)["net"]
        tensor = lambda array: torch.tensor(array).float()
        state = {}
        for i, layer in enumerate(torchvision.models.vgg16().features[:-2]):
            if isinstance(layer, nn.Conv2d):
                weight, bias = net.layers[i].weights[:2]
                state[f"backbone.{i}.weight"] = tensor(weight).permute(3, 2, 0, 1).contiguous()
                state[f"backbone.{i}.bias"] = tensor(bias)
        scores, negated_centers = net.layers[30].weights[:2]
        state["netvlad.score_proj.weight"] = tensor(scores).T.unsqueeze(-1).contiguous()
        state["netvlad.centers"] = -tensor(negated_centers)
        weight, bias = net.layers[33].weights[:2]
        state["whiten.weight"] = tensor(weight).squeeze().T.contiguous()
        state["whiten.bias"] = tensor(bias).flatten()
        state["average"] = tensor(net.meta.normalization.averageImage[0, 0])
        return state
    except Exception as error:
        raise Failure(f"{path}: not the structure of VGG16-NetVLAD-Pitts30K ({error}): is it the file named in --help?") from error


def build(options, checkpoint):
    module = NetVlad(options.whiten)
    if checkpoint is not None:
        state = dict(state_of(checkpoint))
        average = state.pop("average", None)
        if not options.whiten:
            state = {name: value for name, value in state.items() if not name.startswith("whiten.")}
        load_strictly(module, state, options.weights)
        if average is not None:
            module.average.copy_(average.reshape(1, 3, 1, 1))
    return extractor_io(module, options.size)


def entry(options, module, licence, source):
    dimension = WHITENED if options.whiten else CHANNELS * CLUSTERS
    return model_registry.extractor(dimension=dimension, licence=licence, source=source)
